"""Whether an answer can be used: probabilities with the numbers they rest on, what can't be, and what would
help.

The rule is a logistic regression for the object, one for the hand and one for each joint, fitted to rendered
captures and one camera. Terminal, page and JSON all show the record ``Acceptance``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import exp, expm1, isfinite, isnan, log, nan
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_grasp import MAX_HAND_DISTANCE
from fungrasp.grasps.human_hand import BONES, HAND_SIZE_SPREAD, hand_size
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.fit import OTHER_SIDE
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, PoseEvidence
from fungrasp.perception.scene.pixel_classes import SHARP, SMOOTHED

ACCEPT = 0.955
"""Objects of a lower probability are not accepted: the least at which no more than 1 % of wrong meshes were,
cross-validated over the captures of the fit."""

ACCEPTED_HAND = 0.7
"""Hands of a lower probability are not called right."""

SURE_JOINT, WITHIN = 0.95, 0.02
"""Joints of a lower probability to be within so much of where they were found [m] are not called sure: from
here on 3 % of them were not, cross-validated over the hands of the fit."""

CUT = 0.8
"""Part of the joints called sure that were within 20 mm in hands that the image's edge cut off (402 of 504,
68 crops of renders): fingers beyond it are found inside."""

SIZES, THICKEST = (0.01, 1.5), 0.25
"""Shortest and longest diagonal of an object that a hand holds [m], and its longest shortest side: a hand
spans some 0.2."""


@dataclass(frozen=True)
class Logistic:
    """Logistic regression in which each number counts for or against, as it must."""

    constant: float
    """Logarithm of the odds of a usual right answer."""
    terms: Mapping[str, tuple[float, float]]
    """Of each number the change of the logarithm of the odds, and the median among right answers."""

    def shares(self, features: Mapping[str, float]) -> dict[str, float]:
        """How much each number makes an answer more probable than a usual right one (logarithm of the odds),
        by name."""
        return {name: w * (features[name] - usual) for name, (w, usual) in self.terms.items()}

    def probability(self, features: Mapping[str, float]) -> float:
        """Of being right, 0 to 1."""
        return float(1.0 / (1.0 + np.exp(-self.constant - sum(self.shares(features).values()))))


OBJECT_WEIGHTS = Logistic(
    4.45,
    {
        "agreement": (0.709, 2.78),
        "larger": (-0.516, 0.41),
        "off": (-0.302, 1.44),
        "left_over": (-0.52, -4.61),
        "mask_piece": (-0.328, 0),
        "hinted": (0.804, 1),
        "other_size": (-2.8, -0.286),
        "other_side": (-10.9, -0.0276),
        "rival": (-2.6, 0),
    },
)
"""Of ``object_features``."""

HAND_WEIGHTS = Logistic(3.11, {"hand_score": (4.56, 0.894), "joints": (1.11, 1.83)})
"""Of ``hand_features``."""

JOINT_WEIGHTS = Logistic(
    4.18,
    {
        "fit_spread": (-3.57, 1.57),
        "landmark_finger": (-23.6, 0.0468),
        "landmark_hand": (-49.0, 0.0363),
        "object_known": (3.16, 1.0),
        "depth_off": (-31.0, 0.0075),
    },
)
"""Of the numbers in ``joint_probabilities``."""

UNSEEN_LARGER, UNSEEN_OFF = 0.8, 2.8
"""Taken where too little of the outline is seen [pixels]: twice the medians of right answers, so that it
speaks little for or against."""

PIECE = 10.0
"""Pieces of so few pixels count by their size, larger ones by its logarithm."""


def object_features(e: PoseEvidence) -> dict[str, float]:
    """What the object's probability is made of: numbers of which more is always better, or always worse,
    within limits beyond which they say nothing more. By the names of ``OBJECT_WEIGHTS``."""
    # Too small a mesh explains little of what is seen, of too large a one little is seen. Where depth is
    # smoothed right answers agree less.
    agreement = min(e.explained, e.visible)
    allowed = float(np.clip(e.edge_width / SHARP, 1.0, 5.0)) ** 0.25
    return {
        "agreement": float(-np.log(np.clip(1.0 - agreement, 0.02, 1.0))) * allowed,
        "larger": UNSEEN_LARGER if np.isnan(e.larger) else abs(e.larger),
        "off": UNSEEN_OFF if np.isnan(e.off) else e.off,
        "left_over": float(np.log(e.left_over + 0.01)),
        "mask_piece": float(np.log1p(e.mask_piece / PIECE)),
        "hinted": float(e.hinted == 1.0),
        "other_size": float(np.clip(e.other_size, -0.6, 0.4)),
        "other_side": float(np.clip(e.other_side, -0.3, 0.3)),
        "rival": float(np.clip(5.0 * (e.rival - 0.8), 0.0, 1.0)),
    }


def object_probability(evidence: PoseEvidence) -> float:
    """Probability that ADD-S is below 10 mm and the mesh is the right one."""
    return OBJECT_WEIGHTS.probability(object_features(evidence))


def hand_features(hand: HandEstimate) -> dict[str, float]:
    """What the probability of the hand is made of, by the names of ``HAND_WEIGHTS``. More joints than 88 % do
    not make up for a low score: something else may look like a hand."""
    part = min(max(float(hand.confidence.mean()), 0.01), 0.88)
    return {"hand_score": hand.score, "joints": log(part / (1.0 - part))}


def joint_probabilities(
    capture: Capture, fitted: HandEstimate, hand: HandEstimate, object_known: bool
) -> np.ndarray:
    """Probability that each joint is within ``WITHIN`` of where it was found, shape [21]. The covariances of
    the fit know nothing of wrong landmarks, nor of what a finger is behind.

    Args:
        fitted: the hand before the object was known.
        object_known: whether the object's pose was accepted, and the hand touches it.
    """
    pixels = capture.intrinsics.project(hand.joints_camera)
    extent = max(float(np.linalg.norm(np.ptp(hand.pixels, axis=0))), 1.0)
    # Landmarks farther off than 0.15 of the hand's extent, and depth by more than 40 mm, say nothing more.
    off = np.minimum(np.linalg.norm(pixels - hand.pixels, axis=1) / extent, 0.15)
    of_finger = off.copy()
    of_finger[1:] = np.repeat(off[1:].reshape(5, 4).max(axis=1), 4)
    # Joints are about 10 mm behind the skin.
    behind = hand.joints_camera[:, 2] - _median_depth(capture.depth, pixels) - 0.01
    spread = np.sqrt(np.trace(fitted.covariance, axis1=1, axis2=2) / 3)
    features = {
        "fit_spread": np.log(1000.0 * np.maximum(spread, 1e-4)),
        "landmark_finger": of_finger,
        "landmark_hand": np.full(21, off.mean()),
        "object_known": np.full(21, float(object_known)),
        "depth_off": np.minimum(np.abs(np.nan_to_num(behind, nan=0.01)), 0.04),
    }
    found = [JOINT_WEIGHTS.probability({n: float(v[i]) for n, v in features.items()}) for i in range(21)]
    return np.array(found) * (1.0 if edge_of_hand(capture, hand) is None else CUT)


def _median_depth(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Median depth of the pixels around some [m], NaN where there is hardly any. pixels: shape [N, 2]."""
    height, width = depth.shape
    found = np.full(len(pixels), np.nan)
    for i, (u, v) in enumerate(np.rint(np.nan_to_num(pixels, nan=-9.0)).astype(int).tolist()):
        if 0 <= u < width and 0 <= v < height:
            near = depth[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
            near = near[near > 0]
            if near.size >= 3:
                found[i] = np.median(near)
    return found


ROWS: Mapping[str, tuple[str, str, Callable[[float], float]]] = {
    "agreement": (
        "pixels that mesh and image have in common; more where depth is smoothed",
        "%",
        lambda value: 100.0 * (1.0 - exp(-value)),
    ),
    "larger": ("outline in the image larger or smaller than the mesh's, by", "pixels", float),
    "off": ("outline in the image beside the mesh's, in the worst eighth, by", "pixels", float),
    "left_over": (
        "how far the object reaches beyond the mesh, as a part of its size",
        "%",
        lambda value: 100.0 * round(max(exp(value) - 0.01, 0.0), 6),
    ),
    "mask_piece": ("largest piece of the mask beyond the mesh", "pixels", lambda value: PIECE * expm1(value)),
    "hinted": ("a mask was given: 1, none: 0", "", float),
    "other_size": ("fit of the mesh in another size", "%", lambda value: 100.0 * exp(value)),
    "other_side": ("fit of it with another side longer or shorter", "%", lambda value: 100.0 * exp(value)),
    "rival": ("fit of the best other pose, 80 or less", "%", lambda value: 100.0 * (0.8 + 0.2 * value)),
    "hand_score": ("hand: detector's score and agreement", "", float),
    "joints": (
        "hand: joints within 20 mm of where they are, expected, 88 or less",
        "%",
        lambda value: 100.0 * (1.0 / (1.0 + exp(-value))),
    ),
}
"""Words and unit of each number, and from what the odds are made of to what people read."""


@dataclass(frozen=True)
class Meter:
    """One number that speaks for or against."""

    name: str
    """As in ``ROWS``."""
    value: float
    """In the unit; NaN where it is not known."""
    usual: float
    """The median of right answers, in the unit."""
    unit: str
    """Of both."""
    share: float
    """How much more probable it makes the answer than a usual right one (logarithm of the odds)."""


@dataclass(frozen=True)
class Acceptance:
    """Whether an answer can be used."""

    sure: bool
    """Whether both probabilities are high enough, and nothing speaks against it."""
    object: float
    """Probability that pose and mesh are right: ADD-S below 10 mm."""
    hand: float
    """Probability that the hand is right: its joints within 20 mm of where they are, on average."""
    evidence: tuple[Meter, ...]
    """What the probabilities rest on."""
    help: tuple[str, ...]
    """What would make a surer answer, most useful first; empty where it is sure."""
    fitted: str = ""
    """Shape that was fitted to an object without a mesh, "box:60x28x30"; ``object`` is then the part of what
    is seen that it explains, no probability."""
    doubt: str = ""
    """What keeps it from being sure whatever the probabilities are; empty where nothing does."""

    @property
    def probability(self) -> float:
        """That all is right."""
        return self.object * self.hand

    def summary(self) -> str:
        """All of it in a line."""
        if self.fitted:
            kind, sizes = self.fitted.split(":")
            return (
                f"unknown object: a {kind} of {sizes.replace('x', ' x ')} mm explains "
                f"{100 * self.object:.0f} % of what is seen; the rest is a guess "
                f"(hand {100 * self.hand:.0f} %)" + (f"; not sure: {self.doubt}" if self.doubt else "")
            )
        parts = f"object {100 * self.object:.0f} %, hand {100 * self.hand:.0f} %"
        if self.sure:
            return f"sure: {100 * self.probability:.0f} % that all is right ({parts})"
        if self.doubt:
            return f"not sure: {self.doubt} ({parts})"
        needed = f"it takes {100 * ACCEPT:.3g} and {100 * ACCEPTED_HAND:.0f} %"
        return f"not sure: {100 * self.probability:.0f} % that all is right ({parts}; {needed})"

    def rows(self) -> list[tuple[str, str, str, str]]:
        """The evidence as a table: what, value, usual value of right answers, share."""
        table = [("evidence", "value", "usual", "for or against")]
        for one in self.evidence:
            unit = f" {one.unit}" if one.unit else ""
            value = f"{one.value:.3g}{unit}" if isfinite(one.value) else "not known"
            table.append((ROWS[one.name][0], value, f"{one.usual:.3g}{unit}", f"{one.share:+.1f}"))
        return table

    def as_json(self) -> dict[str, Any]:
        """To be written as JSON; null where a number is not known."""
        rows = [asdict(one) | {"value": one.value if isfinite(one.value) else None} for one in self.evidence]
        return {
            "sure": self.sure,
            "probability": self.probability,
            "object": self.object,
            "hand": self.hand,
            "evidence": rows,
            "help": list(self.help),
            "fitted": self.fitted or None,
            "doubt": self.doubt or None,
        }


def judge(
    obj: ObjectEstimate, hand: HandEstimate, *, fitted: str = "", doubt: str = "", given: bool = False
) -> Acceptance:
    """Whether object and hand can be used.

    Args:
        fitted: shape that stands for an object without a mesh.
        doubt: what speaks against it whatever the probabilities are.
        given: whether the pose came from elsewhere and was not looked for.
    """
    of_hand = hand_features(hand)
    probability = HAND_WEIGHTS.probability(of_hand)
    evidence = []
    if obj.evidence is not None:
        # Where too little of the outline is seen the weights take a usual number, which is not shown; nor are
        # pieces of a mask where there is none.
        hidden = [name for name in ("larger", "off") if isnan(getattr(obj.evidence, name))]
        hidden += ["mask_piece"] if obj.evidence.hinted != 1.0 else []
        evidence += _meters(OBJECT_WEIGHTS, object_features(obj.evidence), hidden)
    evidence += _meters(HAND_WEIGHTS, of_hand)
    sure = obj.accepted and probability >= ACCEPTED_HAND and not doubt
    advice = object_help(obj, given)
    if fitted and not obj.accepted:
        advice = ("a click at the object (--point u,v), or a mask", "a mesh of the object")
    if probability < ACCEPTED_HAND:
        advice += ("a view in which more of the hand is seen, bare and well lit",)
    return Acceptance(sure, obj.score, probability, tuple(evidence), advice, fitted, doubt)


def _meters(weights: Logistic, features: Mapping[str, float], hidden: Sequence[str] = ()) -> list[Meter]:
    found = []
    for name, share in weights.shares(features).items():
        _, unit, shown = ROWS[name]
        value = nan if name in hidden else shown(features[name])
        found.append(Meter(name, value, shown(weights.terms[name][1]), unit, share))
    return found


LOOSE_MASK = 0.25
"""A mask with a larger part of other things is loose: 6 pixels too many around an object of 50 make 40 %,
true masks of the images looked at had up to 20 %."""

MUCH_HIDDEN, FEW_PIXELS = 0.35, 2000
"""Part of the silhouette that is hidden, and measured pixels of the object: with less hidden and more pixels
81 % of right answers are sure without a mask and 91 % with one; with more hidden 63 and 85 %, with fewer
pixels 35 and 74 %, with both 34 and 58 % (512 renders, cross-validated)."""

AGAINST = -0.5
"""What lowers the logarithm of the odds by more than this is worth a remedy."""


def object_help(obj: ObjectEstimate, given: bool = False) -> tuple[str, ...]:
    """What would make an object's pose surer, most useful first; nothing where it is accepted.

    given: whether it came from elsewhere.
    """
    e = obj.evidence
    if e is None or obj.accepted:
        return ()
    shares = OBJECT_WEIGHTS.shares(object_features(e))
    size = shares["other_size"] + shares["other_side"]
    edges = shares["larger"] + shares["off"] + shares["left_over"] + shares["mask_piece"]
    covered = shares["agreement"] + edges
    # A click tells where to look for a pose; one that is given needs a mask.
    found = {
        "a mesh of the right size: another one fits better; is its unit right?": (
            max(e.other_size, e.other_side) > 0.05 and size < covered
        ),
        f"a tighter mask: {100 * e.foreign:.0f} % of it look like hand or background": e.foreign > LOOSE_MASK,
        "a mask of the object (--mask)": e.hinted < 1.0 and given,
        "a click at the object (--point u,v), or a mask": e.hinted == 0.0 and not given,
        f"another view: {100 * e.hidden:.0f} % of the object is behind the hand": e.hidden > MUCH_HIDDEN,
        "another view, in which more of the object is seen": e.hidden <= MUCH_HIDDEN and size < AGAINST,
        f"the camera nearer to it: only {e.pixels:.0f} pixels show the object": e.pixels < FEW_PIXELS,
        "the camera's spatial and hole-filling filters turned off": e.edge_width > SMOOTHED,
        "a mesh with colors: another pose fits nearly as well": e.colored == 0.0 and e.rival > 0.9,
        "the mesh of this very object: this one does not cover what is seen": covered < AGAINST,
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
    """What speaks against the answer, whatever its probabilities are: they are those of images of the right
    scale and of the side that the hand has, with aligned depth, in which hand and object are whole.

    Args:
        side_score: probability of the hand's side, where it was seen in the image.
        fitted: whether a shape was fitted; a mesh that fits has the size of what is seen, a shape takes any.
    """
    # What is cut off may slide along the edge, and fingers beyond it are found inside.
    against = {"cut_off", "depth_shifted"} | ({"hand_size"} if fitted else set())
    if side_score is not None and side_score >= OTHER_SIDE:
        against.add("side_not_as_given")
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
