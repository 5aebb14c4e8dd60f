"""How well ``perceive`` does on captures whose truth is known, stage by stage, and how long it takes.

Errors are in millimeters, degrees and pixels, as results are published in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.objects import HeldObject, ObjectModel
from fungrasp.perception import Capture
from fungrasp.perception.hand.contact_evidence import touching_links
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.perceived import Perceived, StageSeconds
from fungrasp.perception.pipeline import perceive
from fungrasp.perception.scene.segmentation import TIPS

RIGHT_MM = 10.0
"""An object's pose is right if its ADD-S is below this."""

HIDDEN = 0.022
"""A joint is hidden if something else is seen so far in front of it [m]: skin is 8 to 15 mm in front."""

TIP_LINKS = (3, 6, 9, 12, 15)
"""Index in ``link_contacts`` of the distal link that each of ``TIPS`` ends."""


class KnownCapture(Protocol):
    """A capture and the truth about it, as ``captures.render_capture.SyntheticCapture``."""

    @property
    def capture(self) -> Capture:
        """The image with its depth and intrinsics, without mask and box."""
        ...

    @property
    def grasp(self) -> HumanGrasp:
        """The true grasp, world frame."""
        ...

    @property
    def pose_camera_object(self) -> np.ndarray:
        """True pose of the object in the camera frame, shape [7]."""
        ...

    @property
    def joints_camera(self) -> np.ndarray:
        """True joints of the hand [m], camera frame, shape [21, 3]."""
        ...

    @property
    def object_mask(self) -> np.ndarray:
        """Pixels that show the object, shape [H, W] bool."""
        ...


@dataclass(frozen=True)
class HandResult:
    """One hand against the truth. What was not found has NaN."""

    found: bool
    """Whether a hand was found whose landmarks are nearer to the true hand than its size."""
    score: float = 0.0
    """Score of the estimate, 0 to 1."""
    right_side: bool = False
    """Whether it was taken for a right hand, which it is."""
    pixel_error: float = float("nan")
    """Median distance of the landmarks from the projected joints [pixels of an image 640 wide]."""
    joint_error_mm: float = float("nan")
    """Mean distance of the joints from the true ones [mm], before the object is known."""
    refined_joint_error_mm: float = float("nan")
    """Mean distance of the joints from the true ones [mm], after refinement against the object."""
    tip_error_mm: float = float("nan")
    """Mean error of the fingertips that truly touch the object [mm], after refinement."""
    hidden_joint_error_mm: float = float("nan")
    """Mean error of the joints that the image does not show [mm], after refinement; see ``hidden_joints``."""
    hidden_tip_error_mm: float = float("nan")
    """The same of fingertips."""
    hidden_contacts_right: float = float("nan")
    """Part of those fingertips of which it is right whether their links touch the object."""


@dataclass(frozen=True)
class PoseResult:
    """One answer to where the object is, against the truth."""

    add_s_mm: float
    """Average distance of the true surface from the nearest point of the found one (ADD-S) [mm]."""
    rotation_deg: float
    """Angle between the found and the true rotation [degrees]; large where an equivalent rotation of a
    symmetric object was found."""
    score: float
    """Score of the estimate, 0 to 1."""
    accepted: bool
    """Whether the score passes the threshold."""
    evidence: dict[str, float]
    """What the score is made of."""

    @property
    def right(self) -> bool:
        """Whether ADD-S is below ``RIGHT_MM``."""
        return self.add_s_mm < RIGHT_MM


@dataclass(frozen=True)
class AbsentResult:
    """What was made of images that lack the hand, or the object."""

    hand_score: float
    """Probability of the hand found where there is none; 0 where none was found."""
    pose: PoseResult
    """The object's pose in a hand that holds nothing: never right."""


@dataclass(frozen=True)
class CaptureResult:
    """What perception made of one capture."""

    object_name: str
    """Name of the object."""
    hand: HandResult
    """The hand that was found, against the truth."""
    masked: PoseResult
    """The object's pose with the true mask."""
    unmasked: PoseResult
    """The object's pose from the image alone."""
    wrong_mesh: PoseResult | None
    """An answer that can't be right: with the true mask and the mesh of another object."""
    absent: AbsentResult | None
    """Answers to the images that lack the hand or the object; None where it was not tried."""
    seconds: dict[str, StageSeconds]
    """Time of each stage: "mesh" (made ready, once for all images of it), "hand" (detection and metric fit),
    "object_masked", "object_unmasked", "perceive" (all of ``perceive`` without a mask); those that came to
    an end."""
    sure: bool
    """Whether ``perceive`` was confident of the grasp: ``Perceived.confident``."""


def measure_perception(
    known: KnownCapture,
    model: ObjectModel,
    detector: HandDetector,
    other: ObjectModel | None = None,
    colored: trimesh.Trimesh | None = None,
    absent: AbsentResult | None = None,
) -> tuple[CaptureResult, HumanGraspSet | None]:
    """Run perception on one capture, stage by stage.

    Args:
        known: the capture and its truth.
        model: the object.
        detector: finds hands.
        other: another object, whose mesh must not be accepted; not tried if None.
        colored: the object's mesh with colors, if perception is to know them.
        absent: goes into the result.

    Returns:
        the numbers; the grasp that ``perceive`` gave, in a world of its own, None where
        it is no grasp that could be tried.
    """
    capture, obj = known.capture, HeldObject(model, colored)
    masked = capture.with_object(mask=known.object_mask) if known.object_mask.any() else capture
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, 3000, seed=0)[0])
    seen = perceived(capture, obj, detector)
    with_mask = perceived(masked, obj, detector)
    wrong = None if other is None else perceived(masked, HeldObject(other), detector)
    truth = known.pose_camera_object
    result = CaptureResult(
        object_name=str(known.grasp.object_name),
        hand=HandResult(False) if seen is None else _hand_result(known, model, seen),
        masked=_pose_result(with_mask, points, truth),
        unmasked=_pose_result(seen, points, truth),
        wrong_mesh=None if other is None else _pose_result(wrong, points, None),
        seconds=_seconds(seen, with_mask),
        absent=absent,
        sure=seen is not None and seen.confident,
    )
    try:
        return result, None if seen is None else seen.grasps
    except FungraspError:
        return result, None


def perceived(capture: Capture, obj: HeldObject, detector: HandDetector) -> Perceived | None:
    """What ``perceive`` makes of an image; None where it finds no hand.

    Args:
        capture: the image, with what is said of the object's place.
        obj: the object.
        detector: finds hands.
    """
    try:
        return perceive(capture, obj, detector=detector)
    except FungraspError:
        return None


def measure_absent(
    no_hand: Capture, no_object: Capture, model: ObjectModel, detector: HandDetector
) -> AbsentResult:
    """What perception makes of images of the same scene without the hand, and without the object."""
    seen = perceived(no_hand, HeldObject(model), detector)
    empty = perceived(no_object, HeldObject(model), detector)
    return AbsentResult(
        0.0 if seen is None else seen.verdict.hand, _pose_result(empty, np.asarray(model.vertices), None)
    )


def together(seconds: Mapping[str, StageSeconds], *stages: str) -> StageSeconds:
    """The time of some stages; all if none is named."""
    chosen = [seconds[stage] for stage in stages or seconds if stage in seconds]
    return StageSeconds(sum(one.wall for one in chosen), sum(one.cpu for one in chosen))


def _seconds(seen: Perceived | None, with_mask: Perceived | None) -> dict[str, StageSeconds]:
    found = {}
    if seen is not None:
        times = seen.trace.seconds
        found["mesh"] = together(times, "mesh")
        found["hand"] = together(times, "detection", "hand")
        found["object_unmasked"] = together(times, "object")
        found["perceive"] = together({stage: time for stage, time in times.items() if stage != "mesh"})
    if with_mask is not None:
        found["object_masked"] = together(with_mask.trace.seconds, "object")
    return found


def hidden_joints(known: KnownCapture) -> np.ndarray:
    """Joints where the image shows the object, or something ``HIDDEN`` in front of them, bool, shape [21]."""
    lens, truth = known.capture.intrinsics, known.joints_camera
    column, row = np.rint(lens.project(truth)).astype(int).T
    column, row = np.clip(column, 0, lens.width - 1), np.clip(row, 0, lens.height - 1)
    depth = known.capture.depth[row, column]
    return known.object_mask[row, column] | ((depth > 0) & (truth[:, 2] - depth > HIDDEN))


def _hand_result(known: KnownCapture, model: ObjectModel, seen: Perceived) -> HandResult:
    hand = seen.trace.candidate.hand
    truth = known.joints_camera
    k = known.capture.intrinsics
    pixels = k.project(truth)
    off = np.linalg.norm(hand.pixels - pixels, axis=1)
    errors = 1000 * np.linalg.norm(hand.joints_camera - truth, axis=1)
    joints = seen.hand.joints_camera
    refined_errors = 1000 * np.linalg.norm(joints - truth, axis=-1)
    touching = known.grasp.link_contacts[list(TIP_LINKS)]
    tips = refined_errors[list(TIPS)]
    hidden = hidden_joints(known)
    hidden_tips = hidden[list(TIPS)]
    nan = float("nan")
    surface, pose = model.signed_distance, known.pose_camera_object
    right = [touching_links(one, surface, pose)[list(TIP_LINKS)][hidden_tips] for one in (joints, truth)]
    return HandResult(
        found=bool(np.median(off) < 0.5 * np.linalg.norm(np.ptp(pixels, axis=0))),
        score=hand.score,
        right_side=hand.side == "right",
        pixel_error=float(np.median(off)) * 640 / k.width,
        joint_error_mm=float(errors.mean()),
        refined_joint_error_mm=float(refined_errors.mean()),
        tip_error_mm=float(tips[touching].mean()) if touching.any() else nan,
        hidden_joint_error_mm=float(refined_errors[hidden].mean()) if hidden.any() else nan,
        hidden_tip_error_mm=float(tips[hidden_tips].mean()) if hidden_tips.any() else nan,
        hidden_contacts_right=float((right[0] == right[1]).mean()) if hidden_tips.any() else nan,
    )


def _pose_result(seen: Perceived | None, points: np.ndarray, truth: np.ndarray | None) -> PoseResult:
    """truth: pose, shape [7]; None if no pose is right."""
    if seen is None:
        return PoseResult(float("inf"), float("nan"), 0.0, False, {})
    best = seen.trace.candidate.object
    pose = best.pose_camera_object
    return PoseResult(
        add_s_mm=float("inf") if truth is None else 1000 * float(add_s(points, pose, truth)),
        rotation_deg=float("nan") if truth is None else float(np.degrees(rotation_error(pose, truth))),
        score=best.score,
        accepted=best.accepted,
        evidence=seen.trace.candidate.evidence,
    )
