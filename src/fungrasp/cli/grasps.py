"""``fungrasp grasps``: list and show grasps, import and synthesize human ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fungrasp.cli.console import table

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp

GraspFile = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
SourcePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]

WIDTH, HEIGHT = 960, 720
"""Size of pictures [pixels]."""


@dataclass(frozen=True)
class ListGrasps:
    """Count the grasps of a set by object and task."""

    grasps: str = "builtin"
    """A file of human or robot grasps; by default the built-in human grasps."""

    def run(self) -> None:
        from fungrasp.grasps import RobotGraspSet, load_grasps

        grasps = load_grasps(self.grasps)
        assert grasps.task is not None
        of_hand = f" of the hand '{grasps.hand}'" if isinstance(grasps, RobotGraspSet) else " of people"
        keys = sorted(set(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True)))
        rows = [("object", "task", "grasps", "mass [kg]", "links in contact")]
        for name, task in keys:
            part = grasps.select((grasps.object_name == name) & (grasps.task == task))
            contacts = part.link_contacts.sum(axis=1).mean()
            rows.append(
                (name, task or "-", str(len(part)), f"{part.object_mass.mean():.3f}", f"{contacts:.1f}")
            )
        print(table(rows, left=None))
        objects = len(set(grasps.object_name.tolist()))
        print(f"{len(grasps)} grasps{of_hand}, {objects} objects")


@dataclass(frozen=True)
class ShowGrasp:
    """Show one grasp: numbers, and on request a picture."""

    file: GraspFile
    """A file of human or robot grasps, or "builtin"."""
    index: int = 0
    """Which grasp of the file, from 0."""
    picture: Path | None = None
    """Draw the grasp to this PNG file."""
    objects: Path | None = None
    """Folder of meshes <name>.obj for the picture; built-in objects need none."""

    def run(self) -> None:
        from fungrasp.errors import FungraspError
        from fungrasp.grasps import load_grasps

        grasps = load_grasps(self.file)
        if not 0 <= self.index < len(grasps):
            raise FungraspError(f"{self.file} holds grasps 0 to {len(grasps) - 1}, not {self.index}")
        grasp = grasps[self.index]
        print(_description(grasp))
        if self.picture is not None:
            _draw(grasp, self.picture, self.objects)
            print(f"picture: {self.picture}")


@dataclass(frozen=True)
class ImportDexYCB:
    """Import DexYCB from its own folders: one grasp per sequence, where the object starts to move."""

    source: SourcePath
    """DexYCB's folder, which holds the subjects, calibration and models."""
    out: Path
    """Grasp file to write (.npz)."""
    displacement: float = 0.01
    """How far the object has moved when it counts as grasped [m]."""
    left_hands: Literal["skip", "mirror"] = "skip"
    """Leave left hands out, or reflect the whole scene: the object's name then ends in "_mirrored"."""
    mirrored_objects: Path | None = None
    """Folder for the meshes of mirrored objects; needed to use mirrored grasps."""
    mano: Path | None = None
    """Folder of your MANO model: adds joint rotations, takes contacts from the hand's surface."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; by default DexYCB's own models."""

    def run(self) -> None:
        from fungrasp.errors import FungraspError
        from fungrasp.grasps.importers.dexycb import DexYCBOptions, import_dexycb, write_mirrored_meshes

        if not self.displacement > 0:
            raise FungraspError(f"--displacement must be greater than 0, not {self.displacement}")
        options = DexYCBOptions(self.displacement, self.left_hands, self.mano, self.objects)
        grasps = import_dexycb(self.source, options)
        _save(self.out, grasps)
        if self.mirrored_objects is not None:
            for path in write_mirrored_meshes(self.source, options, grasps, self.mirrored_objects):
                print(f"mirrored mesh: {path}")


@dataclass(frozen=True)
class ImportDGrasp:
    """Import a label pickle of D-Grasp; nothing in the pickle is run."""

    source: SourcePath
    """The .pkl file."""
    out: Path
    """Grasp file to write (.npz)."""
    table_height: float = 0.5
    """Height of the labels' table top [m]; it becomes z = 0."""

    def run(self) -> None:
        from fungrasp.grasps.importers.dgrasp import import_dgrasp

        _save(self.out, import_dgrasp(self.source, self.table_height))


@dataclass(frozen=True)
class ImportOther:
    """Import by another package's importer (entry point fungrasp.grasps)."""

    importer: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the importer."""
    source: SourcePath
    """File or folder it reads."""
    out: Path
    """Grasp file to write (.npz)."""

    def run(self) -> None:
        from fungrasp.grasps.importers.registry import load_importer

        _save(self.out, load_importer(self.importer)(self.source))


@dataclass(frozen=True)
class ImportGrasps:
    """Turn a data set into a grasp file."""

    data: (
        Annotated[ImportDexYCB, tyro.conf.subcommand("dexycb")]
        | Annotated[ImportDGrasp, tyro.conf.subcommand("dgrasp")]
        | Annotated[ImportOther, tyro.conf.subcommand("other")]
    )
    """The kind of data set."""

    def run(self) -> None:
        self.data.run()


@dataclass(frozen=True)
class MakeGrasps:
    """Synthesize the human grasps of the built-in objects again."""

    out: Path
    """Grasp file to write (.npz)."""
    objects: tuple[str, ...] = ()
    """Only grasps of these built-in objects."""
    seed: int = 0
    """Seed of the random starts."""

    def run(self) -> None:
        from rich.progress import Progress

        from fungrasp.errors import UnknownNameError
        from fungrasp.synthesis import synthesize_grasps
        from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS

        known = {spec.object for spec in BUILTIN_SPECIFICATIONS}
        for name in self.objects:
            if name not in known:
                raise UnknownNameError("object", name, sorted(known))
        specs = [spec for spec in BUILTIN_SPECIFICATIONS if not self.objects or spec.object in self.objects]
        with Progress(transient=True) as progress:
            bar = progress.add_task("synthesizing grasps", total=len(specs))
            grasps = synthesize_grasps(specs, self.seed, progress=lambda count: progress.advance(bar, count))
        _save(self.out, grasps)
        missing = len(specs) - len(grasps)
        if missing:
            print(f"left out: {missing} of {len(specs)} grasp specifications, which could not be met")


COMMAND = {"list": ListGrasps, "show": ShowGrasp, "import": ImportGrasps, "make": MakeGrasps}


def _save(path: Path, grasps: HumanGraspSet) -> None:
    from fungrasp.grasps import save_human_grasps
    from fungrasp.grasps.anatomy import check_anatomy

    save_human_grasps(path, grasps)
    findings = check_anatomy(grasps)
    print(f"{path}: {len(grasps)} grasps of {len(set(grasps.object_name.tolist()))} objects")
    for finding in findings:
        print(f"unusual anatomy: {finding}")


def _description(grasp: HumanGrasp | RobotGrasp) -> str:
    from fungrasp.grasps import HUMAN_LINKS, HumanGrasp, bone_lengths

    human = isinstance(grasp, HumanGrasp)
    rows = [
        ("object", f"{grasp.object_name}, {grasp.object_mass:.3f} kg"),
        ("task", grasp.task or "-"),
        ("object pose", _numbers(grasp.object_pose)),
        ("object at rest", _numbers(grasp.object_rest_pose)),
    ]
    if human:
        touching = [name for name, touches in zip(HUMAN_LINKS, grasp.link_contacts, strict=True) if touches]
        rows += [
            ("wrist", _numbers(grasp.hand_joints[0])),
            (
                "hand length",
                f"{1000 * bone_lengths(grasp.hand_joints)[4:8].sum():.0f} mm, wrist to middle fingertip",
            ),
            ("in contact", ", ".join(touching) or "-"),
        ]
    else:
        rows += [
            ("hand", grasp.hand),
            ("wrist pose", _numbers(grasp.wrist_pose)),
            ("links in contact", f"{int(grasp.link_contacts.sum())} of {len(grasp.link_contacts)}"),
            *zip(grasp.joint_names, (f"{angle:+.4f} rad" for angle in grasp.joint_positions), strict=True),
            *((name, str(value)) for name, value in grasp.extra.items()),
        ]
    return table(rows, left=None)


def _draw(grasp: HumanGrasp | RobotGrasp, path: Path, objects: Path | None) -> None:
    from PIL import Image

    from fungrasp.files import atomic_path
    from fungrasp.grasps import HumanGrasp
    from fungrasp.hands import load_hand
    from fungrasp.objects import load_object
    from fungrasp.rendering import human_grasp_scene, robot_grasp_scene
    from fungrasp.rendering.render import render
    from fungrasp.rendering.viewpoints import look_at_grasp

    thing = load_object(grasp.object_name, float(grasp.object_mass), objects)
    shape = (thing.vertices, thing.faces, grasp.object_pose, grasp.link_contacts)
    if isinstance(grasp, HumanGrasp):
        model = human_grasp_scene(grasp.hand_joints, *shape)
        qpos = model.qpos0
    else:
        model, qpos = robot_grasp_scene(
            load_hand(grasp.hand), grasp.wrist_pose, grasp.joint_positions, *shape
        )
    picture = render(model, qpos, look_at_grasp(model, qpos, width=WIDTH, height=HEIGHT))[0]
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")


def _numbers(values: Iterable[float]) -> str:
    return "[" + " ".join(f"{value:.4f}" for value in values) + "]"
