"""Palm, fingers and thumb of a hand, found from its kinematic tree and geometry, whatever the names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise

import mujoco
import numpy as np

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.hands.adding.couplings import Coupling, coupling_matrix
from fungrasp.hands.checking.finding import listed
from fungrasp.hands.checking.kinematic_tree import ancestors, body_name, subtree
from fungrasp.hands.checking.named_parts import finger_of
from fungrasp.hands.hand import FINGERS

PALM_SHARE = 0.8
"""The palm is the last body that carries more than this share of the tree's ends."""

SAME_PLACE = 0.13
"""Joints nearer to each other than this make one joint, of several axes or rolling; share of the finger."""

FLEXING = 0.8
"""Cosine of the angle to a finger's last axis within which a joint bends the finger."""

SIDE_RATIO = 0.15
"""The thumb's distance to the side below which the side is not certain, as a share of a finger's length."""


@dataclass(frozen=True)
class Chain:
    """One finger: bodies in order from the palm."""

    bodies: tuple[int, ...]
    """Every moving body of the finger, base to tip."""
    links: tuple[int, ...]
    """At most three, whose joints lie apart."""


@dataclass(frozen=True)
class HandStructure:
    """The parts of a hand; positions and directions are in the palm body's frame, with straight fingers."""

    palm: int
    """Body id."""
    fingers: Mapping[str, Chain]
    """By name, in the order of ``FINGERS``."""
    along: np.ndarray
    """Unit vector along the straight fingers, shape [3]."""
    normal: np.ndarray
    """Unit vector out of the palm, perpendicular to ``along``, shape [3]."""
    side: str
    """"right" or "left"."""
    straight: np.ndarray
    """Joint positions with straight fingers [rad], shape [M]."""


@dataclass(frozen=True)
class Answers:
    """What the user has said; None or empty where it is to be found."""

    palm: str | None = None
    """Name of the palm body."""
    thumb: str | None = None
    """Name of a body of the thumb."""
    side: str | None = None
    """"right" or "left"."""
    normal: tuple[float, float, float] | None = None
    """Out of the palm, frame of the palm body."""
    fingers: Mapping[str, str] | None = None
    """A body of each finger that counts, by its name."""
    couplings: tuple[tuple[str, float, str], ...] = ()
    """Joints that move together: joint, slope, driver."""
    radius: float | None = None
    """Of fingers without shapes [m]."""


class Poses:
    """Poses of a model's bodies and joints at any joint positions, in the palm body's frame."""

    def __init__(self, model: mujoco.MjModel, couplings: list[Coupling], palm: int):
        self.model, self.palm = model, palm
        self.matrix, self.offset = coupling_matrix(model.njnt, couplings)
        self.data = mujoco.MjData(model)
        self.low, self.high = independent_limits(model, self.matrix, self.offset)

    def set(self, independent: np.ndarray) -> np.ndarray:
        """Move to independent joint positions [rad]; returns those of all joints."""
        joints = self.matrix @ independent + self.offset
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        self._place, self._turn = self.data.xpos[self.palm], self.data.xmat[self.palm].reshape(3, 3)
        return joints

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points of the world's frame in the palm's [m], shape [..., 3]."""
        return (points - self._place) @ self._turn

    def anchor(self, body: int) -> np.ndarray:
        """Where the first joint of a moving body lies [m], shape [3]."""
        return self.points(self.data.xanchor[self.model.body_jntadr[body]])

    def of_body(self, body: int, point: np.ndarray) -> np.ndarray:
        """A point of a body's frame in the palm's [m], shape [3]."""
        return self.points(self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ point)

    def axis(self, joint: int) -> np.ndarray:
        """Unit vector along a joint's axis, shape [3]."""
        return self.data.xaxis[joint] @ self._turn


def independent_limits(
    model: mujoco.MjModel, matrix: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the independent joints [rad], shape [U] each, such that driven joints keep theirs, where
    that leaves anything."""
    low, high = np.full(matrix.shape[1], -np.inf), np.full(matrix.shape[1], np.inf)
    for u in range(matrix.shape[1]):
        rows = np.flatnonzero(matrix[:, u])
        own = model.jnt_range[rows[np.argmax(matrix[rows, u] == 1.0)]]
        ends = (model.jnt_range[rows] - offset[rows, None]) / matrix[rows, u][:, None]
        ends.sort(axis=1)
        low[u], high[u] = max(own[0], ends[:, 0].max()), min(own[1], ends[:, 1].min())
        if high[u] - low[u] < 0.5 * np.ptp(own):
            low[u], high[u] = own
    return low, high


def find_structure(
    model: mujoco.MjModel, couplings: list[Coupling], tips: Mapping[int, np.ndarray], answers: Answers
) -> HandStructure:
    """Find the parts of a hand.

    Args:
        model: any hand, its bodies named.
        couplings: of its joints.
        tips: by moving body: the far end of the shapes and frames that move with it, its frame [m].
        answers: what is known.

    Raises:
        FungraspError: something can't be decided; the message names the option that does.
    """
    palm = _palm(model, answers.palm)
    poses = Poses(model, couplings, palm)
    start = np.clip(0.0, poses.low, poses.high)
    poses.set(start)
    chains = _chains(model, poses, palm, tips)
    straight = _straight(poses, chains, tips, start)
    joints = poses.set(straight)
    features = [_features(poses, chain, tips, straight) for chain in chains]
    poses.set(straight)
    thumb = _thumb(model, chains, features, answers)
    long = [i for i in range(len(chains)) if i != thumb]
    along = _snapped(np.sum([features[i].direction for i in long], axis=0))
    if answers.normal is None:
        bend = np.sum([features[i].bend for i in long], axis=0)
        if np.linalg.norm(bend) < 0.2 * len(long):
            raise FungraspError(
                "the fingers bend to no common side, so that the palm's normal can't be found; give it with "
                f"--normal X Y Z in the frame of '{body_name(model, palm)}'"
            )
        normal = _snapped(bend - (bend @ along) * along)
        normal = normal - (normal @ along) * along
    else:
        normal = np.array(answers.normal, dtype=float)
        normal = normal - (normal @ along) * along
    normal /= np.linalg.norm(normal)
    names, side = _names(model, chains, features, thumb, np.cross(along, normal), answers)
    fingers = {name: chains[names[name]] for name in FINGERS if name in names}
    return HandStructure(palm, fingers, along, normal, side, joints)


@dataclass(frozen=True)
class _Features:
    base: np.ndarray
    direction: np.ndarray
    """From the base to the tip of the straight finger."""
    bend: np.ndarray
    """Direction in which the tip moves as the finger bends."""
    axis: np.ndarray
    """Of its last joints, about which bending is positive."""
    length: float
    middle: np.ndarray
    """Mean of the base and the tip, half bent."""


def _palm(model: mujoco.MjModel, answer: str | None) -> int:
    names = {model.body(b).name: b for b in range(1, model.nbody)}
    if answer is not None:
        if answer not in names:
            raise FungraspError(f"--palm: {UnknownNameError('body', answer, names)}")
        return names[answer]
    moving = set(np.flatnonzero(model.body_jntnum > 0).tolist())
    if not moving:
        raise FungraspError("the model has no joints, so it is no hand")
    ends = [body for body in moving if not moving & (set(subtree(model, body)) - {body})]
    held = {body: sum(body in ancestors(model, end)[1:] for end in ends) for body in range(1, model.nbody)}
    candidates = [body for body, count in held.items() if count > PALM_SHARE * len(ends) and count > 1]
    if not candidates:
        raise FungraspError(
            f"the fingers {listed([body_name(model, end) for end in ends])} hang on no common body; name the "
            "palm with --palm BODY (if they hang on the world, put the palm into a body of its own)"
        )
    return max(candidates, key=lambda body: len(ancestors(model, body)))


def _chains(
    model: mujoco.MjModel, poses: Poses, palm: int, tips: Mapping[int, np.ndarray]
) -> list[Chain]:
    below = [b for b in subtree(model, palm) if b != palm and model.body_jntnum[b] > 0]
    ends = [b for b in below if not (set(below) & set(subtree(model, b)) - {b})]
    chains = [[b for b in reversed(ancestors(model, end)) if b in below] for end in ends]
    # A side branch shorter than half of the finger it hangs on is a part of its mechanism.
    kept = []
    for chain in chains:
        rivals = [other for other in chains if other is not chain and other[0] == chain[0]]
        shared = max((sum(a == b for a, b in zip(chain, o, strict=False)) for o in rivals), default=0)
        own = len(chain) - shared
        longest = max((len(o) - shared for o in rivals), default=0)
        if shared == 0 or own >= 2 or longest < 2:
            kept.append(chain)
    result = [Chain(tuple(chain), _links(model, poses, chain, tips)) for chain in kept]
    if len(result) < 2:
        raise FungraspError(
            f"only {len(result)} finger is found on '{body_name(model, palm)}'; a hand needs a thumb and one "
            "more: name the palm with --palm BODY"
        )
    return result


def _links(
    model: mujoco.MjModel, poses: Poses, chain: list[int], tips: Mapping[int, np.ndarray]
) -> tuple[int, ...]:
    """The last three bodies whose joints lie apart; those that bend the finger come before those that spread
    or turn it."""
    bend = poses.axis(int(model.body_jntadr[chain[-1]] + model.body_jntnum[chain[-1]] - 1))

    def joint(body: int) -> tuple[bool, int]:
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        flexing = [j for j in joints if abs(poses.axis(j) @ bend) > FLEXING]
        return bool(flexing), flexing[0] if flexing else joints[0]

    def gaps(bodies: list[int]) -> list[float]:
        spots = [poses.points(poses.data.xanchor[joint(b)[1]]) for b in bodies]
        spots.append(poses.of_body(chain[-1], tips[chain[-1]]))
        return [float(np.linalg.norm(far - near)) for near, far in pairwise(spots)]

    length = sum(gaps(chain))

    def apart(bodies: list[int]) -> list[int]:
        far = [gap > SAME_PLACE * length for gap in gaps(bodies)[:-1]]
        return [body for body, kept in zip(bodies, [*far, True], strict=True) if kept]

    flexing = apart([body for body in chain if joint(body)[0]])
    return tuple((flexing if len(flexing) >= 3 else apart(chain))[-3:])


def _straight(
    poses: Poses, chains: list[Chain], tips: Mapping[int, np.ndarray], start: np.ndarray
) -> np.ndarray:
    """Independent joints with every finger as long as it gets; those that don't lengthen it stay."""
    best = start.copy()
    for chain in chains:
        poses.set(start)
        moved = np.flatnonzero(np.abs(poses.matrix[_flexing(poses, chain)]).sum(axis=0))
        for _ in range(3):
            for u in moved[::-1]:
                options = np.unique(np.append(np.linspace(poses.low[u], poses.high[u], 13), start[u]))
                reaches = []
                for value in options:
                    trial = best.copy()
                    trial[u] = value
                    poses.set(trial)
                    tip = poses.of_body(chain.bodies[-1], tips[chain.bodies[-1]])
                    # Small bends hardly shorten a finger: the pose at zero is preferred to those.
                    reaches.append(np.linalg.norm(tip - poses.anchor(chain.links[0])) - 2e-3 * abs(value - start[u]))
                best[u] = options[int(np.argmax(reaches))]
    return best


def _joints(model: mujoco.MjModel, chain: Chain) -> list[int]:
    return [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in chain.bodies]


def _flexing(poses: Poses, chain: Chain) -> list[int]:
    """Joints parallel to the finger's last one."""
    joints = _joints(poses.model, chain)
    return [j for j in joints if abs(poses.axis(j) @ poses.axis(joints[-1])) > FLEXING]


def _features(
    poses: Poses, chain: Chain, tips: Mapping[int, np.ndarray], straight: np.ndarray
) -> _Features:
    end = chain.bodies[-1]
    poses.set(straight)
    hinge = poses.axis(_joints(poses.model, chain)[-1])
    base, tip = poses.anchor(chain.links[0]), poses.of_body(end, tips[end])
    moved = np.flatnonzero(np.abs(poses.matrix[_flexing(poses, chain)]).sum(axis=0))
    room_up, room_down = poses.high - straight, straight - poses.low
    bent = straight.copy()
    for u in moved:
        bent[u] += 0.5 * room_up[u] if room_up[u] >= room_down[u] else -0.5 * room_down[u]
    poses.set(bent)
    after = poses.of_body(end, tips[end])
    direction = (tip - base) / max(float(np.linalg.norm(tip - base)), 1e-9)
    # The axis is exact where shapes that stand out to the side move the tip off the finger's plane.
    bend = np.cross(hinge, direction)
    bend *= np.sign(bend @ (after - tip)) / max(float(np.linalg.norm(bend)), 1e-9)
    axis = np.cross(direction, bend)
    return _Features(base, direction, bend, axis, float(np.linalg.norm(tip - base)), 0.5 * (base + after))


def _thumb(
    model: mujoco.MjModel, chains: list[Chain], features: list[_Features], answers: Answers
) -> int:
    """The chain without which the others bend most alike."""
    given = answers.thumb or (answers.fingers or {}).get("thumb")
    if given is not None:
        return _chain_of(model, chains, given, "--thumb")
    if len(chains) == 2:
        return _named_thumb(model, chains)

    def disorder(members: list[int]) -> float:
        pairs = list(combinations(members, 2))
        return sum(
            (1 - features[a].axis @ features[b].axis) + (1 - features[a].direction @ features[b].direction)
            for a, b in pairs
        ) / len(pairs)

    scores = [disorder([i for i in range(len(chains)) if i != out]) for out in range(len(chains))]
    order = np.argsort(scores, kind="stable")
    if scores[order[1]] - scores[order[0]] < 0.05:
        return _named_thumb(model, chains)
    return int(order[0])


def _named_thumb(model: mujoco.MjModel, chains: list[Chain]) -> int:
    """Where geometry does not tell the thumb: the one chain whose names do."""
    named = [
        i for i, chain in enumerate(chains) if any(finger_of(body_name(model, b)) == "thumb" for b in chain.bodies)
    ]
    if len(named) != 1:
        raise FungraspError(
            f"the thumb can't be told from the fingers; name a body of it with --thumb BODY: {_ends(model, chains)}"
        )
    return named[0]


def _names(
    model: mujoco.MjModel,
    chains: list[Chain],
    features: list[_Features],
    thumb: int,
    across: np.ndarray,
    answers: Answers,
) -> tuple[dict[str, int], str]:
    """Chain of each finger, and the side. across: to the thumb's side of a right hand, shape [3]."""
    long = [i for i in range(len(chains)) if i != thumb]
    bases = np.array([features[i].base @ across for i in long])
    offset = float(features[thumb].base @ across - bases.mean())
    leaning = float(features[thumb].middle @ across - bases.mean())
    length = float(np.mean([features[i].length for i in long]))
    side = answers.side
    if side is None:
        distance = offset if abs(offset) > SIDE_RATIO * length else 0.5 * (offset + leaning)
        if abs(distance) < 0.5 * SIDE_RATIO * length:
            raise FungraspError(
                "the thumb stands in the middle, so that a left hand can't be told from a right one: say "
                "--side right or --side left"
            )
        side = "right" if distance > 0 else "left"
    if answers.fingers:
        names = {
            name: _chain_of(model, chains, body, f"--finger {name}=") for name, body in answers.fingers.items()
        }
        return {"thumb": thumb} | names, side
    if len(long) > 4:
        raise FungraspError(
            f"{len(long)} fingers beside the thumb are found; name those that imitate human fingers with "
            f"--finger index=BODY middle=BODY ...: {_ends(model, chains)}"
        )
    order = np.argsort(-bases if side == "right" else bases, kind="stable")
    return {name: long[i] for name, i in zip(FINGERS, order, strict=False)} | {"thumb": thumb}, side


def _chain_of(model: mujoco.MjModel, chains: list[Chain], body: str, option: str) -> int:
    for i, chain in enumerate(chains):
        if body in [body_name(model, b) for b in chain.bodies]:
            return i
    known = [body_name(model, b) for chain in chains for b in chain.bodies]
    raise FungraspError(f"{option}: {UnknownNameError('body of a finger', body, known)}")


def _ends(model: mujoco.MjModel, chains: list[Chain]) -> str:
    return listed([body_name(model, chain.bodies[-1]) for chain in chains])


def _snapped(vector: np.ndarray, within: float = np.radians(12.0)) -> np.ndarray:
    """Unit vector; the axis of the frame where that is near."""
    vector = vector / np.linalg.norm(vector)
    longest = int(np.argmax(np.abs(vector)))
    if abs(vector[longest]) > np.cos(within):
        return np.sign(vector[longest]) * np.eye(3)[longest]
    return vector
