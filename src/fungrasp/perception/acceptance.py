"""Whether a result is sure: quantities with limits, and advice.

Quantities are normalized by the image itself: numbers of pixels by the object's pixels, lengths in pixels by
the image's size, fits by the noise of the depth. The limits are therefore the same for every camera. They
separate right answers from wrong meshes in renders of two kinds of depth cameras (RealSense D435i, Xtion) and
in six images of one RealSense camera.
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
"""Score if the worst quantity is exactly at its limit."""

UNEXPLAINED = 0.3
"""Largest fraction of the object's pixels, or of the mesh's silhouette, that disagree."""

WORSE = 2.0
"""Standard errors, 1 / sqrt(pixels), by which another size of the mesh must fit worse."""

SIDE = 1.0
"""Standard errors by which another length of one side may fit better; the best of 18 does by chance."""

LARGER, OFF = 1.5, 4.5
"""Largest differences between the outlines of image and mesh: in size, and in position in the worst eighth
[pixels of an image 640 wide]."""

LEFT_OVER = 0.2
"""Largest extent of the object's pixels beyond the mesh, as a fraction of the mesh's size."""

MASK_PIECE = 0.05
"""Largest connected piece of the mask beyond the mesh, as a fraction of the object's pixels."""

RIVAL = 0.97
"""Largest quality of the best different pose, as a fraction of this pose's."""

HAND_SCORE, SURE_JOINTS = 0.6, 0.6
"""Smallest score of a hand by its detector, and smallest mean probability of its joints."""

TOUCHING = 2
"""Smallest number of parts of the hand, out of palm and five fingers, that touch the object."""

REACHED = 0.01
"""Largest distance of the third nearest link from the object before the hand is fitted to it [m]."""

SURE_JOINT, WITHIN = 0.95, 0.02
"""Probability from which a joint is called sure, and the largest error that this means [m]."""

CUT = 0.8
"""Fraction of sure joints within 20 mm in hands cut off by the image's edge (402 of 504, 68 crops of
renders): fingers beyond the edge are found inside."""

SIZES, THICKEST = (0.01, 1.5), 0.25
"""Smallest and largest diagonal of an object that a hand holds [m], and its largest thickness: a hand spans
about 0.2."""


@dataclass(frozen=True)
class Meter:
    """A quantity and its limit."""

    name: str
    """Name, one of ``WORDS``."""
    value: float
    """Value [``unit``]; NaN if unknown, which counts as met."""
    limit: float
    """Limit [``unit``]."""
    tolerance: float
    """Excess over the limit at which the score is a quarter [``unit``]."""
    least: bool = False
    """Whether the limit is a minimum instead of a maximum."""

    @property
    def words(self) -> str:
        """Description of the quantity."""
        return WORDS[self.name][0]

    @property
    def unit(self) -> str:
        """Unit of value and limit."""
        return WORDS[self.name][1]

    @property
    def excess(self) -> float:
        """Distance of the value beyond its limit, in tolerances; negative within."""
        if isnan(self.value):
            return float("-inf")
        beyond = (self.limit - self.value) if self.least else (self.value - self.limit)
        return float(beyond / self.tolerance)

    @property
    def met(self) -> bool:
        """Whether the value is within its limit."""
        return self.excess <= 0.0


def score_of(meters: Sequence[Meter]) -> float:
    """Return 1 / (1 + 3^excess) of the worst quantity: ``ACCEPT`` at its limit."""
    worst = max(meter.excess for meter in meters)
    return float(1.0 / (1.0 + 3.0 ** np.clip(worst, -20.0, 20.0)))


WORDS = {
    "unexplained": ("object or mesh pixels that disagree", "%"),
    "other_size": ("fit of the mesh in another size, relative to its own", "%"),
    "other_side": ("fit with one side longer or shorter, relative", "%"),
    "larger": ("size difference between outline and mesh", "pixels"),
    "off": ("offset of the outline from the mesh, worst eighth", "pixels"),
    "left_over": ("how far the object reaches beyond the mesh, as a part of its size", "%"),
    "mask_piece": ("largest piece of the mask beyond the mesh, as a part of the object", "%"),
    "rival": ("fit of the best other pose, relative", "%"),
    "hand_score": ("hand: detector's score and agreement", "%"),
    "joints": ("hand: expected share of joints with an error below 20 mm", "%"),
    "touching": ("parts of the hand that touch the object", ""),
    "reach": ("distance of the hand's nearest links from the object, as measured", "mm"),
}
"""Description and unit of each quantity, by name."""


def object_meters(e: PoseEvidence) -> tuple[Meter, ...]:
    """Return the quantities that decide whether pose and mesh are right."""
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
    """Return how clearly all quantities are within their limits, 0 to 1; no probability."""
    return score_of(object_meters(evidence))


def hand_meters(hand: HandEstimate, touching: int | None, reach: float) -> tuple[Meter, ...]:
    """Return the quantities that decide whether the hand is right and holds the object.

    Args:
        touching: parts of the hand that touch the object; None if the object's pose is not accepted.
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
    """Return the probability that each joint is within ``WITHIN`` of its true position, shape [21].

    The error is assumed to be normal. Its variance is the sum of the fit's own, which ignores wrong
    landmarks, and of squared distances of the joint from its landmark and from the measured depth.

    Args:
        fitted: hand before the object is known.
        hand: final hand.
        object_known: whether the object's pose is accepted and the hand is fitted to it; otherwise the hand's
            depth is uncertain by ``UNHELD``.
    """
    pixels = capture.intrinsics.project(hand.joints_camera)
    away = np.linalg.norm(pixels - hand.pixels, axis=1) * hand.joints_camera[:, 2] / capture.intrinsics.fx
    # A wrong landmark pulls its finger along, and makes all others doubtful.
    of_finger = away.copy()
    of_finger[1:] = np.repeat(away[1:].reshape(5, 4).max(axis=1), 4)
    # Joints are about 10 mm behind the skin; at hidden fingers, the depth is that of another thing.
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
"""Bound of the depth difference at a joint [m]; larger ones are due to other things."""

UNHELD = 0.018
"""Standard deviation of the depth of a hand that is not fitted to an object [m], from real images."""


@dataclass(frozen=True)
class Acceptance:
    """Whether a result is sure, and why."""

    sure: bool
    """Whether all quantities are within their limits, and there is no ``doubt``."""
    object: float
    """Score of the object's quantities, 0 to 1; ``ACCEPT`` at the limit. No probability."""
    hand: float
    """Score of the hand's quantities."""
    evidence: tuple[Meter, ...]
    """All quantities."""
    help: tuple[str, ...]
    """Advice for a surer result, most useful first; empty if it is sure."""
    fitted: str = ""
    """Shape fitted to an object without a mesh, "box:60x28x30"; ``object`` is then the fraction of the
    object's pixels that it explains."""
    doubt: str = ""
    """Reason why the result is not sure whatever its quantities are; empty if there is none."""

    def summary(self) -> str:
        """Return one line that sums up the result."""
        failed = [f"{m.words} {_shown(m)}, not {_limit(m)}" for m in self.evidence if not m.met]
        against = self.doubt or "; ".join(failed[:2])
        if self.fitted:
            kind, sizes = self.fitted.split(":")
            return (
                f"unknown object: a {kind} of {sizes.replace('x', ' x ')} mm explains "
                f"{100 * self.object:.0f} % of the visible object; the rest is a guess"
                + (f"; not sure: {against}" if not self.sure and against else "")
            )
        if self.sure:
            known, count = sum(not isnan(m.value) for m in self.evidence), len(self.evidence)
            which = (
                f"all {count} quantities" if known == count else f"the {known} known of {count} quantities"
            )
            return f"sure: {which} are within their limits"
        return f"not sure: {against or 'the pose is not judged'}"

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return the evidence as a table with a header: quantity, value, limit, whether it is met."""
        table = [("evidence", "value", "limit", "met")]
        for one in self.evidence:
            met = "-" if isnan(one.value) else "yes" if one.met else "no"
            table.append((one.words, _shown(one), _limit(one), met))
        return table

    def as_json(self) -> dict[str, Any]:
        """Return the record for a JSON file; unknown numbers are None."""
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
    """Decide whether object and hand are sure.

    Args:
        touching, reach: see ``hand_meters``.
        fitted: shape fitted to an object without a mesh.
        doubt: reason against the result, whatever its quantities are.
        given: whether the object's pose was given instead of searched.
    """
    of_hand = hand_meters(hand, touching, reach)
    of_object = () if obj.evidence is None else object_meters(obj.evidence)
    right_hand = all(meter.met for meter in of_hand)
    if obj.evidence is None and not obj.accepted:
        # The pose was not compared with the image; the warnings say why.
        doubt = doubt or "; ".join(map(str, obj.warnings))
    sure = obj.accepted and right_hand and not doubt
    advice = object_help(obj, given)
    if fitted and not obj.accepted:
        advice = ("a click at the object (--point u,v), or a mask", "a mesh of the object")
    # Joints are less probable while the object is unknown: then they give no advice.
    if not (of_hand[0].met and (of_hand[1].met or not obj.accepted)):
        advice += ("a view in which more of the hand is seen, bare and well lit",)
    elif obj.accepted and not right_hand:
        advice += ("an image in which the hand holds the object: as measured it does not touch it",)
    return Acceptance(sure, obj.score, score_of(of_hand), (*of_object, *of_hand), advice, fitted, doubt)


LOOSE_MASK = 0.25
"""Fraction of other things in a mask from which it is loose: 6 extra pixels around an object of 50 pixels are
40 %; exact masks had up to 20 %."""

MUCH_HIDDEN, FEW_PIXELS = 0.35, 2000
"""Hidden fraction of the silhouette, and number of measured object pixels, beyond which right answers are
less often sure."""


def object_help(obj: ObjectEstimate, given: bool = False) -> tuple[str, ...]:
    """Return advice for a surer pose, most useful first; empty if the pose is accepted or was not compared.

    Args:
        given: whether the pose was given instead of searched.
    """
    e = obj.evidence
    if e is None or obj.accepted:
        return ()
    failed = {meter.name for meter in object_meters(e) if not meter.met}
    size = bool(failed & {"other_size", "other_side"})
    covered = failed & {"unexplained", "larger", "off", "left_over", "mask_piece"}
    # A click helps to search a pose; a given pose needs a mask.
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
        "a mesh of exactly this object: this one does not cover all of it": bool(covered),
    }
    return tuple(words for words, helps in found.items() if helps)


def check_holdable(model: ObjectModel) -> None:
    """Check that a hand can hold an object and that its mesh is near its origin.

    Raises:
        FungraspError: it is too large, too small, or too far from its origin.
    """
    size = float(np.linalg.norm(model.size))
    if not SIZES[0] < size < SIZES[1] or min(model.size) > THICKEST:
        sides = " x ".join(f"{1000 * side:,.0f}" for side in model.size)
        raise FungraspError(f"'{model.name}' is {sides} mm, which no hand holds: is its unit right?")
    _check_origin(model, MAX_HAND_DISTANCE)


def check_held(hand: HandEstimate, obj: ObjectEstimate, model: ObjectModel, *, hinted: bool) -> None:
    """Check that the object is near enough to the hand for a ``HumanGrasp``.

    Args:
        hand: camera frame.
        obj: camera frame.
        hinted: whether the object's place in the image was given.

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
    what, then = "its best fit", "give a mask or box of the object, or a click at it"
    if hinted:
        what, then = "the place given for it", "do mask, box, click or pose show the object in this hand?"
    raise FungraspError(
        f"no hand holds '{model.name}': {what} is {apart:.2f} m from the detected hand; {then}"
    )


def _check_origin(model: ObjectModel, allowed: float) -> None:
    """Check that a vertex of the mesh is within ``allowed`` [m] of its origin."""
    away = float(np.linalg.norm(model.vertices, axis=1).min())
    if away > allowed:
        raise FungraspError(
            f"the origin of '{model.name}' is {away:.2f} m from its surface: move the mesh to the origin, "
            "because poses and grasps refer to it"
        )


def doubt_of(warnings: Sequence[PerceptionWarning], side_score: float | None, fitted: bool) -> str:
    """Return a reason against the result, whatever its quantities are; empty if there is none.

    The limits hold for correct scale, aligned depth, the right side of the hand, and a complete hand and
    object.

    Args:
        side_score: probability of the hand's side; None if it was not seen in the image.
        fitted: whether a shape was fitted, which takes any size; a mesh that fits confirms the scale.
    """
    # An object that is cut off may slide along the edge; fingers beyond the edge are found inside.
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
    """Return warnings about hand and accepted object cut off by the image's edge, swapped red and blue, and a
    hand size outside that of 95 % of adults, which is the best sign of a wrong scale."""
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
    """Return whether more of the hand's pixels are blue than red, by 10 of 255. Skin of all people is redder
    than blue: 8 % of the pixels of an overexposed hand show it, and in correct images none is blue."""
    near, far = hand.pixels[np.transpose(BONES)]
    part = np.linspace(0, 1, 8)[:, None, None]
    u, v = np.rint(near + part * (far - near)).astype(int).reshape(-1, 2).T
    height, width = capture.depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    color = capture.color[v[inside], u[inside]].astype(int)
    redder = color[:, 0] - color[:, 2]
    return bool((redder < -10).sum() > max(0.05 * len(redder), (redder > 10).sum()))


def edge_of_hand(capture: Capture, hand: HandEstimate) -> str | None:
    """Return the edge of the image that cuts off a hand; None if it is complete."""
    lens = capture.intrinsics
    return cut_edge(lens, np.concatenate([hand.pixels, lens.project(hand.joints_camera)]))


def cut_edge(lens: Intrinsics, pixels: np.ndarray) -> str | None:
    """Return the edge of the image with most pixels beyond it, or less than 2 pixels inside; None if there
    are none. pixels: shape [N, 2]."""
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
