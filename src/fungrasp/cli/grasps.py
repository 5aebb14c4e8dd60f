"""``fungrasp grasps``: list, show, check, convert, select, vary, import and synthesize grasps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult, progress_bar, table, write_human_grasps
from fungrasp.cli.options import ClusterOption, ObjectsOption, print_use
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.grasps.conversion import Convention

if TYPE_CHECKING:
    import numpy as np

    from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet
    from fungrasp.objects import ObjectModel
    from fungrasp.synthesis import GraspSpecification, SynthesisSettings

GraspFile = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
SourcePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]

WIDTH, HEIGHT = 960, 720
"""Size of pictures [pixels]."""


@dataclass(frozen=True)
class ListGrasps(Answering):
    """Count the grasps in a file by object and task."""

    grasps: str = "builtin"
    """A grasp file, or "builtin"."""

    def run(self) -> CommandResult:
        from fungrasp.grasps import RobotGraspSet, load_grasps

        grasps = load_grasps(self.grasps)
        assert grasps.task is not None
        of_hand = f" of the hand '{grasps.hand}'" if isinstance(grasps, RobotGraspSet) else " of people"
        found = []
        for name, task in sorted(set(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True))):
            part = grasps.select((grasps.object_name == name) & (grasps.task == task))
            mass, links = part.object_mass.mean(), part.link_contacts.sum(axis=1).mean()
            counts = {"grasps": len(part), "mass": round(mass, 3), "links_in_contact": round(links, 1)}
            found.append({"object": name, "task": task or "-", **counts})
        heads = ("object", "task", "grasps", "mass [kg]", "links in contact")
        rows = [
            (o, t, str(count), f"{mass:.3f}", f"{links:.1f}")
            for o, t, count, mass, links in map(dict.values, found)
        ]
        objects = len(set(grasps.object_name.tolist()))
        text = f"{table([heads, *rows], left=None)}\n{len(grasps)} grasps{of_hand}, {objects} objects"
        return CommandResult(found, text)


@dataclass(frozen=True)
class ShowGrasp(ObjectsOption, Answering):
    """Show one grasp as numbers or as a picture."""

    file: GraspFile
    """A grasp file, or "builtin"."""
    grasp: str = "0"
    """The grasp: an object ("mug"), object and task ("mug:drink") or a row number, from 0."""
    picture: Path | None = None
    """Draw the grasp to this PNG file."""

    def run(self) -> CommandResult:
        from fungrasp.grasps import load_grasps
        from fungrasp.grasps.grasp_arguments import picked_rows

        grasps = load_grasps(self.file)
        (row,) = picked_rows(grasps, (self.grasp,))
        grasp = grasps[row]
        text = _description(grasp)
        if self.picture is not None:
            _draw(grasps, row, self.picture, self.objects)
            text += f"\npicture: {self.picture}"
        return CommandResult({**_fields(grasp), "picture": self.picture}, text)


@dataclass(frozen=True)
class _Import(Answering):
    source: SourcePath
    """The data set's folder or file."""
    out: Path
    """Grasp file to write (.npz)."""

    def run(self) -> CommandResult:
        return write_human_grasps(self.out, self.grasps())

    def grasps(self) -> HumanGraspSet:
        """Return the grasps of the data set."""
        raise NotImplementedError


@dataclass(frozen=True)
class _ImportMano(_Import):
    mano: Path
    """Folder with your MANO model."""
    objects: Path
    """Folder with the data set's object meshes."""


@dataclass(frozen=True)
class ImportDexYCB(_Import):
    """Import DexYCB, the folder of subjects, calibration and models: one grasp per sequence."""

    mano: Path | None = None
    """Folder with your MANO model. It adds joint rotations and contacts of the hand's surface."""
    objects: Path | None = None
    """Folder with object meshes. Default: DexYCB's own models."""
    left_hands: Literal["skip", "mirror"] = "skip"
    """Skip left hands, or mirror them with their objects, whose names then end in "_mirrored"."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.dexycb import import_dexycb

        return import_dexycb(self.source, mano=self.mano, objects=self.objects, left_hands=self.left_hands)


@dataclass(frozen=True)
class ImportDGrasp(_Import):
    """Import a D-Grasp label pickle (.pkl). No code in the pickle is run."""

    table_height: float = 0.5
    """Height of the table top in the file [m]; it becomes z = 0."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.dgrasp import import_dgrasp

        return import_dgrasp(self.source, self.table_height)


@dataclass(frozen=True)
class ImportGrab(_ImportMano):
    """Import GRAB, a folder with the subjects' folders (s1/*.npz): one grasp per sequence."""

    subjects: Path | None = None
    """Base folder of the subjects' hand shapes (vtemp). Default: the mean hand."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.grab import import_grab

        return import_grab(self.source, self.mano, self.objects, self.subjects)


@dataclass(frozen=True)
class ImportOakInk2(_ImportMano):
    """Import OakInk2, the folder anno_preview: one grasp per sequence and object that the hand moves."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.oakink2 import import_oakink2

        return import_oakink2(self.source, self.mano, self.objects)


@dataclass(frozen=True)
class ImportHOT3D(_ImportMano):
    """Import HOT3D, a folder of sequences: one grasp per sequence and object that the hand moves."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.hot3d import import_hot3d

        return import_hot3d(self.source, self.mano, self.objects)


@dataclass(frozen=True)
class ImportGigaHands(_Import):
    """Import GigaHands, the folder of hand_poses, object_poses and object_meta: one grasp per sequence."""

    def grasps(self) -> HumanGraspSet:
        from fungrasp.grasps.importers.gigahands import import_gigahands

        return import_gigahands(self.source)


@dataclass(frozen=True)
class ImportHO3D(_Import):
    """Import HO-3D, a folder of sequences: one grasp each. The files do not define "up"."""

    objects: Path
    """Folder with the YCB models."""
    camera_tilt: float = 0.0
    """Angle of the camera below horizontal [degrees]."""

    def grasps(self) -> HumanGraspSet:
        from math import radians

        from fungrasp.grasps.importers.ho3d import import_ho3d

        return import_ho3d(self.source, self.objects, radians(self.camera_tilt))


@dataclass(frozen=True)
class ImportOther(Answering):
    """Run an importer of another package (entry point fungrasp.grasps)."""

    importer: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the importer."""
    source: SourcePath
    """File or folder to import."""
    out: Path
    """Grasp file to write (.npz)."""

    def run(self) -> CommandResult:
        from fungrasp.core.plugins import load_plugin

        importer = load_plugin("fungrasp.grasps", "importer", self.importer)
        return write_human_grasps(self.out, importer(self.source))


@dataclass(frozen=True)
class ImportGrasps:
    """Convert a data set to a grasp file."""

    data: (
        Annotated[ImportDexYCB, tyro.conf.subcommand("dexycb")]
        | Annotated[ImportDGrasp, tyro.conf.subcommand("dgrasp")]
        | Annotated[ImportGigaHands, tyro.conf.subcommand("gigahands")]
        | Annotated[ImportGrab, tyro.conf.subcommand("grab")]
        | Annotated[ImportHO3D, tyro.conf.subcommand("ho3d")]
        | Annotated[ImportHOT3D, tyro.conf.subcommand("hot3d")]
        | Annotated[ImportOakInk2, tyro.conf.subcommand("oakink2")]
        | Annotated[ImportOther, tyro.conf.subcommand("other")]
    )
    """The data set."""

    @property
    def json(self) -> bool:
        """Whether to print JSON."""
        return self.data.json

    def run(self) -> CommandResult:
        """Run the importer."""
        return self.data.run()


@dataclass(frozen=True)
class CheckGrasps(ObjectsOption, Answering):
    """Check human grasps: units, joint order, side, frames, table. Exit status 1: most cannot be used."""

    file: GraspFile
    """A file of human grasps."""

    def run(self) -> CommandResult:
        from fungrasp.grasps.anatomy import check_anatomy, grouped
        from fungrasp.grasps.diagnosis import completed, diagnosis
        from fungrasp.grasps.grasp_files import human_grasps, read_grasp_fields

        fields = read_grasp_fields(self.file)
        objects = _known_objects(fields, self.objects)
        found = diagnosis(fields, objects)
        options = found.convention.as_options() if found.fatal else ""
        value = {
            "findings": [{"grasps": r.rows, "what": r.words} for r in found.remarks],
            "convert_with": options,
            "untested": list(found.untested),
            "usable": not found.fatal and not found.untested,
        }
        lines = [str(remark) for remark in found.remarks] + [
            f"not tested: {words}" for words in found.untested
        ]
        if found.fatal:
            if self.objects is not None and options:
                options = f"{options} --objects {self.objects}"
            lines.append(
                f"to convert: fungrasp grasps convert {self.file} {options} --out NEW.npz; then check it"
                if options
                else f"{self.file}: most grasps can't be used"
            )
            return CommandResult(value, "\n".join(lines), status=1)
        grasps = human_grasps(self.file, completed(fields, objects))
        unusual = grouped(check_anatomy(grasps))
        lines += [f"unusual anatomy: {finding}" for finding in unusual]
        bad = {row for remark in found.remarks if remark.fatal for row in remark.rows.tolist()}
        usable = f"{len(grasps) - len(bad)} of {len(grasps)}" if bad else str(len(grasps))
        lines.append(
            f"{self.file}: the hands of {usable} grasps are usable; sound meshes would test the rest"
            if found.untested
            else f"{self.file}: {usable} usable grasps"
        )
        return CommandResult({**value, "unusual_anatomy": unusual}, "\n".join(lines))


@dataclass(frozen=True)
class ConvertGrasps(ObjectsOption, Answering):
    """Convert human grasps from other conventions, and compute missing contacts."""

    file: GraspFile
    """A file with the fields of human grasps."""
    out: Path
    """Grasp file to write (.npz)."""
    convention: Annotated[Convention, tyro.conf.arg(name="")] = field(default_factory=Convention)
    """Conventions of the file."""
    below_table: Literal["keep", "lift", "drop"] = "keep"
    """Grasps with hands below the table: keep them, lift hand and object, or drop them."""

    def run(self) -> CommandResult:
        from fungrasp.grasps.conversion import converted, mend_below_table
        from fungrasp.grasps.diagnosis import completed
        from fungrasp.grasps.grasp_files import human_grasps, read_grasp_fields

        fields = read_grasp_fields(self.file)
        if "hand_joints" not in fields:
            human_grasps(self.file, fields)
        fields = converted(fields, self.convention)
        fields = completed(fields, _known_objects(fields, self.objects))
        return write_human_grasps(
            self.out, mend_below_table(human_grasps(self.file, fields), self.below_table)
        )


@dataclass(frozen=True)
class VaryGrasps(ObjectsOption, Answering):
    """Add variations to human grasps, to train on: the hand is shifted and turned relative to the object.
    Set grasps for tests aside first, because variations of a grasp are alike."""

    file: GraspFile
    """A file of human grasps, or "builtin"."""
    out: Path
    """Grasp file to write (.npz): the grasps, then their variations."""
    count: int = 31
    """Variations of each grasp. They are left out if the hand is below the table, or if fewer than three
    finger links touch."""
    seed: int = 0
    """Seed of the random numbers."""

    def run(self) -> CommandResult:
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.variation import varied_grasps

        human = load_human_grasps(self.file)
        objects = load_objects(human, self.objects)
        return write_human_grasps(self.out, varied_grasps(human, objects, self.count, self.seed))


@dataclass(frozen=True)
class SelectGrasps(Answering):
    """Copy grasps to another file: by object, task, row or quality."""

    file: GraspFile
    """A grasp file, or "builtin"."""
    out: Path
    """Grasp file to write (.npz)."""
    objects: tuple[str, ...] = ()
    """Only grasps of these objects."""
    tasks: tuple[str, ...] = ()
    """Only grasps for these tasks."""
    rows: tuple[str, ...] = ()
    """Only these rows, from 0: numbers, FIRST:END or FIRST:END:STEP as in Python (0::3 is every third)."""
    by: str = "force_closure_residual"
    """Value to rank robot grasps by; `fungrasp grasps show` lists them."""
    best: float | None = None
    """Share to keep, smallest values first: 0.75."""

    def run(self) -> CommandResult:
        import numpy as np

        from fungrasp.grasps import RobotGraspSet, load_grasps

        grasps = load_grasps(self.file)
        assert grasps.task is not None
        kept = np.ones(len(grasps), dtype=bool)
        for wanted, names in ((self.objects, grasps.object_name), (self.tasks, grasps.task)):
            for name in wanted:
                if name not in names:
                    raise UnknownNameError("object or task", name, set(names.tolist()))
            if wanted:
                kept &= np.isin(names, wanted)
        if self.rows:
            kept &= _rows(self.rows, len(grasps))
        if self.best is not None:
            if not isinstance(grasps, RobotGraspSet):
                raise FungraspError("--best needs robot grasps: give a file of 'fungrasp retarget'")
            if self.by not in grasps.extra or grasps.extra[self.by].ndim != 1:
                remedy = (
                    "'fungrasp retarget' writes the static quality, which Python's retarget does not add."
                )
                raise UnknownNameError("value of the grasps", self.by, grasps.extra, remedy)
            values = np.where(kept, grasps.extra[self.by].astype(float), np.nan)
            if not 0 < self.best <= 1:
                raise FungraspError(f"--best must be a share in (0, 1], not {self.best:g}")
            kept &= values <= np.nanquantile(values, self.best) if np.isfinite(values).any() else False
        if not kept.any():
            raise FungraspError(f"none of the {len(grasps)} grasps in {self.file} is selected")
        chosen = grasps.select(kept)
        chosen.save(self.out)
        return CommandResult(
            {"grasps": self.out, "count": len(chosen), "of": len(grasps)},
            f"{self.out}: {len(chosen)} of {len(grasps)} grasps",
        )


@dataclass(frozen=True)
class MakeGrasps(ClusterOption, Answering):
    """Synthesize human grasps of the built-in objects or of any mesh."""

    out: Path
    """Grasp file to write (.npz). Run the same command again to continue an interrupted run; finished parts
    are kept in <out>.partial."""
    objects: tuple[str, ...] = ()
    """Only grasps of these built-in objects."""
    mesh: Path | None = None
    """Grasp this mesh or shape (box:60x28x30) instead: around the whole object, from above, at handles and
    at thin parts."""
    mass: float | None = None
    """Mass of that object [kg]."""
    parts: Path | None = None
    """JSON file with parts to hold, as boxes in the mesh frame [m]: {"handle": [[x, y, z], [x, y, z]]}."""
    seed: tuple[int, ...] = (0,)
    """Random seeds. With several, each grasp is synthesized with each, and different results are kept."""

    def run(self) -> CommandResult:
        from fungrasp.core.jobs import PartStore
        from fungrasp.objects import is_plain_shape
        from fungrasp.synthesis import synthesize_grasps

        if not self.seed or len(set(self.seed)) < len(self.seed) or min(self.seed) < 0:
            raise FungraspError("--seed needs at least one number, none negative, and each once")
        specs, models, settings = self._specifications()
        sought, cluster = len(specs) * len(self.seed), self.cluster
        with PartStore.beside(self.out) as store:
            with progress_bar("synthesizing grasps", 1.0) as show:
                grasps = synthesize_grasps(
                    specs, self.seed, settings, models, store=store, ray=cluster, progress=show
                )
            answer = write_human_grasps(self.out, grasps)
        print_use(cluster)
        lines = [answer.text]
        if len(grasps) < sought:
            words = "failed" if len(self.seed) == 1 else "failed or repeat another"
            lines.append(f"{sought - len(grasps)} of {sought} grasp specifications {words}")
        if self.mesh is not None:
            (name,) = models or {}
            folder = "" if is_plain_shape(name) else f" --objects {self.mesh.parent}"
            lines.append(f"use them with: --grasps {self.out}{folder}")
        return CommandResult({**answer.value, "left_out": sought - len(grasps)}, "\n".join(lines))

    def _specifications(
        self,
    ) -> tuple[Sequence[GraspSpecification], dict[str, ObjectModel] | None, SynthesisSettings]:
        """Return specifications, objects (None: built-in) and settings."""
        from fungrasp.objects import is_plain_shape, load_object, object_from_file
        from fungrasp.synthesis import SynthesisSettings
        from fungrasp.synthesis.automatic_specifications import automatic_specifications, parts_from_boxes
        from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS

        if self.mesh is None:
            if self.mass is not None or self.parts is not None:
                raise FungraspError("--mass and --parts need --mesh")
            known = {spec.object for spec in BUILTIN_SPECIFICATIONS}
            for name in self.objects:
                if name not in known:
                    raise UnknownNameError("object", name, sorted(known))
            some = [s for s in BUILTIN_SPECIFICATIONS if not self.objects or s.object in self.objects]
            return some, None, SynthesisSettings()
        shape = is_plain_shape(str(self.mesh)) and not self.mesh.is_file()
        model = load_object(str(self.mesh), self.mass) if shape else object_from_file(self.mesh, self.mass)
        if self.parts is not None:
            model = parts_from_boxes(model, self.parts)
        specs = automatic_specifications(model)
        if not specs:
            raise FungraspError(f"{self.mesh}: no part is small enough for a hand")
        return specs, {model.name: model}, SynthesisSettings(starts=3)


COMMAND = {
    "list": ListGrasps,
    "show": ShowGrasp,
    "check": CheckGrasps,
    "convert": ConvertGrasps,
    "select": SelectGrasps,
    "vary": VaryGrasps,
    "import": ImportGrasps,
    "make": MakeGrasps,
}


def _rows(entries: tuple[str, ...], count: int) -> np.ndarray:
    """Return the mask of rows selected by numbers and slices, shape [count] bool."""
    import re

    import numpy as np

    chosen = np.zeros(count, dtype=bool)
    for entry in entries:
        if not re.fullmatch(r"\d+|\d*:\d*(:[1-9]\d*)?", entry):
            raise FungraspError(f"--rows takes numbers or FIRST:END:STEP, as in 0:120:3, not '{entry}'")
        parts = [int(part) if part else None for part in entry.split(":")]
        if len(parts) == 1 and int(entry) >= count:
            raise FungraspError(f"--rows {entry}: the file holds rows 0 to {count - 1}")
        chosen[int(entry) if len(parts) == 1 else slice(*parts)] = True
    return chosen


def _known_objects(fields: Mapping[str, Any], folder: Path | None) -> dict[str, ObjectModel]:
    """Load the known objects of a file's grasps by name, each with the mass in its first grasp."""
    import numpy as np

    from fungrasp.grasps.grasp_arguments import named_objects
    from fungrasp.grasps.grasp_set import given_bounds
    from fungrasp.objects import MIRRORED, mesh_files, object_names

    known = {*object_names(), *mesh_files(folder)}
    names, masses = (np.ravel(fields.get(f"object_{field}", ())).tolist() for field in ("name", "mass"))
    # Any mass will do here if the file has none.
    masses = (
        masses if len(masses) == len(names) and all(0 < m < np.inf for m in masses) else [1e-3] * len(names)
    )
    rows = reversed(list(zip(names, masses, strict=True)))
    first = {str(n): float(m) for n, m in rows if str(n).removesuffix(MIRRORED) in known}
    return named_objects([*first], [*first.values()], folder, bounds=given_bounds(fields))


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


def _fields(grasp: HumanGrasp | RobotGrasp) -> dict[str, Any]:
    """Return all fields of a grasp by name, including ``extra`` values."""
    values = {field.name: getattr(grasp, field.name) for field in dataclasses.fields(grasp)}
    return {**values, **values.pop("extra", {})}


def _draw(grasps: HumanGraspSet | RobotGraspSet, row: int, path: Path, objects: Path | None) -> None:
    from PIL import Image

    from fungrasp.core.files import atomic_path
    from fungrasp.grasps import RobotGraspSet
    from fungrasp.grasps.as_shown import place_marks
    from fungrasp.media.pictures import grasp_pictures
    from fungrasp.objects import load_object

    name = str(grasps.object_name[row])
    obj = load_object(name, float(grasps.object_mass[row]), objects)
    marks = place_marks(grasps, row, {name: obj}) if isinstance(grasps, RobotGraspSet) else None
    (picture,) = grasp_pictures(grasps, row, {name: obj}, (WIDTH, HEIGHT), marks=marks)
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")


def _numbers(values: Iterable[float]) -> str:
    return "[" + " ".join(f"{value:.4f}" for value in values) + "]"
