"""Whether a frame of a camera shows all that perception needs, and what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fungrasp.core.errors import UnknownNameError
from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.camera.frames import CameraFrame
from fungrasp.perception.estimates import ObjectEstimate
from fungrasp.perception.hand.detected_hand import HAND_LENGTH, DetectedHand, largest_first
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.scene.table import table_under

NEAREST = 0.3
"""Depth cameras for robots measure nothing nearer than this, or little [m]: the RealSense D435i's data sheet
says 0.28 m for its full resolution."""

FARTHEST = 1.3
"""Hands farther away [m] have too few pixels, and noise as thick as a finger."""

BORDER = 2.0
"""Landmarks nearer to the image's edge than this are cut off [pixels]."""

LIT = 40
"""If 19 of 20 pixels are darker than this, of 255, the image is too dark."""

SATURATED = 250
"""Where all three channels are at least this, of 255, a pixel is overexposed."""

OVEREXPOSED_HAND, OVEREXPOSED_IMAGE = 0.9, 0.5
"""Overexposed parts of the hand, and of the image if no hand is found, from which on it is said. Hands with
0.7 of their pixels overexposed are still found and fitted in measured images."""

MEASURED_HAND = 0.5
"""Less depth than at this part of the hand does not tell where it is."""

NEAR_PART = 0.1
"""If no hand is found but this part of the image is nearer than the camera measures well, that is said."""

SEEN_OBJECT = 0.5
"""Poses of a lower score are more probably wrong than right: the object is not seen."""

PROBLEMS: Mapping[str, str] = {
    "too_dark": "too dark: more light, or a longer exposure",
    "overexposed": "overexposed: less light, or a shorter exposure",
    "no_depth": "the camera measures no depth at all: is its view covered?",
    "no_hand": "no hand",
    "cut_off": "the hand is cut off at the {edge} edge",
    "too_near": "too near: {distance:.2f} m, the camera needs {nearest:g}",
    "too_far": "too far: {distance:.2f} m, come within {farthest:g}",
    "no_hand_depth": "depth is missing on {percent:.0f} % of the hand: it shines, or is too near",
    "no_table": "no table",
    "object_not_seen": "the object is not seen: show more of it, or is it another one?",
    "moving": "hold still",
}
"""What may be missing, by code."""


@dataclass(frozen=True)
class FrameProblem:
    """One thing that is missing; ``str`` gives the words."""

    code: str
    """One of ``PROBLEMS``."""
    values: Mapping[str, float | str] = field(default_factory=dict)
    """Numbers and words of the sentence, by name; lengths in m."""

    def __post_init__(self) -> None:
        if self.code not in PROBLEMS:
            raise UnknownNameError("problem of a frame", self.code, PROBLEMS)

    @classmethod
    def of(cls, code: str, **values: float | str) -> FrameProblem:
        """A problem with its values."""
        return cls(code, values)

    def __str__(self) -> str:
        return PROBLEMS[self.code].format_map(self.values)


@dataclass(frozen=True, eq=False)
class FrameReadiness:
    """What was found in a frame, and what is missing."""

    problems: tuple[FrameProblem, ...]
    """Most important first; empty if the frame will do."""
    hand: DetectedHand | None = None
    """The hand, if there is one: the largest."""
    table: np.ndarray | None = None
    """Plane of the table ``[nx ny nz d]``, camera frame, shape [4]; None: not found, or not looked for."""


def judge_frame(
    frame: CameraFrame, hands: Sequence[DetectedHand], nearest: float = NEAREST
) -> FrameReadiness:
    """What is missing in a frame, the object apart.

    Args:
        frame: the images.
        hands: those found in it, see ``find_hands``.
        nearest: distance at which the camera begins to measure [m].
    """
    problems = []
    hand = largest_first(hands)[0] if hands else None
    exposure = _exposure(frame, hand)
    if exposure is not None:
        problems.append(exposure)
    if not (frame.depth > 0).any():
        return FrameReadiness((*problems, FrameProblem.of("no_depth")), hand)
    if hand is None:
        near = frame.depth[(frame.depth > 0) & (frame.depth < nearest)]
        if near.size > NEAR_PART * frame.depth.size:
            distance = float(np.median(near))
            problems.append(FrameProblem.of("too_near", distance=distance, nearest=nearest))
        return FrameReadiness((*problems, FrameProblem.of("no_hand")), None)
    edge = cut_edge(frame.intrinsics, hand.pixels)
    if edge is not None:
        problems.append(FrameProblem.of("cut_off", edge=edge))
    depth = _depth_along_bones(frame, hand)
    measured = depth[depth > 0]
    # Where depth is missing, the hand's size in the image says roughly how far it is.
    if measured.size:
        distance = float(np.median(measured))
    else:
        distance = HAND_LENGTH * frame.intrinsics.fx / hand.extent
    if distance < nearest:
        problems.append(FrameProblem.of("too_near", distance=distance, nearest=nearest))
    elif distance > FARTHEST:
        problems.append(FrameProblem.of("too_far", distance=distance, farthest=FARTHEST))
    elif measured.size < MEASURED_HAND * depth.size:
        missing = 100 * (1 - measured.size / max(depth.size, 1))
        problems.append(FrameProblem.of("no_hand_depth", percent=missing))
    joints = frame.intrinsics.deproject(hand.pixels, np.full(len(hand.pixels), distance))
    table = table_under(frame.capture(), joints, np.random.default_rng(0))
    if table is None:
        problems.append(FrameProblem.of("no_table"))
    return FrameReadiness(tuple(problems), hand, table)


def why_no_hand(capture: Capture) -> str:
    """What may be the reason that no hand is found, in words; empty if nothing is known."""
    frame = CameraFrame(capture.color, capture.depth, capture.intrinsics, 0.0)
    problems = [problem for problem in judge_frame(frame, []).problems if problem.code != "no_hand"]
    return "; ".join(map(str, problems))


def judge_object(estimate: ObjectEstimate) -> FrameProblem | None:
    """Whether the object is seen, by the estimate of its pose; None if it is."""
    return None if estimate.score >= SEEN_OBJECT else FrameProblem.of("object_not_seen")


def _exposure(frame: CameraFrame, hand: DetectedHand | None) -> FrameProblem | None:
    color = frame.color[::2, ::2]
    if np.percentile(color.mean(axis=-1), 95) < LIT:
        return FrameProblem.of("too_dark")
    if hand is None:
        burnt, limit = (color.min(axis=-1) >= SATURATED).mean(), OVEREXPOSED_IMAGE
    else:
        u, v = along_bones(frame.intrinsics, hand.pixels)
        if not len(u):
            return None
        burnt, limit = (frame.color[v, u].min(axis=-1) >= SATURATED).mean(), OVEREXPOSED_HAND
    return FrameProblem.of("overexposed") if burnt > limit else None


def cut_edge(lens: Intrinsics, pixels: np.ndarray) -> str | None:
    """The edge of the image beyond which most of a thing's pixels are, shape [N, 2]; None if none is."""
    u, v = pixels.T
    beyond = {
        "left": BORDER - u,
        "right": u - (lens.width - 1 - BORDER),
        "top": BORDER - v,
        "bottom": v - (lens.height - 1 - BORDER),
    }
    count = {edge: int((over > 0).sum()) for edge, over in beyond.items()}
    most = max(count, key=lambda edge: count[edge])
    return most if count[most] else None


def along_bones(lens: Intrinsics, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of pixels along a hand's bones, as far as they are in the image. pixels: of its
    joints, shape [21, 2]."""
    near, far = pixels[np.transpose(BONES)]
    part = np.linspace(0, 1, 8)[:, None, None]
    u, v = np.rint(near + part * (far - near)).astype(int).reshape(-1, 2).T
    inside = (u >= 0) & (u < lens.width) & (v >= 0) & (v < lens.height)
    return u[inside], v[inside]


def _depth_along_bones(frame: CameraFrame, hand: DetectedHand) -> np.ndarray:
    u, v = along_bones(frame.intrinsics, hand.pixels)
    return frame.depth[v, u]
