"""What perception makes of an image: the record that ``perceive`` returns, how well it agrees with the image,
and what happened on the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from math import isfinite
from time import perf_counter, process_time
from typing import Any

import numpy as np

from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.grasps import HUMAN_LINKS, HumanGrasp, HumanGraspSet
from fungrasp.objects import ObjectModel, mirrored_object
from fungrasp.perception.acceptance import Acceptance
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.hand.hand_capsules import SURFACE_SAMPLES, in_front
from fungrasp.perception.hand.physical_evidence import HandSurroundings, link_gaps
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.object_pose.estimate import PoseAnswers
from fungrasp.perception.object_pose.shape_fit import FittedShape


@dataclass(frozen=True)
class PerceptionQuality:
    """Figures of one perceived grasp."""

    reprojection_px: float
    """Median distance between the landmarks seen and the hand's joints projected into the image [pixels]."""
    depth_residual_m: float
    """Median distance of the object's measured points from its mesh [m]; NaN if not known."""
    hand_residual_m: float
    """Median distance between the depth measured at the hand and its skin [m]; NaN where none is seen."""
    penetration_m: float
    """How deep the hand is in the object at the deepest [m]; soft pads that press give a few mm."""


def measure_quality(
    capture: Capture, hand: HandEstimate, obj: ObjectEstimate, surface: SignedDistanceGrid
) -> PerceptionQuality:
    """The figures.

    Args:
        surface: of the object, object's frame.
    """
    pose = obj.pose_camera_object
    off = np.linalg.norm(capture.intrinsics.project(hand.joints_camera) - hand.pixels, axis=1)
    surroundings = HandSurroundings(surface, pose)
    residual = obj.residual_m
    if not np.isfinite(residual):
        residual = _object_residual(capture, pose, surroundings)
    return PerceptionQuality(
        reprojection_px=float(np.nanmedian(off)),
        depth_residual_m=residual,
        hand_residual_m=_hand_residual(capture, hand.joints_camera, surroundings),
        penetration_m=max(0.0, -float(link_gaps(hand.joints_camera, surface, pose).min())),
    )


def _object_residual(capture: Capture, pose: np.ndarray, surroundings: HandSurroundings) -> float:
    """Median distance from the surface of what is seen within 15 mm of it [m]; NaN if there is nothing."""
    points = capture.points()[::2, ::2].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    points = points[np.linalg.norm(points - pose[:3], axis=1) < 0.5]
    if not len(points):
        return float("nan")
    distance = np.abs(surroundings.object_distance(points)[0])
    near = distance < 0.015
    return float(np.median(distance[near])) if near.any() else float("nan")


def _hand_residual(capture: Capture, joints: np.ndarray, surroundings: HandSurroundings) -> float:
    """How far the skin is from what is seen at its pixels, median [m]; NaN where nothing is seen.

    What the object shows, within 4 mm of its surface, or hides does not count; all else is the hand, as
    little else is in front of it. Beyond 0.1 m something else is seen.
    """
    points, _ = SURFACE_SAMPLES.place(joints, np.zeros((21, 3, 1)))
    pixels = np.rint(np.nan_to_num(capture.intrinsics.project(points), nan=-1.0)).astype(int)
    k = capture.intrinsics
    inside = np.all((pixels >= 0) & (pixels < [k.width, k.height]), axis=1)
    measured = np.zeros(len(points))
    measured[inside] = capture.depth[pixels[inside, 1], pixels[inside, 0]]
    seen = (measured > 0) & in_front(points, SURFACE_SAMPLES.radius)
    off = np.minimum(np.abs(points[:, 2] - SURFACE_SAMPLES.radius - measured), 0.1)
    distance = surroundings.object_distance(k.deproject(pixels, measured))[0]
    seen &= distance > 0.004
    return float(np.median(off[seen])) if seen.any() else float("nan")


@dataclass(frozen=True)
class StageSeconds:
    """How long a stage took."""

    wall: float = 0.0
    """Wall time [s]."""
    cpu: float = 0.0
    """Processor time of all threads together [s]; less than ``wall`` where other programs had the
    processors."""


@dataclass(frozen=True, eq=False)
class HandCandidate:
    """A hand that may be the one that holds the object, and the table and the object that go with it."""

    detected: DetectedHand | None
    """The hand in the image; None for another estimator's."""
    hand: HandEstimate
    """The hand in meters, before the object is known, camera frame."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]``, camera frame, shape [4]; None if none was seen."""
    object: ObjectEstimate
    """The object's pose, camera frame."""
    answers: PoseAnswers | None
    """All poses of the search, best first, and what their scores are made of; None for a given pose."""
    holds: bool
    """Whether the object's pose is rather right than wrong and the hand is at it."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """What was uncertain in the choice of the hand."""

    @property
    def worth(self) -> float:
        """The product of the scores of hand and object: of candidates that hold the object, or of those that
        don't where none does, the highest is chosen."""
        return self.object.score * self.hand.score


@dataclass(frozen=True, eq=False)
class PerceptionTrace:
    """What happened inside ``perceive``, by stage."""

    detected: tuple[DetectedHand, ...] = ()
    """All hands that the detector found in the image as it is; empty where a hand was given."""
    candidates: tuple[HandCandidate, ...] = ()
    """Hands that were looked at more closely, in the order in which this happened."""
    chosen: int = 0
    """Number of the candidate that the result is made of."""
    seconds: Mapping[str, StageSeconds] = field(default_factory=dict)
    """Time of each stage, candidates together: "mesh" (made ready, once for all images of it), "detection",
    "hand" (in meters, without the object), "table", "object" (the search for its pose), "refinement" (the
    hand at the object), "grasp" (contacts, world frame and figures)."""

    @property
    def candidate(self) -> HandCandidate:
        """The one that was chosen."""
        return self.candidates[self.chosen]


class Stopwatch:
    """Adds up the time of stages by their names."""

    def __init__(self) -> None:
        self.seconds: dict[str, StageSeconds] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what happens inside ``with`` to a stage."""
        wall, cpu = perf_counter(), process_time()
        try:
            yield
        finally:
            before = self.seconds.get(name, StageSeconds())
            self.seconds[name] = StageSeconds(
                before.wall + perf_counter() - wall, before.cpu + process_time() - cpu
            )


@dataclass(frozen=True, eq=False)
class Perceived:
    """What was made of an image."""

    capture: Capture
    """The image."""
    object_model: ObjectModel
    """The object in the image."""
    grasp: HumanGrasp
    """World frame, a right hand. If the image shows a left one, the scene reflected in the plane y = 0: the
    object's name then ends in "_mirrored", and its mesh must be reflected as well (see ``mirror_pose``)."""
    pose_world_camera: np.ndarray
    """Camera in the world, shape [7], before any reflection; ``world_from_table`` says where it is."""
    hand: HandEstimate
    """The hand after refinement against the object, camera frame, not mirrored."""
    object: ObjectEstimate
    """The object, camera frame, not mirrored."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame, shape
    [4]."""
    table_found: bool
    """Whether the table was given or seen; else it is a guess."""
    quality: PerceptionQuality
    """Residuals and penetration."""
    warnings: tuple[PerceptionWarning, ...]
    """What was uncertain; empty if nothing was."""
    acceptance: Acceptance
    """Whether it can be used, the numbers that say so, and what would help. A table that is only guessed
    gives a warning, but the hand on the object does not depend on it; so does the question which way round a
    nearly symmetric object is."""
    notes: tuple[str, ...] = ()
    """Assumptions about the object, as sentences to print: a mass that was guessed."""
    trace: PerceptionTrace = field(default_factory=PerceptionTrace)
    """What happened by stage."""
    mass_range: tuple[float, float] | None = None
    """Between which the object's mass lies in eight of ten cases, where it was guessed [kg]."""
    fitted: FittedShape | None = None
    """The shape that stands for an object without a mesh; None where a mesh was given."""

    @property
    def confident(self) -> bool:
        """Whether the answer is sure."""
        return self.acceptance.sure

    @property
    def grasps(self) -> HumanGraspSet:
        """The grasp as the set that ``retarget`` takes."""
        return HumanGraspSet.of([self.grasp])

    @property
    def objects(self) -> dict[str, ObjectModel]:
        """The object of the grasps by its name, reflected if the hand was a left one."""
        model, name = self.object_model, self.grasp.object_name
        return {name: model if name == model.name else mirrored_object(model)}

    def as_json(self) -> dict[str, Any]:
        """All that was found, to be written as JSON. Meters; poses ``[x y z qw qx qy qz]``; what could not be
        measured is null."""
        grasp, hand, obj = self.grasp, self.hand, self.object
        links = zip(HUMAN_LINKS, grasp.link_contacts, strict=True)
        return {
            "version": 3,
            "sure": self.confident,
            "acceptance": self.acceptance.as_json(),
            "doubts": [str(warning) for warning in self.warnings],
            "warnings": [{"code": warning.code, "values": dict(warning.values)} for warning in self.warnings],
            "quality": {name: v if isfinite(v) else None for name, v in asdict(self.quality).items()},
            "grasp": {
                "object_name": grasp.object_name,
                "object_mass": grasp.object_mass,
                "object_pose": grasp.object_pose.tolist(),
                "object_rest_pose": grasp.object_rest_pose.tolist(),
                "hand_joints": grasp.hand_joints.tolist(),
                "links_in_contact": [name for name, touches in links if touches],
                "task": grasp.task,
            },
            "pose_world_camera": self.pose_world_camera.tolist(),
            "table_camera": self.table.tolist(),
            "table_found": self.table_found,
            "hand": {
                "side": hand.side,
                "score": hand.score,
                "joints_camera": hand.joints_camera.tolist(),
                "pixels": hand.pixels.tolist(),
                "confidence": hand.confidence.tolist(),
            },
            "fitted_shape": None
            if self.fitted is None
            else {"name": self.fitted.name, "explained": self.fitted.quality},
            "object_mass_range": self.mass_range,
            "object": {
                "pose_camera": obj.pose_camera_object.tolist(),
                "score": obj.score,
                "accepted": obj.accepted,
                "note": obj.note,
                "alternatives": [
                    {"pose_camera": pose.tolist(), "score": score} for pose, score in obj.alternatives
                ],
            },
        }
