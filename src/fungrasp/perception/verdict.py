"""The verdict on an image: one probability, the numbers that it rests on, and what would help.

Terminal, page and JSON all show this record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from math import exp, expm1, isfinite, isnan, log, nan
from typing import TYPE_CHECKING, Any

from fungrasp.perception.object_pose.confidence import ACCEPT, PIECE, features
from fungrasp.perception.object_pose.verdict_weights import HAND_WEIGHTS, OBJECT_WEIGHTS
from fungrasp.perception.scene.depth_edges import SMOOTHED

if TYPE_CHECKING:
    from fungrasp.perception.estimates import HandEstimate, ObjectEstimate

ACCEPTED_HAND = 0.7
"""Hands of a lower probability are not called right."""

ENOUGH = 0.88
"""More joints than this part do not make up for a low score: something else may look like a hand."""

LOOSE_MASK = 0.25
"""A mask with a larger part of other things is loose: 6 pixels too many around an object of 50 make 40 %,
true masks of the images looked at had up to 20 %."""

MUCH_HIDDEN, FEW_PIXELS = 0.35, 2000
"""Part of the silhouette that is hidden, and measured pixels of the object: with less hidden and more pixels
81 % of right answers are sure without a mask and 91 % with one; with more hidden 63 and 85 %, with fewer
pixels 35 and 74 %, with both 34 and 58 % (512 renders, cross-validated)."""

ALIKE = 0.9
"""Quality of another pose, as a part of the answer's, from which on only more to see tells them apart."""

BETTER = 0.05
"""Logarithm of the quality of another size, over the mesh's own, from which on the mesh's is likely wrong."""

AGAINST = -0.5
"""What lowers the logarithm of the odds by more than this is worth a remedy."""

ROWS: Mapping[str, tuple[str, float, str]] = {
    "agreement": ("pixels that mesh and image have in common; more where depth is smoothed", 100.0, "%"),
    "larger": ("outline in the image larger or smaller than the mesh's, by", 1.0, "pixels"),
    "off": ("outline in the image beside the mesh's, in the worst eighth, by", 1.0, "pixels"),
    "left_over": ("how far the object reaches beyond the mesh, as a part of its size", 100.0, "%"),
    "mask_piece": ("largest piece of the mask beyond the mesh", 1.0, "pixels"),
    "told": ("a mask was given: 1, none: 0", 1.0, ""),
    "other_size": ("fit of the mesh in another size", 100.0, "%"),
    "other_side": ("fit of it with another side longer or shorter", 100.0, "%"),
    "rival": ("fit of the best other pose, 80 or less", 100.0, "%"),
    "hand_score": ("hand: detector's score and agreement", 1.0, ""),
    "joints": ("hand: joints within 20 mm of where they are, expected, 88 or less", 100.0, "%"),
}
"""Words, factor and unit of each number."""

SHOWN: Mapping[str, Callable[[float], float]] = {
    "agreement": lambda value: 1.0 - exp(-value),
    "left_over": lambda value: round(max(exp(value) - 0.01, 0.0), 6),
    "mask_piece": lambda value: PIECE * expm1(value),
    "rival": lambda value: 0.8 + 0.2 * value,
    "joints": lambda value: 1.0 / (1.0 + exp(-value)),
    **dict.fromkeys(("other_size", "other_side"), exp),
}
"""From what the odds are made of to what people read."""


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

    @property
    def words(self) -> str:
        """What it measures."""
        return ROWS[self.name][0]


@dataclass(frozen=True)
class PerceptionVerdict:
    """Whether an answer can be used."""

    sure: bool
    """Whether both probabilities are high enough."""
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
    looks: int = 1
    """Images that the probability of the object rests on; the evidence is of the surest."""

    @property
    def probability(self) -> float:
        """That all is right."""
        return self.object * self.hand

    @property
    def words(self) -> str:
        """The verdict in a line."""
        if self.fitted:
            kind, sizes = self.fitted.split(":")
            return (
                f"unknown object: a {kind} of {sizes.replace('x', ' x ')} mm explains "
                f"{100 * self.object:.0f} % of what is seen; the rest is a guess "
                f"(hand {100 * self.hand:.0f} %)" + (f"; not sure: {self.doubt}" if self.doubt else "")
            )
        parts = f"object {100 * self.object:.0f} %, hand {100 * self.hand:.0f} %"
        if self.looks > 1:
            parts += f"; {self.looks} looks"
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
            unit = f" {one.unit}" if one.unit not in ("", "%") else one.unit and " %"
            value = f"{one.value:.3g}{unit}" if isfinite(one.value) else "not known"
            table.append((one.words, value, f"{one.usual:.3g}{unit}", f"{one.share:+.1f}"))
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
            "looks": self.looks,
        }


def hand_features(hand: HandEstimate) -> dict[str, float]:
    """What the probability of the hand is made of, by the names of ``HAND_WEIGHTS``."""
    part = min(max(float(hand.confidence.mean()), 0.01), ENOUGH)
    return {"hand_score": hand.score, "joints": log(part / (1.0 - part))}


def perception_verdict(
    thing: ObjectEstimate, hand: HandEstimate, fitted: str = "", doubt: str = "", given: bool = False
) -> PerceptionVerdict:
    """The verdict.

    Args:
        thing: the object's pose.
        hand: as it was refined.
        fitted: shape that stands for an object without a mesh.
        doubt: what speaks against it whatever the probabilities are.
        given: whether the pose came from elsewhere and was not looked for.
    """
    of_hand = hand_features(hand)
    probability = HAND_WEIGHTS.probability(of_hand)
    evidence = []
    if thing.evidence is not None:
        known = features(thing.evidence)
        shares = OBJECT_WEIGHTS.shares(known)
        # Where too little of the outline is seen the weights take a usual number, which is not shown; nor are
        # pieces of a mask where there is none.
        unknown = [name for name in ("larger", "off") if isnan(getattr(thing.evidence, name))]
        unknown += ["mask_piece"] if thing.evidence.told != 1.0 else []
        shown = known | dict.fromkeys(unknown, nan)
        evidence += [_meter(name, shown[name], OBJECT_WEIGHTS.usual[name], shares[name]) for name in shares]
    shares = HAND_WEIGHTS.shares(of_hand)
    evidence += [_meter(name, of_hand[name], HAND_WEIGHTS.usual[name], shares[name]) for name in shares]
    sure = thing.accepted and probability >= ACCEPTED_HAND and not doubt
    advice = object_help(thing, given)
    if fitted and not thing.accepted:
        advice = ("a click at the object (--point u,v), or a mask", "a mesh of the object")
    if probability < ACCEPTED_HAND:
        advice += ("a view in which more of the hand is seen, bare and well lit",)
    return PerceptionVerdict(sure, thing.score, probability, tuple(evidence), advice, fitted, doubt)


def _meter(name: str, value: float, usual: float, share: float) -> Meter:
    _, factor, unit = ROWS[name]
    shown = SHOWN.get(name, float)
    value, usual = shown(value), shown(usual)
    return Meter(name, factor * value, factor * usual, unit, share)


def object_help(thing: ObjectEstimate, given: bool = False) -> tuple[str, ...]:
    """What would make an object's pose surer, most useful first; nothing where it is accepted.

    Args:
        thing: the object's pose.
        given: whether it came from elsewhere.
    """
    e = thing.evidence
    if e is None or thing.accepted:
        return ()
    shares = OBJECT_WEIGHTS.shares(features(e))
    size = shares["other_size"] + shares["other_side"]
    outline = shares["larger"] + shares["off"] + shares["left_over"] + shares["mask_piece"]
    covered = shares["agreement"] + outline
    found = []
    if max(e.other_size, e.other_side) > BETTER and size < covered:
        found.append("a mesh of the right size: another one fits better; is its unit right?")
    if e.foreign > LOOSE_MASK:
        found.append(f"a tighter mask: {100 * e.foreign:.0f} % of it look like hand or background")
    if e.told < 1.0 and given:
        # A click tells where to look for a pose.
        found.append("a mask of the object (--mask)")
    elif e.told == 0.0:
        found.append("a click at the object (--point u,v), or a mask")
    if e.hidden > MUCH_HIDDEN:
        found.append(f"another view: {100 * e.hidden:.0f} % of the object is behind the hand")
    elif size < AGAINST:
        found.append("another view, in which more of the object is seen")
    if e.pixels < FEW_PIXELS:
        found.append(f"the camera nearer to it: only {e.pixels:.0f} pixels show the object")
    if e.edge_width > SMOOTHED:
        found.append("the camera's spatial and hole-filling filters turned off")
    if e.colored == 0.0 and e.rival > ALIKE:
        found.append("a mesh with colors: another pose fits nearly as well")
    if covered < AGAINST:
        found.append("the mesh of this very object: this one does not cover what is seen")
    return tuple(found)
