"""How well perception does on captures whose truth is known, stage by stage, and how long it takes.

Errors are in millimeters, degrees and pixels, as results are published in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter, process_time
from types import TracebackType
from typing import Protocol

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture, HandEstimate
from fungrasp.perception.hand.contact_evidence import touching_links
from fungrasp.perception.hand.detected_hand import DetectedHand, HandDetector, choose_hand, find_hands
from fungrasp.perception.hand.fit import fit_hand
from fungrasp.perception.io.capture import Box
from fungrasp.perception.object_pose.confidence import FEATURES, features
from fungrasp.perception.object_pose.estimate import PoseAnswers, best_estimate, search_object_pose
from fungrasp.perception.object_pose.known_object import known_object
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive
from fungrasp.perception.scene.segmentation import TIPS
from fungrasp.perception.scene.table import NO_TABLE, table_under

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
    expected_hidden_error_mm: float = float("nan")
    """Mean error of the hidden joints [mm], over all hands that ``perceive`` gave, by their probabilities."""
    best_hidden_error_mm: float = float("nan")
    """The same of the best of those hands."""
    hidden_energy_score_mm: float = float("nan")
    """Expected error of the hidden joints less half of how far apart two of those hands are [mm]: a proper
    score, least for hands that are as probable as they say; of a single hand it is its error."""


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
    """Highest score of a hand found where there is none; 0 where none was found."""
    pose: PoseResult
    """The object's pose in a hand that holds nothing: never right."""


@dataclass(frozen=True)
class Seconds:
    """How long something took."""

    wall: float
    """Wall time [s]."""
    cpu: float
    """Processor time of all threads together [s]; less than ``wall`` where other programs had the
    processors."""


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
    seconds: dict[str, Seconds]
    """Time of each stage: "mesh" (made ready, once for all images of it), "hand" (detection and metric fit),
    "object_masked", "object_unmasked", "perceive" (all of ``perceive`` without a mask)."""
    sure: bool
    """Whether ``perceive`` was confident of the grasp: ``Perceived.confident``."""


class Stopwatch:
    """Measures what happens inside ``with``."""

    seconds = Seconds(float("nan"), float("nan"))

    def __enter__(self) -> Stopwatch:
        self._start = (perf_counter(), process_time())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.seconds = Seconds(perf_counter() - self._start[0], process_time() - self._start[1])


class _FixedHands:
    """A detector that has its answer already."""

    def __init__(self, hands: list[DetectedHand]):
        self._hands = hands

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        return self._hands


def measure_perception(
    known: KnownCapture,
    model: ObjectModel,
    detector: HandDetector,
    other: ObjectModel | None = None,
    colored: trimesh.Trimesh | None = None,
    count: int = 1,
    absent: AbsentResult | None = None,
) -> tuple[CaptureResult, HumanGraspSet | None]:
    """Run perception on one capture, stage by stage.

    Args:
        known: the capture and its truth.
        model: the object.
        detector: finds hands.
        other: another object, whose mesh must not be accepted; not tried if None.
        colored: the object's mesh with colors, if perception is to know them.
        count: hands that are asked for, at most.
        absent: goes into the result.

    Returns:
        the numbers; the hands that ``perceive`` gave, the best first, in a world of their own, None where
        they are no grasp that could be tried.
    """
    capture, mesh = known.capture, model if colored is None else colored
    masked = capture.with_object(mask=known.object_mask) if known.object_mask.any() else capture
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, 3000, seed=0)[0])
    hand = None
    with Stopwatch() as mesh_watch:
        known_object(mesh)
    with Stopwatch() as hand_watch:
        hands = find_hands(detector, capture)
        if hands:
            hand = fit_hand(choose_hand(hands)[0], capture)
    with Stopwatch() as table_watch:
        table, under = None, None
        if hand is not None:
            table = table_under(capture, hand.joints_camera, np.random.default_rng(0))
            under = NO_TABLE if table is None else table
    with Stopwatch() as masked_watch:
        with_mask = search_object_pose(masked, mesh, hand, under)
    with Stopwatch() as unmasked_watch:
        without = search_object_pose(capture, mesh, hand, under)
    perceived = None
    with Stopwatch() as rest_watch:
        if hand is not None:
            perceived = perceive(
                capture,
                model,
                table=table,
                object_estimate=best_estimate(without),
                detector=_FixedHands(hands),
                hands=count,
            )
    parts = (hand_watch, table_watch, unmasked_watch, rest_watch)
    wrong = None if other is None else search_object_pose(masked, other, hand, under)
    truth = known.pose_camera_object
    result = CaptureResult(
        object_name=str(known.grasp.object_name),
        hand=_hand_result(known, model, hand, perceived),
        masked=_pose_result(with_mask, points, truth),
        unmasked=_pose_result(without, points, truth),
        wrong_mesh=None if wrong is None else _pose_result(wrong, points, None),
        seconds={
            "mesh": mesh_watch.seconds,
            "hand": hand_watch.seconds,
            "object_masked": masked_watch.seconds,
            "object_unmasked": unmasked_watch.seconds,
            "perceive": Seconds(
                sum(part.seconds.wall for part in parts), sum(part.seconds.cpu for part in parts)
            ),
        },
        absent=absent,
        sure=perceived is not None and perceived.confident,
    )
    if perceived is None:
        return result, None
    try:
        return result, grasp_set([one.grasp for one in perceived.hands])
    except FungraspError:
        return result, None


def grasp_set(grasps: Sequence[HumanGrasp]) -> HumanGraspSet:
    """Some grasps, as hands whose joints are not known by angle.

    Raises:
        FungraspError: one is no grasp, see ``HumanGraspSet``.
    """
    parts = [grasp.probability for grasp in grasps]
    return HumanGraspSet(
        object_name=np.array([grasp.object_name for grasp in grasps]),
        object_mass=np.array([grasp.object_mass for grasp in grasps]),
        object_pose=np.stack([grasp.object_pose for grasp in grasps]),
        object_rest_pose=np.stack([grasp.object_rest_pose for grasp in grasps]),
        hand_joints=np.stack([grasp.hand_joints for grasp in grasps]),
        link_contacts=np.stack([grasp.link_contacts for grasp in grasps]),
        task=np.array([grasp.task for grasp in grasps]),
        probability=None if None in parts else np.array(parts, dtype=float),
    )


def measure_absent(
    no_hand: Capture, no_object: Capture, model: ObjectModel, detector: HandDetector
) -> AbsentResult:
    """What perception makes of images of the same scene without the hand, and without the object."""
    hands = [fit_hand(hand, no_hand) for hand in find_hands(detector, no_hand)]
    seen = find_hands(detector, no_object)
    hand = fit_hand(choose_hand(seen)[0], no_object) if seen else None
    pose = search_object_pose(no_object, model, hand)
    points = np.asarray(model.vertices)
    return AbsentResult(max((hand.score for hand in hands), default=0.0), _pose_result(pose, points, None))


def hidden_joints(known: KnownCapture) -> np.ndarray:
    """Joints where the image shows the object, or something ``HIDDEN`` in front of them, bool, shape [21]."""
    lens, truth = known.capture.intrinsics, known.joints_camera
    column, row = np.rint(lens.project(truth)).astype(int).T
    column, row = np.clip(column, 0, lens.width - 1), np.clip(row, 0, lens.height - 1)
    depth = known.capture.depth[row, column]
    return known.object_mask[row, column] | ((depth > 0) & (truth[:, 2] - depth > HIDDEN))


def _hand_result(
    known: KnownCapture, model: ObjectModel, hand: HandEstimate | None, perceived: Perceived | None
) -> HandResult:
    if hand is None:
        return HandResult(False)
    truth = known.joints_camera
    k = known.capture.intrinsics
    pixels = k.project(truth)
    off = np.linalg.norm(hand.pixels - pixels, axis=1)
    errors = 1000 * np.linalg.norm(hand.joints_camera - truth, axis=1)
    several = [(hand.joints_camera, 1.0)]
    if perceived is not None:
        several = [(one.hand.joints_camera, one.probability) for one in perceived.hands]
    joints = np.array([one for one, _ in several])
    probability = np.array([part for _, part in several])
    refined_errors = 1000 * np.linalg.norm(joints - truth, axis=-1)
    touching = known.grasp.link_contacts[list(TIP_LINKS)]
    tips = refined_errors[0, list(TIPS)]
    hidden = hidden_joints(known)
    hidden_tips = hidden[list(TIPS)]
    nan, hidden_errors = float("nan"), np.full(len(joints), np.nan)
    apart = np.zeros((len(joints), len(joints)))
    if hidden.any():
        hidden_errors = refined_errors[:, hidden].mean(axis=1)
        apart = 1000 * np.linalg.norm((joints[:, None] - joints)[:, :, hidden], axis=-1).mean(axis=-1)
    surface, pose = model.signed_distance, known.pose_camera_object
    right = [touching_links(one, surface, pose)[list(TIP_LINKS)][hidden_tips] for one in (joints[0], truth)]
    expected = float(probability @ hidden_errors)
    return HandResult(
        found=bool(np.median(off) < 0.5 * np.linalg.norm(np.ptp(pixels, axis=0))),
        score=hand.score,
        right_side=hand.side == "right",
        pixel_error=float(np.median(off)) * 640 / k.width,
        joint_error_mm=float(errors.mean()),
        refined_joint_error_mm=float(refined_errors[0].mean()),
        tip_error_mm=float(tips[touching].mean()) if touching.any() else nan,
        hidden_joint_error_mm=float(hidden_errors[0]),
        hidden_tip_error_mm=float(tips[hidden_tips].mean()) if hidden_tips.any() else nan,
        hidden_contacts_right=float((right[0] == right[1]).mean()) if hidden_tips.any() else nan,
        expected_hidden_error_mm=expected,
        best_hidden_error_mm=float(hidden_errors.min()),
        hidden_energy_score_mm=expected - 0.5 * float(probability @ apart @ probability),
    )


def _pose_result(answers: PoseAnswers, points: np.ndarray, truth: np.ndarray | None) -> PoseResult:
    """truth: pose, shape [7]; None if no pose is right."""
    best = best_estimate(answers)
    pose = best.pose_camera_object
    values = features(answers.scores)[0].tolist()
    return PoseResult(
        add_s_mm=float("inf") if truth is None else 1000 * float(add_s(points, pose, truth)),
        rotation_deg=float("nan") if truth is None else float(np.degrees(rotation_error(pose, truth))),
        score=best.score,
        accepted=best.accepted,
        evidence={} if answers.problem is not None else dict(zip(FEATURES, values, strict=True)),
    )
