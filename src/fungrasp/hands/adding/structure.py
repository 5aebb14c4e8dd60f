"""Find fingers, thumb and side of a hand from its kinematic tree and geometry; names resolve ambiguities."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.adding.couplings import GivenCoupling
from fungrasp.hands.adding.finger_chains import (
    Chain,
    chain_joints,
    find_chains,
    flexing_joints,
    refuse_jaws,
    straight_fingers,
)
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.findings import Finding, finger_of, listed, warning
from fungrasp.hands.hand import FINGERS
from fungrasp.hands.kinematic_tree import Drive, ancestors, body_name, subtree

SIDE_RATIO = 0.15
"""Smallest sideways offset of a thumb's base that alone determines the side, as a share of finger length."""

ALIKE = 1.2
"""Largest ratio of the lengths of identical fingers."""

ONE_SIDED = 1.5
"""A finger bends to the side to which its joints have more range by this factor."""


@dataclass(frozen=True)
class HandStructure:
    """Parts of a hand."""

    palm: int
    """Body id."""
    fingers: Mapping[str, Chain]
    """Fingers by name, in the order of ``FINGERS``."""
    along: np.ndarray
    """Unit vector along the straight fingers, palm frame, shape [3]."""
    normal: np.ndarray
    """Unit vector out of the palm, perpendicular to ``along``, palm frame, shape [3]."""
    side: str
    """"right" or "left"."""
    straight: np.ndarray
    """Joint positions with straight fingers [rad], shape [M]."""


@dataclass(frozen=True)
class Answers:
    """Properties of a hand given by the user; the others (None or empty) are found."""

    palm: str | None = None
    """Name of the palm body."""
    thumb: str | None = None
    """Name of a body of the thumb."""
    side: str | None = None
    """"right" or "left"."""
    normal: tuple[float, float, float] | None = None
    """Vector out of the palm, palm frame."""
    fingers: Mapping[str, str] | None = None
    """A body of each used finger, by finger."""
    couplings: Sequence[GivenCoupling] = ()
    """Couplings of joints."""
    radius: float | None = None
    """Radius of fingers without shapes [m]."""


def find_structure(
    model: mujoco.MjModel,
    palm: int,
    couplings: dict[int, Drive],
    ties: Sequence[tuple[int, int]],
    tips: Mapping[int, np.ndarray],
    answers: Answers,
    findings: list[Finding],
) -> HandStructure:
    """Find the parts of a hand.

    Args:
        ties: pairs of bodies that close loops.
        tips: far end of each moving body, by body id, body frame [m], shape [3].
        findings: uncertain decisions are added.

    Raises:
        FungraspError: a part cannot be determined; the message names its option.
    """
    poses = Poses(model, couplings, palm)
    poses.set(poses.start)
    chains = find_chains(model, poses, palm, tips, ties)
    refuse_jaws(poses, chains)
    straight = straight_fingers(poses, chains, tips)
    joints = poses.set(straight)
    middle = np.mean([poses.of_body(chain.bodies[-1], tips[chain.bodies[-1]]) for chain in chains], axis=0)
    features = [_features(poses, chain, tips, straight, middle) for chain in chains]
    poses.set(straight)
    thumb = _thumb(model, chains, features, answers, findings)
    guessed = [body_name(model, c.bodies[0]) for c, f in zip(chains, features, strict=True) if f.guessed]
    if guessed and answers.normal is None:
        findings.append(
            warning(
                f"the finger {listed(guessed)} can bend as far to either side: taken to bend toward the "
                "others; --normal X Y Z changes it"
            )
        )
    long = [i for i in range(len(chains)) if i != thumb]
    along = _snapped(np.sum([features[i].direction for i in long], axis=0))
    if answers.normal is None:
        bend = np.sum([features[i].bend for i in long], axis=0)
        if np.linalg.norm(bend) < 0.2 * len(long):
            raise FungraspError(
                "the fingers do not bend to a common side, so the palm normal is unknown; give it with "
                f"--normal X Y Z in the frame of '{body_name(model, palm)}'"
            )
        normal = _snapped(bend - (bend @ along) * along)
        normal = normal - (normal @ along) * along
    else:
        normal = np.array(answers.normal, dtype=float)
        normal = normal - (normal @ along) * along
    normal /= np.linalg.norm(normal)
    names, side = _names(poses, chains, features, thumb, np.cross(along, normal), answers, findings)
    fingers = {name: chains[names[name]] for name in FINGERS if name in names}
    return HandStructure(palm, fingers, along, normal, side, joints)


@dataclass(frozen=True)
class _Features:
    """Geometry of a finger, palm frame, shape [3] each."""

    base: np.ndarray
    direction: np.ndarray
    """Unit vector from the base to the tip of the straight finger."""
    bend: np.ndarray
    """Direction of the tip's motion as the finger bends."""
    axis: np.ndarray
    """Axis of positive bending."""
    length: float
    middle: np.ndarray
    """Mean of the base and the tip of the half bent finger [m]."""
    guessed: bool
    """Whether the limits do not determine to which side it bends."""


def _features(
    poses: Poses, chain: Chain, tips: Mapping[int, np.ndarray], straight: np.ndarray, middle: np.ndarray
) -> _Features:
    """middle: mean of all tips with straight fingers, palm frame [m], shape [3]."""
    end = chain.bodies[-1]
    poses.set(straight)
    hinge = poses.axis(chain_joints(poses.model, chain)[-1])
    base, tip = poses.anchor(chain.links[0]), poses.of_body(end, tips[end])
    direction = (tip - base) / max(float(np.linalg.norm(tip - base)), 1e-9)
    # The axis is exact, while protruding shapes may move the tip off the finger's plane.
    bend = np.cross(hinge, direction)
    bend /= max(float(np.linalg.norm(bend)), 1e-9)
    moved = np.flatnonzero(np.abs(poses.matrix[flexing_joints(poses, chain)]).sum(axis=0)).tolist()
    signs = {u: _tip_motion(poses, chain, tips, straight, u) @ bend for u in moved}
    # Range of the joints towards and away from ``bend``.
    up, down = poses.high - straight, straight - poses.low
    toward = sum(up[u] if sign > 0 else down[u] for u, sign in signs.items())
    away = sum(down[u] if sign > 0 else up[u] for u, sign in signs.items())
    guessed = not (toward > ONE_SIDED * away or away > ONE_SIDED * toward)
    if not guessed:
        turn = 1.0 if toward > away else -1.0
    else:
        # Fingers that bend both ways close towards each other.
        turn = 1.0 if (middle - tip) @ bend >= 0 else -1.0
    bend *= turn
    bent = straight.copy()
    for u, sign in signs.items():
        bent[u] += 0.5 * up[u] if sign * turn > 0 else -0.5 * down[u]
    poses.set(bent)
    after = poses.of_body(end, tips[end])
    axis = np.cross(direction, bend)
    length, center = float(np.linalg.norm(tip - base)), 0.5 * (base + after)
    return _Features(base, direction, bend, axis, length, center, guessed)


def _tip_motion(
    poses: Poses, chain: Chain, tips: Mapping[int, np.ndarray], straight: np.ndarray, joint: int
) -> np.ndarray:
    """Return the motion of the tip per radian of an independent joint [m/rad], shape [3]."""
    end, step = chain.bodies[-1], 1e-4
    places = []
    for offset in (step, -step):
        trial = straight.copy()
        trial[joint] += offset
        poses.set(trial)
        places.append(poses.of_body(end, tips[end]))
    return (places[0] - places[1]) / (2 * step)


def _thumb(
    model: mujoco.MjModel,
    chains: list[Chain],
    features: list[_Features],
    answers: Answers,
    findings: list[Finding],
) -> int:
    """Return the index of the thumb: the only chain named after it, else the chain without which the others
    bend most alike; the first of identical fingers around a center."""
    given = answers.thumb or (answers.fingers or {}).get("thumb")
    if given is not None:
        return _chain_of(model, chains, given, "--thumb")
    if len(chains) == 2:
        return _named_thumb(model, chains)

    def disorder(members: list[int]) -> float:
        pairs = list(combinations(members, 2))
        alike = [
            features[a].axis @ features[b].axis + features[a].direction @ features[b].direction
            for a, b in pairs
        ]
        return 2.0 - float(np.mean(alike))

    named = _thumbs_by_name(model, chains)
    scores = [disorder([i for i in range(len(chains)) if i != out]) for out in range(len(chains))]
    order = np.argsort(scores, kind="stable")
    if scores[order[1]] - scores[order[0]] >= 0.05:
        if len(named) == 1 and named[0] != order[0]:
            bends, said = (body_name(model, chains[i].bodies[0]) for i in (order[0], named[0]))
            findings.append(
                warning(
                    f"'{bends}' bends as a thumb would, but the names say that '{said}' is the thumb, and "
                    "are followed; --thumb BODY changes it"
                )
            )
            return named[0]
        return int(order[0])
    lengths = [feature.length for feature in features]
    if named or max(lengths) > ALIKE * min(lengths) or max(scores) < 0.5:
        return _named_thumb(model, chains)
    first = body_name(model, chains[0].bodies[0])
    findings.append(
        warning(
            f"the {len(chains)} fingers are alike and stand around a center: '{first}' "
            "is taken as the thumb; another one by --thumb BODY"
        )
    )
    return 0


def _named_thumb(model: mujoco.MjModel, chains: list[Chain]) -> int:
    """Return the index of the only chain whose bodies are named after a thumb."""
    named = _thumbs_by_name(model, chains)
    rigid = [b for b in range(1, model.nbody) if finger_of(body_name(model, b)) == "thumb"]
    if rigid and not named:
        raise FungraspError(
            f"the thumb '{body_name(model, rigid[0])}' has no joint; a hand needs a thumb that moves (give "
            "--thumb BODY if another finger is the thumb)"
        )
    if len(named) != 1:
        raise FungraspError(
            "the thumb can't be told from the fingers; name a body of it with --thumb BODY: "
            f"{_ends(model, chains)}"
        )
    return named[0]


def _thumbs_by_name(model: mujoco.MjModel, chains: list[Chain]) -> list[int]:
    return [
        i
        for i, chain in enumerate(chains)
        if any(finger_of(body_name(model, b)) == "thumb" for b in chain.bodies)
    ]


def _names(
    poses: Poses,
    chains: list[Chain],
    features: list[_Features],
    thumb: int,
    across: np.ndarray,
    answers: Answers,
    findings: list[Finding],
) -> tuple[dict[str, int], str]:
    """Return the index of each finger's chain, and the side. across: unit vector to the thumb's side of a
    right hand, palm frame, shape [3]."""
    model, long = poses.model, [i for i in range(len(chains)) if i != thumb]
    bases = np.array([features[i].base @ across for i in long])
    offset = float(features[thumb].base @ across - bases.mean())
    leaning = float(features[thumb].middle @ across - bases.mean())
    length = float(np.mean([features[i].length for i in long]))
    distance = offset if abs(offset) > SIDE_RATIO * length else 0.5 * (offset + leaning)
    standing = None
    if abs(distance) >= 0.5 * SIDE_RATIO * length:
        standing = "right" if distance > 0 else "left"
    side = find_side(model, poses.palm, standing, len(long), answers.side, findings)
    if answers.fingers:
        names = {
            name: _chain_of(model, chains, body, f"--finger {name}=")
            for name, body in answers.fingers.items()
        }
        return {"thumb": thumb} | names, side
    if len(long) > 4:
        raise FungraspError(
            f"{len(long)} fingers beside the thumb are found; name those that imitate human fingers with "
            f"--finger index=BODY middle=BODY ...: {_ends(model, chains)}"
        )
    order = [long[i] for i in np.argsort(-bases if side == "right" else bases, kind="stable")]
    by_name = {name: i for i in long if (name := _name_of(model, chains[i])) in FINGERS}
    if len(by_name) == len(long):
        # A hand may lack fingers: only the order of those present is compared.
        if [by_name[name] for name in FINGERS if name in by_name] != order:
            raise FungraspError(
                f"the names of the fingers contradict their places on a {side} hand, which are, from the "
                f"thumb's side: {listed([body_name(model, chains[i].bodies[0]) for i in order])}; say "
                "which is which with --finger index=BODY middle=BODY ..., or the hand's side with --side"
            )
        return by_name | {"thumb": thumb}, side
    return dict(zip(FINGERS, order, strict=False)) | {"thumb": thumb}, side


def _name_of(model: mujoco.MjModel, chain: Chain) -> str | None:
    """Return the finger that most of a chain's bodies are named after, or None."""
    votes = Counter(finger for b in chain.bodies if (finger := finger_of(body_name(model, b))))
    return votes.most_common(1)[0][0] if votes else None


def _chain_of(model: mujoco.MjModel, chains: list[Chain], body: str, option: str) -> int:
    for i, chain in enumerate(chains):
        if body in [body_name(model, b) for b in chain.bodies]:
            return i
    known = [body_name(model, b) for chain in chains for b in chain.bodies]
    raise FungraspError(f"{option}: {UnknownNameError('body of a finger', body, known)}")


def _ends(model: mujoco.MjModel, chains: list[Chain]) -> str:
    return listed([body_name(model, chain.bodies[-1]) for chain in chains])


def _snapped(vector: np.ndarray, within: float = np.radians(12.0)) -> np.ndarray:
    """Return the unit vector, snapped to an axis of the frame within this angle [rad]."""
    vector = vector / np.linalg.norm(vector)
    longest = int(np.argmax(np.abs(vector)))
    if abs(vector[longest]) > np.cos(within):
        return np.sign(vector[longest]) * np.eye(3)[longest]
    return vector


SIDES = {
    side: re.compile(rf"(?<![a-z0-9])(?:{words})(?![a-z0-9])")
    for side, words in {"right": "right|rh|r", "left": "left|lh|l"}.items()
}
"""Parts of names that indicate the side of a hand; "l1", a link, does not."""


def find_side(
    model: mujoco.MjModel,
    palm: int,
    standing: str | None,
    fingers: int,
    answer: str | None,
    findings: list[Finding],
) -> str:
    """Return the side of a hand.

    Args:
        standing: side by the position of the thumb; None if the thumb is in the middle.
        fingers: number of fingers beside the thumb.
        answer: side given by the user.
        findings: contradictions and assumptions are added.

    Raises:
        FungraspError: the side cannot be determined.
    """
    named = _named_side(model, palm)
    if answer is not None:
        if standing not in (None, answer):
            findings.append(
                warning(f"the thumb stands where that of a {standing} hand does; --side {answer} is taken")
            )
        elif standing is None and named not in (None, answer):
            findings.append(warning(f"the names say {named} hand; --side {answer} is taken"))
        return answer
    if standing is not None:
        if named not in (None, standing):
            findings.append(
                warning(
                    f"the names say {named} hand, the thumb stands where that of a {standing} one does: "
                    f"taken as a {standing} hand; --side {named} changes it"
                )
            )
        return standing
    if named is None and fingers > 2:
        raise FungraspError(
            "the thumb stands in the middle, so that a left hand can't be told from a right one: say "
            "--side right or --side left"
        )
    # A hand with two fingers and a thumb in the middle is its own mirror image.
    side = named or "right"
    findings.append(
        warning(
            f"the thumb stands in the middle: taken as a {side} hand "
            f"{'by its names' if named else 'by default'}; --side changes it"
        )
    )
    return side


def _named_side(model: mujoco.MjModel, palm: int) -> str | None:
    """Return the side in most names of the hand's bodies, or else in those of the bodies above the palm."""
    for bodies in (subtree(model, palm), ancestors(model, palm)):
        names = [body_name(model, b).lower() for b in bodies]
        for side, pattern in SIDES.items():
            if sum(bool(pattern.search(name)) for name in names) > 0.5 * len(names):
                return side
    return None
