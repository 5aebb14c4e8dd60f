"""Perception on a validation set of real captures: the object with and without hints, and the hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage

from benchmarks.perception.figures import rate_of
from benchmarks.perception.measurements import RIGHT_MM, Stopwatch
from benchmarks.perception.recorded_captures import RecordedCapture
from fungrasp.evaluation.results import finite
from fungrasp.perception import Capture, HandEstimate, ObjectEstimate
from fungrasp.perception.hand.detected_hand import (
    DetectedHand,
    HandDetector,
    choose_hand,
    find_hands,
    largest_first,
    settle_side,
)
from fungrasp.perception.hand.fit import fit_hand
from fungrasp.perception.hand.meant_hands import hands_elsewhere, may_hold, object_box
from fungrasp.perception.object_pose.confidence import FEATURES, features
from fungrasp.perception.object_pose.estimate import best_estimate, search_object_pose
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.pipeline import ACCEPTED_HAND
from fungrasp.perception.scene.table import NO_TABLE, table_under

LOOSE = 6
"""Masks are made larger and smaller by so many pixels."""

LEFT = 0.3
"""A mask is made smaller by fewer pixels if less than this part of it would be left: thin ones would
vanish."""

BOX_MARGIN = 0.1
"""A person's box round an object is wider than the object by this part on each side."""


_HandAndTable = tuple[HandEstimate | None, np.ndarray | None]
"""A hand and the table's plane under it."""

_NOBODY: _HandAndTable = (None, None)


@dataclass(frozen=True)
class HintResult:
    """One answer to where the object is."""

    hint: str
    """What was told: "none", "box", "click", "mask", "mask larger" or "mask smaller"."""
    add_s_mm: float
    """ADD-S [mm]; infinite if there is no answer."""
    shift_mm: float
    """Distance of the mesh's middle from where it truly is [mm]."""
    rotation_deg: float
    """Angle between the rotations [degrees], not reduced by symmetries."""
    score: float
    """Of the answer, 0 to 1."""
    accepted: bool
    """Whether it passed the threshold."""
    seconds: float
    """Wall time [s], without the hand."""
    pose: tuple[float, ...]
    """The answer, shape [7]."""
    evidence: dict[str, float]
    """What the score is made of."""
    note: str
    """Why it is uncertain."""

    @property
    def right(self) -> bool:
        """Whether ADD-S is below ``RIGHT_MM``."""
        return self.add_s_mm < RIGHT_MM


@dataclass(frozen=True)
class RecordedResult:
    """What perception made of one real capture."""

    name: str
    """Of the capture."""
    hand_found: bool | None
    """Whether the true hand was found; None where none is known."""
    hand_sure: bool
    """Whether a hand was found at all with a score that counts."""
    pixel_error: float
    """Median distance of the landmarks from the joints seen [pixels of an image 640 wide]."""
    joint_error_mm: float
    """Mean distance of the joints from those known [mm]."""
    table_angle_deg: float
    """Angle between the planes of the table [degrees]."""
    table_height_mm: float
    """Difference of the heights of the table under the object, or under the hand [mm]."""
    hand_seconds: float
    """Time for hand and table [s]."""
    objects: tuple[HintResult, ...]
    """Answers to where the object is, one for each hint; none where no object is known."""


def hinted_captures(recorded: RecordedCapture) -> dict[str, Capture]:
    """The capture with each hint that its mask gives, by the name of the hint; without a mask only "none"."""
    capture, mask = recorded.capture, recorded.capture.mask
    found = {"none": capture.with_object()}
    if mask is None:
        return found
    rows, columns = np.nonzero(mask)
    width, height = np.ptp(columns) + 1, np.ptp(rows) + 1
    box = (
        float(columns.min() - BOX_MARGIN * width),
        float(rows.min() - BOX_MARGIN * height),
        float(columns.max() + BOX_MARGIN * width),
        float(rows.max() + BOX_MARGIN * height),
    )
    found["box"] = capture.with_object(box=box)
    # Where a person would click: deepest inside.
    depth = np.asarray(ndimage.distance_transform_edt(mask))
    v, u = np.unravel_index(int(depth.argmax()), depth.shape)
    found["click"] = capture.with_object(point=(float(u), float(v)))
    found["mask"] = capture
    found["mask larger"] = capture.with_object(mask=np.asarray(ndimage.binary_dilation(mask, _disc(LOOSE))))
    found["mask smaller"] = capture.with_object(mask=smaller_mask(mask))
    return found


def smaller_mask(mask: np.ndarray) -> np.ndarray:
    """A mask less ``LOOSE`` pixels at its border, or as many as leave ``LEFT`` of it. Shape [H, W] bool."""
    depth = np.asarray(ndimage.distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1]
    for pixels in range(LOOSE, 0, -1):
        inner = depth > pixels
        if inner.sum() >= LEFT * mask.sum():
            return inner
    return mask


def _disc(radius: int) -> np.ndarray:
    v, u = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return u**2 + v**2 <= radius**2


def measure_recorded(recorded: RecordedCapture, detector: HandDetector) -> RecordedResult:
    """Run perception on one real capture, with each hint that its mask gives."""
    capture = recorded.capture.with_object()
    with Stopwatch() as watch:
        hands = find_hands(detector, capture)
        # As ``perceive`` does: where it is open which of two hands is meant, both go on.
        held = [_with_table(hand, capture) for hand in largest_first(hands)[:2]]
    answers, chosen = [], held[0] if held else _NOBODY
    if recorded.model is not None and recorded.pose_camera_object is not None:
        for hint, hinted in hinted_captures(recorded).items():
            near = object_box(hinted, recorded.model, None)
            meant = held or [_NOBODY]
            if near is not None and len(hands) > 1:
                meant = [_with_table(choose_hand(hands, near)[0], capture)]
            answer, one = _best_answer(recorded, hint, hinted, meant)
            if hint == "none" and hands and not _held(recorded, answer, one):
                more = hands_elsewhere(capture, hands, None, detector)
                held += [_under(fit_hand(one.detected, capture), capture) for one in more]
                answer, one = _best_answer(recorded, hint, hinted, held) if more else (answer, one)
            answers.append(answer)
            chosen = one if hint == "none" else chosen
    hand, table = chosen
    found, pixels, joints = _hand_error(recorded, hand)
    angle, height = _table_error(recorded, table)
    sure = hand is not None and hand.score >= ACCEPTED_HAND
    return RecordedResult(
        recorded.name, found, sure, pixels, joints, angle, height, watch.seconds.wall, tuple(answers)
    )


def _with_table(detected: DetectedHand, capture: Capture) -> _HandAndTable:
    return _under(fit_hand(settle_side(detected)[0], capture), capture)


def _under(hand: HandEstimate, capture: Capture) -> _HandAndTable:
    """A hand with the table under it."""
    return hand, table_under(capture, hand.joints_camera, np.random.default_rng(0))


def _best_answer(
    recorded: RecordedCapture, hint: str, hinted: Capture, meant: Sequence[_HandAndTable]
) -> tuple[HintResult, _HandAndTable]:
    """The answer with the hand that holds the object more probably, with the time for all of them."""
    answers = []
    for hand, table in meant:
        under = table if hand is None or table is not None else NO_TABLE
        answers.append(_answer(recorded, hint, hinted, hand, under))
    worth = [
        (_held(recorded, answer, one), answer.score * (1.0 if one[0] is None else one[0].score))
        for answer, one in zip(answers, meant, strict=True)
    ]
    best = max(range(len(worth)), key=lambda i: worth[i])
    return replace(answers[best], seconds=sum(answer.seconds for answer in answers)), meant[best]


def _held(recorded: RecordedCapture, answer: HintResult, one: _HandAndTable) -> bool:
    """Whether the object was found, and the hand at it."""
    assert recorded.model is not None
    found = ObjectEstimate(np.array(answer.pose), answer.score, answer.accepted)
    return one[0] is not None and may_hold(one[0], found, np.asarray(recorded.model.vertices))


def _answer(
    recorded: RecordedCapture,
    hint: str,
    capture: Capture,
    hand: HandEstimate | None,
    table: np.ndarray | None,
) -> HintResult:
    model, truth = recorded.model, recorded.pose_camera_object
    assert model is not None and truth is not None
    mesh = model if recorded.colored is None else recorded.colored
    with Stopwatch() as watch:
        answers = search_object_pose(capture, mesh, hand, table)
        best = best_estimate(answers)
    pose = best.pose_camera_object
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, 3000, seed=0)[0])
    return HintResult(
        hint=hint,
        add_s_mm=1000 * float(add_s(points, pose, truth)),
        shift_mm=1000 * float(np.linalg.norm(pose[:3] - truth[:3])),
        rotation_deg=float(np.degrees(rotation_error(pose, truth))),
        score=best.score,
        accepted=best.accepted,
        seconds=watch.seconds.wall,
        pose=tuple(pose.tolist()),
        evidence=dict(zip(FEATURES, features(answers.scores)[0].tolist(), strict=True)),
        note=best.note,
    )


def _hand_error(recorded: RecordedCapture, hand: HandEstimate | None) -> tuple[bool | None, float, float]:
    """Whether the true hand was found, error of its landmarks [pixels] and of its joints [mm]."""
    seen, joints = recorded.joint_pixels, recorded.joints_camera
    if seen is None and joints is None:
        return None, float("nan"), float("nan")
    if hand is None:
        return False, float("nan"), float("nan")
    k = recorded.capture.intrinsics
    if seen is None:
        assert joints is not None
        seen = k.project(joints)
    off = np.linalg.norm(hand.pixels - seen, axis=1)
    size = float(np.linalg.norm(np.nanmax(seen, axis=0) - np.nanmin(seen, axis=0)))
    pixels = float(np.nanmedian(off))
    apart = float("nan")
    if joints is not None:
        apart = 1000 * float(np.nanmean(np.linalg.norm(hand.joints_camera - joints, axis=1)))
    return pixels < 0.5 * size, pixels * 640 / k.width, apart


def _table_error(recorded: RecordedCapture, table: np.ndarray | None) -> tuple[float, float]:
    """Angle [degrees] and difference of heights [mm]."""
    truth = recorded.table
    if truth is None or table is None:
        return float("nan"), float("nan")
    length = float(np.linalg.norm(truth[:3]))
    angle = float(np.degrees(np.arccos(np.clip(truth[:3] @ table[:3] / length, -1.0, 1.0))))
    if recorded.pose_camera_object is not None:
        place = recorded.pose_camera_object[:3]
    elif recorded.joints_camera is not None:
        place = np.nanmean(recorded.joints_camera, axis=0)
    else:
        return angle, float("nan")
    heights = (truth[:3] @ place + truth[3]) / length, table[:3] @ place + table[3]
    return angle, 1000 * float(abs(heights[0] - heights[1]))


def recorded_figures(results: Sequence[RecordedResult]) -> dict[str, Any]:
    """Rates and errors over the captures, by hint."""
    hints = list(dict.fromkeys(answer.hint for result in results for answer in result.objects))
    objects = {}
    for hint in hints:
        answers = [answer for result in results for answer in result.objects if answer.hint == hint]
        accepted = [answer.right for answer in answers if answer.accepted]
        objects[hint] = {
            "right": rate_of([answer.right for answer in answers]),
            "add_s_mm": float(np.median([answer.add_s_mm for answer in answers])),
            "accepted_and_right": rate_of(accepted),
            "right_and_accepted": rate_of([answer.accepted for answer in answers if answer.right]),
            "seconds": float(np.median([answer.seconds for answer in answers])),
        }
    known = [result for result in results if result.hand_found is not None]
    return finite(
        {
            "captures": len(results),
            "hand": {
                "found": rate_of([bool(result.hand_found) for result in known]),
                "pixel_error": _median([result.pixel_error for result in known]),
                "joint_error_mm": _median([result.joint_error_mm for result in known]),
                "seconds": _median([result.hand_seconds for result in results]),
            },
            "no_hand_sure": rate_of([result.hand_sure for result in results if result.hand_found is None]),
            "table": {
                "angle_deg": _median([result.table_angle_deg for result in results]),
                "height_mm": _median([result.table_height_mm for result in results]),
            },
            "object": objects,
        }
    )


def recorded_rows(results: Sequence[RecordedResult]) -> list[dict[str, Any]]:
    """A row for each answer about an object, and for each capture without; ready for JSON."""
    rows = []
    for result in results:
        capture = {name: value for name, value in asdict(result).items() if name != "objects"}
        rows += [capture | {"object": asdict(answer)} for answer in result.objects] or [capture]
    return finite(rows)


def recorded_table(figures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The object's figures as a table, by hint."""
    rows = [
        ("told", "ADD-S < 10 mm", "median [mm]", "accepted are right", "right are accepted", "median [s]")
    ]
    for hint, found in figures["object"].items():
        rows.append(
            (
                hint,
                _counted(found["right"]),
                f"{found['add_s_mm']:.1f}",
                _counted(found["accepted_and_right"]),
                _counted(found["right_and_accepted"]),
                f"{found['seconds']:.2f}",
            )
        )
    return rows


def _counted(rate: Mapping[str, Any] | None) -> str:
    if rate is None:
        return "none"
    return f"{round(rate['rate'] * rate['count'])} of {rate['count']}"


def _median(values: Sequence[float]) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else None
