"""Perception on a validation set of real captures: the object with and without hints, and the hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from time import process_time
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage

from benchmarks.perception.recorded_captures import RecordedCapture
from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import finite
from fungrasp.evaluation import evaluate
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps.human_hand import mirror_pose
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel, ResolvedObject, builtin_object, mirrored_object
from fungrasp.objects.object_variants import scaled_object
from fungrasp.perception import Capture, HandEstimate
from fungrasp.perception.acceptance import ACCEPT
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive
from fungrasp.perception.scene.table import in_world, put_down
from fungrasp.retargeting import retarget

RIGHT_MM = 10.0
"""An object's pose is right if its ADD-S is below this."""

LOOSE = 6
"""Masks are made larger and smaller by so many pixels."""

LEFT = 0.3
"""A mask is made smaller by fewer pixels if less than this part of it would be left: thin ones would
vanish."""

BOX_MARGIN = 0.1
"""A person's box round an object is wider than the object by this part on each side."""


OTHER_OBJECT = "mug"
"""A built-in object that is looked for in captures of which no object is known."""


@dataclass(frozen=True)
class HintResult:
    """One answer to where the object is."""

    hint: str
    """What was said: "none", "box", "click", "mask", "mask larger" or "mask smaller"."""
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
    sure: bool
    """Whether hand and touch passed theirs as well."""
    seconds: float
    """Processor time of ``perceive`` [s]."""
    pose: tuple[float, ...]
    """The answer, shape [7]; empty if there is none."""
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
    held: bool
    """Whether the hand holds the object."""
    objects: tuple[HintResult, ...]
    """Answers to where the object is, one for each hint; none where no object is known."""
    wrong: tuple[bool, ...] = ()
    """Whether each of ``wrong_meshes`` was accepted, without a hint and with the mask, if that was tried."""


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


def measure_recorded(
    recorded: RecordedCapture, detector: HandDetector, *, wrong: bool = False
) -> RecordedResult:
    """Run ``perceive`` on one capture, with each hint that its mask gives."""
    known = recorded.model is not None and recorded.pose_camera_object is not None
    model = builtin_object(OTHER_OBJECT) if recorded.model is None else recorded.model
    obj = ResolvedObject(model, recorded.colored)
    hints = hinted_captures(recorded) if known else {"none": recorded.capture.with_object()}
    seen, seconds = {}, {}
    for hint, capture in hints.items():
        begun = process_time()
        seen[hint] = _perceived(capture, obj, detector)
        seconds[hint] = process_time() - begun
    alone = seen["none"]
    hand = None if alone is None else alone.candidates[0].hand
    table = None if alone is None else alone.candidates[0].table
    found, pixels, joints = _hand_error(recorded, hand)
    angle, height = _table_error(recorded, table)
    accepted: list[bool] = []
    if known and wrong:
        for other in wrong_meshes(model):
            for hint in ("none", "mask"):
                one = _perceived(hints[hint], ResolvedObject(other), detector) if hint in hints else None
                accepted.append(one is not None and one.object.accepted)
    return RecordedResult(
        recorded.name,
        found,
        alone is not None and alone.acceptance.hand >= ACCEPT,
        pixels,
        joints,
        angle,
        height,
        recorded.held,
        tuple(_answer(recorded, hint, one, seconds[hint]) for hint, one in seen.items()) if known else (),
        tuple(accepted),
    )


def _perceived(capture: Capture, obj: ResolvedObject, detector: HandDetector) -> Perceived | None:
    """What ``perceive`` makes of an image; None where it finds no hand, or nothing in it."""
    try:
        return perceive(capture, obj, detector=detector)
    except FungraspError:
        return None


def wrong_meshes(model: ObjectModel) -> list[ObjectModel]:
    """Meshes that are not the object's: other sizes, its longest or second side longer and shorter, another
    object."""
    found = [scaled_object(model, scale) for scale in (0.5, 0.67, 0.77, 1.3, 1.5, 2.0)]
    for side in np.argsort(model.size)[:0:-1].tolist():
        for factor in (0.7, 1.4):
            vertices = model.vertices * np.where(np.arange(3) == side, factor, 1.0)
            found.append(ObjectModel(f"{model.name} x {factor:g}", model.mass, vertices, model.faces))
    return [*found, builtin_object(OTHER_OBJECT if model.name != OTHER_OBJECT else "can")]


def lifted(recorded: RecordedCapture, detector: HandDetector, hand: str, policy: str) -> bool:
    """Whether a robot's hand lifts the true object from its true place by the grasp that is perceived."""
    model, truth = recorded.model, recorded.pose_camera_object
    assert model is not None and truth is not None
    seen = _perceived(recorded.capture.with_object(), ResolvedObject(model, recorded.colored), detector)
    if seen is None:
        return False
    model = replace(model, name="true")
    pose = in_world(seen.pose_world_camera, truth)
    rest = put_down(model, pose)
    if seen.hand.side == "left":
        model, pose, rest = mirrored_object(model), mirror_pose(pose), mirror_pose(rest)
    names = np.array([model.name])
    try:
        robot = retarget(seen.grasps, seen.objects, load_hand(hand))
    except FungraspError:
        return False
    robot = replace(robot, object_name=names, object_pose=pose[None], object_rest_pose=rest[None])
    return bool(evaluate(robot, {model.name: model}, policy).outcomes.success[0])


def _answer(recorded: RecordedCapture, hint: str, seen: Perceived | None, seconds: float) -> HintResult:
    model, truth = recorded.model, recorded.pose_camera_object
    assert model is not None and truth is not None
    if seen is None:
        nothing, nan = float("inf"), float("nan")
        return HintResult(hint, nothing, nothing, nan, 0.0, False, False, nan, (), {}, "no hand was found")
    best = seen.candidates[0]
    pose = best.object.pose_camera_object
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, 3000, seed=0)[0])
    return HintResult(
        hint=hint,
        add_s_mm=1000 * float(add_s(points, pose, truth)),
        shift_mm=1000 * float(np.linalg.norm(pose[:3] - truth[:3])),
        rotation_deg=float(np.degrees(rotation_error(pose, truth))),
        score=best.object.score,
        accepted=best.object.accepted,
        sure=seen.confident,
        seconds=seconds,
        pose=tuple(pose.tolist()),
        evidence={} if best.object.evidence is None else asdict(best.object.evidence),
        note="; ".join(seen.acceptance.help),
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


def rate_of(flags: Sequence[bool]) -> dict[str, Any] | None:
    """Share of the flags that are set, its count and interval; None where there is nothing to count."""
    if not flags:
        return None
    count = sum(flags)
    interval = wilson_interval(count, len(flags))
    return {"count": len(flags), "rate": count / len(flags), "interval": interval}


def recorded_figures(results: Sequence[RecordedResult], lifts: Sequence[bool] = ()) -> dict[str, Any]:
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
            "right_and_sure": rate_of(
                [a.sure for r in results if r.held for a in r.objects if a.hint == hint and a.right]
            ),
            "seconds": _median([answer.seconds for answer in answers]),
        }
    known = [result for result in results if result.hand_found is not None]
    return finite(
        {
            "captures": len(results),
            "hand": {
                "found": rate_of([bool(result.hand_found) for result in known]),
                "pixel_error": _median([result.pixel_error for result in known]),
                "joint_error_mm": _median([result.joint_error_mm for result in known]),
            },
            "lifted": rate_of(lifts),
            "wrong_meshes_accepted": rate_of([flag for result in results for flag in result.wrong]),
            "hovering_sure": rate_of([any(a.sure for a in r.objects) for r in results if not r.held]),
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
        capture = {name: value for name, value in asdict(result).items() if name not in ("objects", "wrong")}
        rows += [capture | {"object": asdict(answer)} for answer in result.objects] or [capture]
    return finite(rows)


def recorded_table(figures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The object's figures as a table, by hint."""
    rows = [
        (
            "hint",
            "ADD-S < 10 mm",
            "median [mm]",
            "accepted are right",
            "right are accepted",
            "right are sure",
            "median [s]",
        )
    ]
    for hint, found in figures["object"].items():
        rows.append(
            (
                hint,
                _counted(found["right"]),
                _number(found["add_s_mm"], 1),
                _counted(found["accepted_and_right"]),
                _counted(found["right_and_accepted"]),
                _counted(found["right_and_sure"]),
                _number(found["seconds"], 2),
            )
        )
    return rows


def _counted(rate: Mapping[str, Any] | None) -> str:
    if rate is None:
        return "none"
    return f"{round(rate['rate'] * rate['count'])} of {rate['count']}"


def _number(value: float | None, digits: int) -> str:
    return "none" if value is None else f"{value:.{digits}f}"


def _median(values: Sequence[float]) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else None
