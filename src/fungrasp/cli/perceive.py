"""``fungrasp perceive``: one image with depth of a person holding an object becomes a human grasp."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fungrasp.cli.console import table, write_json
from fungrasp.cli.image_source import ImageSource

if TYPE_CHECKING:
    import numpy as np
    from trimesh import Trimesh

    from fungrasp.grasps import HumanGrasp, HumanGraspSet
    from fungrasp.objects import ObjectModel
    from fungrasp.perception import Capture, HandEstimate, ObjectEstimate
    from fungrasp.perception.pipeline import Perceived

MOST_HANDS = 8
"""So many stand for the samples that are drawn: more would stand for one or two each."""

LOW_CONFIDENCE = 3
"""Exit status when the result was written but should be looked at before use."""


@dataclass(frozen=True)
class Perceive:
    """Turn an image with depth of a person holding a known object into a human grasp.

    Exit status 3: the grasp was written, but its confidence is low.
    """

    mesh: str
    """The object: a mesh file [m], the name of a built-in object, or a shape in millimetres, box:60x28x30,
    cylinder:66x115 (diameter, height) or sphere:67."""
    out: Path
    """Grasp file to write (.npz)."""
    source: ImageSource = field(default_factory=ImageSource)
    """Where the image comes from."""
    hand: Literal["right", "left"] | None = None
    """Which hand it is; by default it is recognised."""
    mass: float | None = None
    """The object's [kg]; by default a built-in object's own, or guessed from the mesh."""
    task: str = ""
    """What the grasp is for: "drink", "hand over" ..."""
    table: str | None = None
    """The table top's plane nx,ny,nz,d, camera frame, normal upwards [m]; by default it is looked for."""
    hand_file: Path | None = None
    """A hand that another program found in the image (HaMeR, WiLoR, METRO ...), .json or .npz."""
    mano: Path | None = None
    """Your MANO model, for hand files without joints."""
    object_pose_file: Path | None = None
    """A pose that another program found: a matrix, FoundationPose's folder or BOP results."""
    improve_pose: bool = False
    """Fit that pose to the depth; by default it stays as it is."""
    hand_from: str | None = None
    """Let an estimator of another package find the hand: the name of its entry point."""
    object_pose_from: str | None = None
    """Let an estimator of another package find the object's pose: the name of its entry point."""
    object_id: int | None = None
    """The object's number in BOP results of several objects."""
    hands: int = 1
    """Hands that the image allows, at most: fingers behind the object may be in several places. The file has
    a grasp of each, with its probability; retargeting keeps them together, and planning tries them all."""
    seed: int = 0
    """The same seed gives the same result."""
    report: Path | None = None
    """Write a page with pictures to this HTML file."""
    json: Path | None = None
    """Write everything that was found to this JSON file."""

    def run(self) -> None:
        from time import perf_counter

        from fungrasp.cli.held_object import held_object
        from fungrasp.perception.pipeline import perceive

        start = perf_counter()
        self._check()
        plane = parse_plane(self.table)
        held = held_object(self.mesh, self.mass)
        model = held.model
        capture = self.source.read(model)
        hand = self._hand(capture)
        pose = self._object_pose(capture, model if held.colored is None else held.colored)
        perceived = perceive(
            capture,
            model,
            colored=held.colored,
            side=self.hand,
            task=self.task,
            table=plane,
            hand=hand,
            object_estimate=pose,
            seed=self.seed,
            improve_pose=self.improve_pose,
            hands=self.hands,
        )
        kept = [] if self.source.keep is None else [f"the image: {self.source.keep}"]
        written = self._write(perceived, capture, model, perf_counter() - start)
        touching = int(perceived.grasp.link_contacts.sum())
        print(quality_table(perceived))
        print(f"{self.out}: a {perceived.hand.side} hand on '{model.name}', {touching} links in contact")
        for note in (*held.notes, *kept, *written):
            print(note)
        for warning in perceived.warnings:
            print(f"fungrasp: warning: {warning}", file=sys.stderr)
        if not perceived.confident:
            print("fungrasp: low confidence: look at the grasp before you use it", file=sys.stderr)
            raise SystemExit(LOW_CONFIDENCE)

    def _check(self) -> None:
        """Complain about options that do not go together."""
        from fungrasp.errors import FungraspError

        if None not in (self.hand_file, self.hand_from):
            raise FungraspError("give --hand-file or --hand-from, not both")
        if None not in (self.object_pose_file, self.object_pose_from):
            raise FungraspError("give --object-pose-file or --object-pose-from, not both")
        if not 1 <= self.hands <= MOST_HANDS:
            raise FungraspError(f"--hands must be 1 to {MOST_HANDS}, not {self.hands}")
        if self.improve_pose and self.object_pose_file is None and self.object_pose_from is None:
            raise FungraspError("--improve-pose needs --object-pose-file or --object-pose-from")

    def _hand(self, capture: Capture) -> HandEstimate | None:
        """What another program or package says; None if none is asked."""
        from fungrasp.perception.adapters import load_hand_estimator, read_hand_estimate

        if self.hand_from is not None:
            return load_hand_estimator(self.hand_from)(capture)
        if self.hand_file is not None:
            return read_hand_estimate(self.hand_file, capture, side=self.hand, mano=self.mano)
        return None

    def _object_pose(self, capture: Capture, mesh: ObjectModel | Trimesh) -> ObjectEstimate | None:
        """The same of the object."""
        from fungrasp.perception.adapters import load_object_pose_estimator, read_object_pose

        if self.object_pose_from is not None:
            return load_object_pose_estimator(self.object_pose_from)(capture, mesh)
        if self.object_pose_file is not None:
            return read_object_pose(self.object_pose_file, image=self.source.image, object_id=self.object_id)
        return None

    def _write(self, perceived: Perceived, capture: Capture, model: ObjectModel, seconds: float) -> list[str]:
        """Write the files, the grasp last; what to say about them."""
        from fungrasp.cli.held_object import write_mesh
        from fungrasp.cli.provenance import page_provenance
        from fungrasp.grasps import HumanGraspSet, save_human_grasps
        from fungrasp.objects import mirrored_object
        from fungrasp.report.perception_page import write_perception_page

        notes: list[str] = []
        if self.report is not None:
            made = page_provenance({"Image": self.source.name}, self.seed, seconds)
            write_perception_page(self.report, capture, model, perceived, made)
            notes.append(f"page: {self.report}")
        if self.json is not None:
            write_json(self.json, as_json(perceived))
        if perceived.hand.side == "left":
            name = perceived.grasp.object_name
            path = self.out.parent / f"{name}.obj"
            write_mesh(path, mirrored_object(model))
            notes.append(f"the scene was mirrored, as hands are right ones here; the object's mesh: {path}")
        if len(perceived.hands) > 1:
            parts = ", ".join(f"{100 * one.probability:.0f} %" for one in perceived.hands)
            notes.append(f"{len(perceived.hands)} hands that the image allows: {parts}")
        grasps = [one_grasp(one.grasp) for one in perceived.hands]
        save_human_grasps(self.out, HumanGraspSet.concatenate(grasps))
        return notes


COMMAND = Perceive


def parse_plane(text: str | None) -> np.ndarray | None:
    """A plane written as ``nx,ny,nz,d``: unit normal and offset [m], shape [4].

    Raises:
        FungraspError: it is something else.
    """
    import numpy as np

    from fungrasp.errors import FungraspError

    if text is None:
        return None
    try:
        plane = np.array([float(part) for part in text.split(",")])
    except ValueError:
        plane = np.zeros(0)
    length = float(np.linalg.norm(plane[:3]))
    if plane.shape != (4,) or not np.isfinite(plane).all() or not 0.99 < length < 1.01:
        raise FungraspError(f"a table is nx,ny,nz,d with a normal of length 1, not '{text}'")
    return plane / length


def one_grasp(grasp: HumanGrasp) -> HumanGraspSet:
    """A set of this grasp alone."""
    import numpy as np

    from fungrasp.grasps import HumanGraspSet

    values = {name: getattr(grasp, name) for name in HumanGraspSet.FIELDS}
    rows: dict[str, Any] = {name: np.array([value]) for name, value in values.items() if value is not None}
    return HumanGraspSet(**rows)


def quality_table(perceived: Perceived) -> str:
    """The quality figures, for people."""
    quality = perceived.quality

    def millimetres(metres: float) -> str:
        return f"{1000 * metres:.1f} mm" if isfinite(metres) else "not known"

    return table(
        [
            ("hand's score", f"{quality.hand_score:.2f}"),
            ("object's score", f"{quality.object_score:.2f}"),
            ("landmarks from the joints", f"{quality.reprojection_px:.1f} px"),
            ("depth from the hand's skin", millimetres(quality.hand_residual_m)),
            ("depth from the object's surface", millimetres(quality.depth_residual_m)),
            ("hand in the object", millimetres(quality.penetration_m)),
        ]
    )


def as_json(perceived: Perceived) -> dict[str, Any]:
    """All that was found. Metres; poses ``[x y z qw qx qy qz]``; what could not be measured is null."""
    from fungrasp.grasps import HUMAN_LINKS

    grasp, hand, thing = perceived.grasp, perceived.hand, perceived.object
    links = zip(HUMAN_LINKS, grasp.link_contacts, strict=True)
    quality = {name: v if isfinite(v) else None for name, v in asdict(perceived.quality).items()}
    return {
        "version": 1,
        "sure": perceived.confident,
        "doubts": [str(warning) for warning in perceived.warnings],
        "warnings": [
            {"code": warning.code, "values": dict(warning.values)} for warning in perceived.warnings
        ],
        "quality": quality,
        "grasp": {
            "object_name": grasp.object_name,
            "object_mass": grasp.object_mass,
            "object_pose": grasp.object_pose.tolist(),
            "object_rest_pose": grasp.object_rest_pose.tolist(),
            "hand_joints": grasp.hand_joints.tolist(),
            "links_in_contact": [name for name, touches in links if touches],
            "task": grasp.task,
        },
        "pose_world_camera": perceived.pose_world_camera.tolist(),
        "table_camera": perceived.table.tolist(),
        "table_found": perceived.table_found,
        "hand": {
            "side": hand.side,
            "score": hand.score,
            "joints_camera": hand.joints_camera.tolist(),
            "pixels": hand.pixels.tolist(),
            "confidence": hand.confidence.tolist(),
        },
        "hands": [
            {"joints_camera": one.hand.joints_camera.tolist(), "probability": one.probability}
            for one in perceived.hands
        ],
        "object": {
            "pose_camera": thing.pose_camera_object.tolist(),
            "score": thing.score,
            "accepted": thing.accepted,
            "note": thing.note,
            "alternatives": [
                {"pose_camera": pose.tolist(), "score": score} for pose, score in thing.alternatives
            ],
        },
    }
