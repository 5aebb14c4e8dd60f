"""Whether an answer can be used: a few quantities with their limits, and what would help.

Each quantity has a unit that means something, and is normalized by what the image itself shows: numbers of
pixels by the pixels that show the object, lengths in pixels by the image's size, fits at the noise of this
image's depth. So the limits are the same for every camera. They were chosen on renders of two kinds of depth
cameras (RealSense D435i, Xtion) and six images of one RealSense camera, between right answers and wrong
meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import isfinite, isnan, nan
from typing import Any

import numpy as np
from scipy.stats import chi2

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_grasp import MAX_HAND_DISTANCE
from fungrasp.grasps.human_hand import BONES, HAND_SIZE_SPREAD, hand_size
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.fit import OTHER_SIDE
from fungrasp.perception.hand.hand_measurements import median_depth
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, PoseEvidence
from fungrasp.perception.scene.pixel_classes import SMOOTHED

ACCEPT = 0.5
"""Score at which every quantity is just within its limit."""

UNEXPLAINED = 0.3
"""Most of the object's pixels, or of the mesh's silhouette, that do not agree [share]."""

WORSE = 2.0
"""Another size of the mesh must fit worse by so many standard errors of the share explained:
1 / sqrt(pixels)."""

SIDE = 1.0
"""Another length of one side may fit better by so many of them: the best of 18 does by chance."""

LARGER, OFF = 1.5, 4.5
"""Largest difference between the outlines in the image and of the mesh: of their size, and of their place in
the worst eighth [pixels of an image 640 wide]."""

LEFT_OVER = 0.2
"""How far what shows the object may reach beyond the mesh, as a part of the mesh's size."""

MASK_PIECE = 0.05
"""Largest connected piece of the mask beyond the mesh, as a part of the object's pixels."""

RIVAL = 0.97
"""Fit of the best different pose, as a part of this one's."""

HAND_SCORE, SURE_JOINTS = 0.6, 0.6
"""Least score of a hand by its detector, and least mean probability of its joints."""

TOUCHING = 2
"""Fewest parts of the hand, of palm and five fingers, that touch what is held."""

REACHED = 0.01
"""The three links nearest to the object are at most so far from it before the hand is fitted to it [m]."""

SURE_JOINT, WITHIN = 0.95, 0.02
"""Joints of a lower probability to be within so much of where they were found [m] are not called sure."""

CUT = 0.8
"""Part of the joints called sure that were within 20 mm in hands that the image's edge cut off (402 of 504,
68 crops of renders): fingers beyond it are found inside."""

SIZES, THICKEST = (0.01, 1.5), 0.25
"""Shortest and longest diagonal of an object that a hand holds [m], and its longest shortest side: a hand
spans some 0.2."""


@dataclass(frozen=True)
class Meter:
    """One quantity and its limit."""

    name: str
    """One of ``WORDS``."""
    value: float
    """In the unit; NaN where it is not known, which speaks neither for nor against."""
    limit: float
    """In the unit."""
    tolerance: float
    """By how much more than the limit the score falls to a quarter, in the unit."""
    least: bool = False
    """Whether the limit is the least that will do; else it is the most."""

    @property
    def words(self) -> str:
        """What it is."""
        return WORDS[self.name][0]

    @property
    def unit(self) -> str:
        """Of value and limit."""
        return WORDS[self.name][1]

    @property
    def excess(self) -> float:
        """How far the value is beyond its limit, in tolerances; negative within."""
        if isnan(self.value):
            return float("-inf")
        beyond = (self.limit - self.value) if self.least else (self.value - self.limit)
        return float(beyond / self.tolerance)

    @property
    def met(self) -> bool:
        """Whether the value is within its limit."""
        return self.excess <= 0.0


def score_of(meters: Sequence[Meter]) -> float:
    """1 / (1 + 3^excess) of the worst quantity: ``ACCEPT`` where it is at its limit."""
    worst = max(meter.excess for meter in meters)
    return float(1.0 / (1.0 + 3.0 ** np.clip(worst, -20.0, 20.0)))


WORDS = {
    "unexplained": ("pixels of object or mesh that do not agree", "%"),
    "other_size": ("fit of the mesh in another size, relative to its own", "%"),
    "other_side": ("fit with another side longer or shorter, relative", "%"),
    "larger": ("outline in the image larger or smaller than the mesh's, by", "pixels"),
    "off": ("outline in the image beside the mesh's, in the worst eighth, by", "pixels"),
    "left_over": ("how far the object reaches beyond the mesh, as a part of its size", "%"),
    "mask_piece": ("largest piece of the mask beyond the mesh, as a part of the object", "%"),
    "rival": ("fit of the best other pose, relative", "%"),
    "hand_score": ("hand: detector's score and agreement", "%"),
    "joints": ("hand: joints within 20 mm of where they are, expected", "%"),
    "touching": ("parts of the hand that touch the object", ""),
    "reach": ("distance of the hand's nearest links from the object, as measured", "mm"),
}
"""What each quantity is, and its unit."""


def object_meters(e: PoseEvidence) -> tuple[Meter, ...]:
    """What decides whether the pose, and the mesh, are right."""
    count = max(e.pixels, 1.0)
    noise = 100.0 / np.sqrt(count)
    piece = 100.0 * e.mask_piece / count if e.hinted == 1.0 else nan
    unexplained = 100.0 * (1.0 - min(e.explained, e.visible))
    # Value, limit and tolerance.
    found = {
        "unexplained": (unexplained, 100 * UNEXPLAINED, 10.0),
        "other_size": (100 * e.other_size, -WORSE * noise, 2 * noise),
        "other_side": (100 * e.other_side, SIDE * noise, 2 * noise),
        "larger": (abs(e.larger), LARGER, 1.0),
        "off": (e.off, OFF, 2.0),
        "left_over": (100 * e.left_over, 100 * LEFT_OVER, 10.0),
        "mask_piece": (piece, 100 * MASK_PIECE, 5.0),
        "rival": (100 * e.rival, 100 * RIVAL, 5.0),
    }
    return tuple(Meter(name, *numbers) for name, numbers in found.items())


def object_score(evidence: PoseEvidence) -> float:
    """How clearly all quantities are within their limits, 0 to 1; no probability."""
    return score_of(object_meters(evidence))


def hand_meters(hand: HandEstimate, touching: int | None, reach: float) -> tuple[Meter, ...]:
    """What decides whether the hand is right, and holds the object.

    Args:
        touching: parts of the hand that touch the object; None where its pose is not accepted.
        reach: distance of the third nearest link from the object before the hand is fitted to it [m].
    """
    held = nan if touching is None else float(touching)
    return (
        Meter("hand_score", 100 * hand.score, 100 * HAND_SCORE, 20.0, True),
        Meter("joints", 100 * float(hand.confidence.mean()), 100 * SURE_JOINTS, 20.0, True),
        Meter("touching", held, TOUCHING, 1.0, True),
        Meter("reach", 1e3 * reach, 1e3 * REACHED, 5.0),
    )


def joint_probabilities(
    capture: Capture, fitted: HandEstimate, hand: HandEstimate, object_known: bool
) -> np.ndarray:
    """Probability that each joint is within ``WITHIN`` of where it was found, shape [21]: of a normal error
    whose variance is the sum of the fit's own, of how far the joint is from its landmark, and of how far
    it is from the depth measured there. The fit knows nothing of wrong landmarks.

    Args:
        fitted: the hand before the object was known.
        object_known: whether the object's pose was accepted, and the hand touches it: else the depth of the
            hand is uncertain by ``UNHELD``.
    """
    pixels = capture.intrinsics.project(hand.joints_camera)
    away = np.linalg.norm(pixels - hand.pixels, axis=1) * hand.joints_camera[:, 2] / capture.intrinsics.fx
    # A landmark that is off takes those of its finger with it, and makes the others doubtful.
    of_finger = away.copy()
    of_finger[1:] = np.repeat(away[1:].reshape(5, 4).max(axis=1), 4)
    # Joints are about 10 mm behind the skin; where a finger is hidden another thing's depth is measured.
    depth = np.where(capture.measured, capture.depth, np.nan)
    behind = hand.joints_camera[:, 2] - median_depth(depth, pixels) - 0.01
    behind = np.clip(np.nan_to_num(behind), -DEPTH_ERROR, DEPTH_ERROR)
    variance = (
        np.trace(fitted.covariance, axis1=1, axis2=2) / 3
        + (of_finger**2 + 0.5 * np.mean(away**2) + behind**2) / 3
    )
    variance = variance + (0.0 if object_known else UNHELD**2 / 3)
    found = chi2.cdf(WITHIN**2 / np.maximum(variance, 1e-8), 3)
    return np.asarray(found) * (1.0 if edge_of_hand(capture, hand) is None else CUT)


DEPTH_ERROR = 0.01
"""Depth that differs more from a joint's is that of another thing, and tells no more [m]."""

UNHELD = 0.018
"""Standard deviation of the depth of a hand that is not fitted to an object [m]: of real images."""


@dataclass(frozen=True)
class Acceptance:
    """Whether an answer can be used."""

    sure: bool
    """Whether all quantities are within their limits, and nothing speaks against it."""
    object: float
    """How clearly those of the object's pose are, 0 to 1; ``ACCEPT`` at the limit. No probability."""
    hand: float
    """The same of the hand and its touch."""
    evidence: tuple[Meter, ...]
    """The quantities."""
    help: tuple[str, ...]
    """What would make a surer answer, most useful first; empty where it is sure."""
    fitted: str = ""
    """Shape that was fitted to an object without a mesh, "box:60x28x30"; ``object`` is then the part of what
    is seen that it explains."""
    doubt: str = ""
    """What keeps it from being sure whatever the quantities are; empty where nothing does."""

    def summary(self) -> str:
        """All of it in a line."""
        failed = [f"{m.words} {_shown(m)}, not {_limit(m)}" for m in self.evidence if not m.met]
        against = self.doubt or "; ".join(failed[:2])
        if self.fitted:
            kind, sizes = self.fitted.split(":")
            return (
                f"unknown object: a {kind} of {sizes.replace('x', ' x ')} mm explains "
                f"{100 * self.object:.0f} % of what is seen; the rest is a guess"
                + (f"; not sure: {against}" if not self.sure and against else "")
            )
        if self.sure:
            return f"sure: all {len(self.evidence)} quantities are within their limits"
        return f"not sure: {against or 'the pose is not judged'}"

    def rows(self) -> list[tuple[str, str, str, str]]:
        """The evidence as a table: what, value, limit, whether it is met."""
        table = [("evidence", "value", "limit", "met")]
        for one in self.evidence:
            met = "-" if isnan(one.value) else "yes" if one.met else "no"
            table.append((one.words, _shown(one), _limit(one), met))
        return table

    def as_json(self) -> dict[str, Any]:
        """To be written as JSON; null where a number is not known."""
        rows = [
            asdict(one)
            | {"value": one.value if isfinite(one.value) else None, "unit": one.unit, "met": one.met}
            for one in self.evidence
        ]
        return {
            "sure": self.sure,
            "object": self.object,
            "hand": self.hand,
            "evidence": rows,
            "help": list(self.help),
            "fitted": self.fitted or None,
            "doubt": self.doubt or None,
        }


def _shown(one: Meter) -> str:
    unit = f" {one.unit}" if one.unit else ""
    return f"{one.value:.3g}{unit}" if isfinite(one.value) else "not known"


def _limit(one: Meter) -> str:
    unit = f" {one.unit}" if one.unit else ""
    return f"{'at least' if one.least else 'at most'} {one.limit:.3g}{unit}"


def judge(
    obj: ObjectEstimate,
    hand: HandEstimate,
    *,
    touching: int | None = None,
    reach: float = nan,
    fitted: str = "",
    doubt: str = "",
    given: bool = False,
) -> Acceptance:
    """Whether object and hand can be used.

    Args:
        touching, reach: of the hand, see ``hand_meters``.
        fitted: shape that stands for an object without a mesh.
        doubt: what speaks against it whatever the quantities are.
        given: whether the pose came from elsewhere and was not looked for.
    """
    of_hand = hand_meters(hand, touching, reach)
    of_object = () if obj.evidence is None else object_meters(obj.evidence)
    right_hand = all(meter.met for meter in of_hand)
    if obj.evidence is None and not obj.accepted:
        # It was not compared with the image, and nothing else is to be mended first.
        doubt = doubt or "; ".join(map(str, obj.warnings))
    sure = obj.accepted and right_hand and not doubt
    advice = object_help(obj, given)
    if fitted and not obj.accepted:
        advice = ("a click at the object (--point u,v), or a mask", "a mesh of the object")
    # Joints are less probable where the object is not known: that is to be mended first.
    if not (of_hand[0].met and (of_hand[1].met or not obj.accepted)):
        advice += ("a view in which more of the hand is seen, bare and well lit",)
    elif obj.accepted and not right_hand:
        advice += ("an image in which the hand holds the object: as measured it does not touch it",)
    return Acceptance(sure, obj.score, score_of(of_hand), (*of_object, *of_hand), advice, fitted, doubt)


LOOSE_MASK = 0.25
"""A mask with a larger part of other things is loose: 6 pixels too many around an object of 50 make 40 %,
true masks of the images looked at had up to 20 %."""

MUCH_HIDDEN, FEW_PIXELS = 0.35, 2000
"""Part of the silhouette that is hidden, and measured pixels of the object, beyond which right answers are
less often sure."""


def object_help(obj: ObjectEstimate, given: bool = False) -> tuple[str, ...]:
    """What would make an object's pose surer, most useful first; nothing where it is accepted.

    given: whether it came from elsewhere.
    """
    e = obj.evidence
    if e is None or obj.accepted:
        return ()
    failed = {meter.name for meter in object_meters(e) if not meter.met}
    size = bool(failed & {"other_size", "other_side"})
    covered = failed & {"unexplained", "larger", "off", "left_over", "mask_piece"}
    # A click tells where to look for a pose; one that is given needs a mask.
    found = {
        "a mesh of the right size: another one fits better; is its unit right?": (
            max(e.other_size, e.other_side) > 0.05
        ),
        f"a tighter mask: {100 * e.foreign:.0f} % of it look like hand or background": e.foreign > LOOSE_MASK,
        "a mask of the object (--mask)": e.hinted < 1.0 and given,
        "a click at the object (--point u,v), or a mask": e.hinted == 0.0 and not given,
        f"another view: {100 * e.hidden:.0f} % of the object is behind the hand": e.hidden > MUCH_HIDDEN,
        "another view, in which more of the object is seen": e.hidden <= MUCH_HIDDEN and size,
        f"the camera nearer to it: only {e.pixels:.0f} pixels show the object": e.pixels < FEW_PIXELS,
        "the camera's spatial and hole-filling filters turned off": e.edge_width > SMOOTHED,
        "a mesh with colors: another pose fits nearly as well": e.colored == 0.0 and e.rival > 0.9,
        "the mesh of this very object: this one does not cover what is seen": bool(covered),
    }
    return tuple(words for words, helps in found.items() if helps)


def check_holdable(model: ObjectModel) -> None:
    """Complain about a mesh that no hand holds, or that is far from its origin.

    Raises:
        FungraspError: see there.
    """
    size = float(np.linalg.norm(model.size))
    if not SIZES[0] < size < SIZES[1] or min(model.size) > THICKEST:
        sides = " x ".join(f"{1000 * side:,.0f}" for side in model.size)
        raise FungraspError(f"'{model.name}' is {sides} mm, which no hand holds: is its unit right?")
    _check_origin(model, MAX_HAND_DISTANCE)


def check_held(hand: HandEstimate, obj: ObjectEstimate, model: ObjectModel, *, hinted: bool) -> None:
    """Complain about an object that the hand can't be holding, as a ``HumanGrasp`` does.

    Args:
        hand: camera frame.
        obj: the object's pose, camera frame.
        hinted: whether it was said where the object is.

    Raises:
        FungraspError: the object is too far from the hand, or its mesh from its origin.
    """
    pose, joints = obj.pose_camera_object, hand.joints_camera
    if np.linalg.norm(joints - pose[:3], axis=1).max() <= MAX_HAND_DISTANCE:
        return
    surface = transform_points(pose, model.vertices)
    apart = float(np.linalg.norm(surface - joints.mean(axis=0), axis=1).min())
    if apart < MAX_HAND_DISTANCE / 2:
        _check_origin(model, 0.0)
    what, then = "what fits it best", "a mask, a box or a click would say where it is"
    if hinted:
        what, then = "what was said to show it", "do mask, box, click or pose show the object in this hand?"
    raise FungraspError(
        f"'{model.name}' is in no hand: {what} is {apart:.2f} m from the hand that was found; {then}"
    )


def _check_origin(model: ObjectModel, allowed: float) -> None:
    """Complain about a mesh of which all is farther from its origin than is allowed [m]."""
    away = float(np.linalg.norm(model.vertices, axis=1).min())
    if away > allowed:
        raise FungraspError(
            f"the origin of '{model.name}' is {away:.2f} m from its surface: move the mesh to its origin, as "
            "poses and grasps are about it"
        )


def doubt_of(warnings: Sequence[PerceptionWarning], side_score: float | None, fitted: bool) -> str:
    """What speaks against the answer, whatever its quantities are: they are those of images of the right
    scale and of the side that the hand has, with aligned depth, in which hand and object are whole.

    Args:
        side_score: probability of the hand's side, where it was seen in the image.
        fitted: whether a shape was fitted; a mesh that fits has the size of what is seen, a shape takes any.
    """
    # What is cut off may slide along the edge, and fingers beyond it are found inside.
    against = {"cut_off", "depth_shifted", "depth_turned", "axis_off_centre"} | (
        {"hand_size"} if fitted else set()
    )
    if side_score is not None and side_score >= OTHER_SIDE:
        against.add("side_not_as_given")
    sizes = [float(one.values["size"]) for one in warnings if one.code == "hand_size"]
    if any(abs(np.log(size)) > 3 * HAND_SIZE_SPREAD for size in sizes):
        against.add("hand_size")
    return next((str(one) for one in warnings if one.code in against), "")


def plausibility_warnings(
    capture: Capture, hand: HandEstimate, obj: ObjectEstimate, model: ObjectModel
) -> list[PerceptionWarning]:
    """Warnings of a hand, or an object whose pose is accepted, that the image's edge cuts off; of swapped red
    and blue; and of a hand smaller or larger than those of 95 % of adults: of the scale of depth and
    intrinsics, nothing else in an image tells as much."""
    lens, edges = capture.intrinsics, {"hand": edge_of_hand(capture, hand)}
    if obj.accepted:
        pixels = lens.project(transform_points(obj.pose_camera_object, model.vertices))
        edges["object"] = cut_edge(lens, pixels)
    found = [PerceptionWarning.of("cut_off", what=what, edge=edge) for what, edge in edges.items() if edge]
    if _looks_blue(capture, hand):
        found.append(PerceptionWarning.of("colors_swapped"))
    size, spread = hand_size(hand.joints_camera), 2 * HAND_SIZE_SPREAD
    if abs(np.log(size)) >= spread:
        low, high = np.exp([-spread, spread]).tolist()
        found.append(PerceptionWarning.of("hand_size", size=size, low=low, high=high))
    return found


def _looks_blue(capture: Capture, hand: HandEstimate) -> bool:
    """Whether more of the hand's pixels are blue than red, by 10 of 255: skin of all people is redder than it
    is blue. Of an overexposed hand 8 % of the pixels tell, so that 5 % are enough; in images as they should
    be none is blue."""
    near, far = hand.pixels[np.transpose(BONES)]
    part = np.linspace(0, 1, 8)[:, None, None]
    u, v = np.rint(near + part * (far - near)).astype(int).reshape(-1, 2).T
    height, width = capture.depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    color = capture.color[v[inside], u[inside]].astype(int)
    redder = color[:, 0] - color[:, 2]
    return bool((redder < -10).sum() > max(0.05 * len(redder), (redder > 10).sum()))


def edge_of_hand(capture: Capture, hand: HandEstimate) -> str | None:
    """The edge of the image that cuts off a hand; None if it is whole."""
    lens = capture.intrinsics
    return cut_edge(lens, np.concatenate([hand.pixels, lens.project(hand.joints_camera)]))


def cut_edge(lens: Intrinsics, pixels: np.ndarray) -> str | None:
    """The edge of the image beyond which, or within 2 pixels of which, most of a thing's pixels are, shape
    [N, 2]; None if none is."""
    u, v = pixels.T
    beyond = {
        "left": 2.0 - u,
        "right": u - (lens.width - 3.0),
        "top": 2.0 - v,
        "bottom": v - (lens.height - 3.0),
    }
    count = {edge: int((over > 0).sum()) for edge, over in beyond.items()}
    most = max(count, key=lambda edge: count[edge])
    return most if count[most] else None
