"""A collision-free path to the grasp, planned backwards by withdrawing the hand from the object.

From the grasp, the wrist withdraws step by step along a direction. At each step the fingers open only as much
as needed to be clear (the retargeter's optimizer with collision terms only). The clearest path of several
directions is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fungrasp.core.parallel import in_chunks
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import compose, rotate
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene

RETREATS = (0.015, 0.03, 0.05, 0.08, 0.12)
"""Withdrawal of the wrist at each waypoint after the first, which is at the grasp [m]. Between waypoints 4 cm
apart, fingers passed through the object."""

BLOCKED = 0.003
"""Intrusion into the margins [m] beyond which a path is planned again, with wide open fingers and smaller
margins."""
ORDER_PENALTY = 1e-4
"""Intrusion by which a later direction must be better than the previous one [m]."""
TOUCHED = 0.001
"""Depth beyond that of the grasp [m] at which closing fingers count as passing through the object, for
example if they are beside a handle instead of within it."""
CLOSING_POINTS = 7
"""Number of hand poses checked between open and closed hand, about 5 mm apart."""
WIDE = 0.3
"""Wide open fingers, as a fraction of their angles in the grasp."""
NARROW = 0.25
"""Fraction of the object margin that is kept in narrow places, such as within a handle."""


@dataclass(frozen=True)
class ApproachSettings(CheckedRecord):
    """Margins of the path, and weights of its optimization."""

    object_margin: float = 0.008
    """Distance to keep from the object [m]."""
    table_margin: float = 0.006
    """Distance to keep from the table [m]."""
    joint_unit: float = 0.25
    """Change of a joint that counts as one unit [rad]."""
    position_unit: float = 0.006
    """Sideways shift of the wrist that counts as one unit [m]."""
    rotation_unit: float = 0.1
    """Turn of the wrist that counts as one unit [rad]."""
    iterations: int = 5
    """Iterations of the optimizer for each waypoint; twice as many for the first."""


@dataclass(frozen=True)
class Approach:
    """Waypoints of N hands, K each, nearest to the grasp first."""

    wrist_pose: np.ndarray
    """Poses of the palm body at the waypoints, object frame, shape [N, K, 7]."""
    fingers: np.ndarray
    """Independent joints at the waypoints [rad], shape [N, K, U]."""
    collision: np.ndarray
    """Deepest intrusion into the margins over the waypoints [m], shape [N]."""


def plan_approach(
    hand: Hand,
    object_names: list[str],
    settled_pose: np.ndarray,
    objects: Mapping[str, ObjectModel],
    wrist_in_object: np.ndarray,
    grasp: np.ndarray,
    settings: ApproachSettings | None = None,
) -> Approach:
    """Plan the paths of N hands to their grasps.

    Args:
        object_names: name of each grasp's object, length N.
        settled_pose: poses of the objects on the table, world frame, shape [N, 7].
        wrist_in_object: palm poses in the grasps, object frame, shape [N, 7].
        grasp: independent joints in the grasps [rad], shape [N, U].
        settings: defaults if None.
    """
    settings = settings or ApproachSettings()
    around = CollisionScene.settled(object_names, settled_pose, objects)
    centers = np.array([objects[name].center_of_mass for name in object_names])
    points = HandPoints(HandKinematics(hand, 1))

    def run(rows: np.ndarray) -> Approach:
        best: Approach | None = None
        for opening, share in ((1.0, 1.0), (WIDE, 1.0), (1.0, NARROW), (WIDE, NARROW)):
            hard = np.arange(len(rows)) if best is None else np.flatnonzero(best.collision > BLOCKED)
            if not len(hard):
                break
            which = rows[hard]
            path = _best_path(
                _CollisionResolution(points, around.rows(which), settings, share),
                around.rows(which),
                (wrist_in_object[which], grasp[which]),
                opening,
                centers[which],
            )
            if best is None:
                best = path
                continue
            better = path.collision < best.collision[hard]
            for name in ("wrist_pose", "fingers", "collision"):
                getattr(best, name)[hard[better]] = getattr(path, name)[better]
        assert best is not None
        return best

    parts = in_chunks(run, len(around))
    return Approach(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("wrist_pose", "fingers", "collision")
        )
    )


def _best_path(
    resolve: _CollisionResolution,
    around: CollisionScene,
    grasp: tuple[np.ndarray, np.ndarray],
    opening: float,
    center: np.ndarray,
) -> Approach:
    """Return the clearest path among several directions, starting with fingers near ``opening`` times their
    angles in the grasp.

    No path is clearer than its first point, which all paths share: once one path is as clear, the other
    directions are skipped.
    """
    wrist, fingers = grasp
    iterations = resolve.settings.iterations
    first = resolve(wrist, opening * fingers, 2 * iterations)
    through = resolve.closing_depth(first, wrist, fingers)
    blocked = np.where(through > TOUCHED, resolve.settings.object_margin + through, 0.0)
    first = replace(first, collision=np.maximum(first.collision, blocked))
    directions = _directions(resolve.hand, wrist, around.up[:, 0], center)
    best = _withdraw(resolve, first, directions[0], iterations)
    cost = best.collision.copy()
    for i, direction in enumerate(directions[1:], start=1):
        rows = np.flatnonzero(cost > first.collision + ORDER_PENALTY * i)
        if not len(rows):
            break
        start = Approach(first.wrist_pose[rows], first.fingers[rows], first.collision[rows])
        path = _withdraw(resolve.rows(rows), start, direction[rows], iterations)
        better = path.collision + ORDER_PENALTY * i < cost[rows]
        for name in ("wrist_pose", "fingers", "collision"):
            getattr(best, name)[rows[better]] = getattr(path, name)[better]
        cost[rows[better]] = path.collision[better] + ORDER_PENALTY * i
    return best


def _directions(hand: Hand, wrist: np.ndarray, up: np.ndarray, center: np.ndarray) -> list[np.ndarray]:
    """Return unit vectors along which the wrist may withdraw, object frame, shape [N, 3] each."""
    outwards = _unit(wrist[:, :3] - center)
    backwards = -rotate(wrist[:, 3:], hand.palm_normal)
    along = -rotate(wrist[:, 3:], hand.palm_fingers)
    return [
        outwards,
        _unit(outwards + 0.5 * up),
        _unit(backwards + along),
        backwards,
        _unit(along + 0.3 * up),
        up,
    ]


class _CollisionResolution:
    """Moves hands as little as needed to avoid object, table and self-collisions."""

    def __init__(self, points: HandPoints, around: CollisionScene, settings: ApproachSettings, share: float):
        """
        Args:
            points: points of the hand, for any number of hands.
            share: fraction of the object margin that is kept.
        """
        self.hand, self.settings = points.kinematics.hand, settings
        self._points = points.for_hands(len(around))
        self._around, self._share = around, share
        self._terms = [
            partial(terms.object_penetration, unit=0.001, margin=share * settings.object_margin),
            partial(terms.table_penetration, unit=0.001, margin=settings.table_margin),
            partial(terms.self_penetration, unit=0.002),
        ]

    def rows(self, which: np.ndarray) -> _CollisionResolution:
        """Select some of the hands."""
        return _CollisionResolution(self._points, self._around.rows(which), self.settings, self._share)

    def __call__(self, wrist: np.ndarray, fingers: np.ndarray, iterations: int) -> Approach:
        """Return one waypoint near the given state."""
        s = self.settings
        stay = partial(
            terms.stay_near,
            start=(wrist, fingers),
            unit=s.joint_unit,
            position_unit=s.position_unit,
            rotation_unit=s.rotation_unit,
        )
        wrist, fingers, _ = minimize(
            self._points, self._around, [*self._terms, stay], wrist, fingers, iterations
        )
        return Approach(wrist[:, None], fingers[:, None], self.intrusion(wrist, fingers))

    def closing_depth(self, first: Approach, wrist: np.ndarray, fingers: np.ndarray) -> np.ndarray:
        """Return the largest depth of closing hands in the object beyond that in the grasp [m], shape [N].

        Args:
            first: waypoint at which closing begins.
            wrist, fingers: grasp.
        """
        open_wrist, open_fingers, clearance = first.wrist_pose[:, 0], first.fingers[:, 0], []
        for share in np.linspace(0.0, 1.0, CLOSING_POINTS):
            pose = _between(open_wrist, wrist, share)
            joints = open_fingers + share * (fingers - open_fingers)
            clearance.append(HandState(self._points, self._around, pose, joints).clearance.min(axis=1))
        return np.maximum(np.minimum(clearance[-1], 0.0) - np.min(clearance, axis=0), 0.0)

    def intrusion(self, wrist: np.ndarray, fingers: np.ndarray) -> np.ndarray:
        """Return the depth of hands in the margins around object and table [m], shape [N]."""
        s, state = self.settings, HandState(self._points, self._around, wrist, fingers)
        deepest = np.maximum(
            s.object_margin - state.clearance.min(axis=1), s.table_margin - state.heights.min(axis=1)
        )
        return np.maximum(deepest, 0.0)


def _withdraw(
    resolve: _CollisionResolution, first: Approach, direction: np.ndarray, iterations: int
) -> Approach:
    path, before = [first], 0.0
    for retreat in RETREATS:
        wrist = path[-1].wrist_pose[:, 0].copy()
        wrist[:, :3] += (retreat - before) * direction
        before = retreat
        path.append(resolve(wrist, path[-1].fingers[:, 0], iterations))
        # Between two clear waypoints, fingers may still pass through the object.
        (a, b), (c, d) = ((p.wrist_pose[:, 0], p.fingers[:, 0]) for p in path[-2:])
        halfway = resolve.intrusion(_between(a, c, 0.5), 0.5 * (b + d))
        path[-1] = replace(path[-1], collision=np.maximum(path[-1].collision, halfway))
    return Approach(
        np.concatenate([point.wrist_pose for point in path], axis=1),
        np.concatenate([point.fingers for point in path], axis=1),
        np.max([point.collision for point in path], axis=0),
    )


def _between(a: np.ndarray, b: np.ndarray, share: float | np.ndarray) -> np.ndarray:
    """Interpolate poses from ``a`` to ``b``, shape [N, 7]."""
    b = np.where(np.sum(a[:, 3:] * b[:, 3:], axis=1, keepdims=True) < 0, b * [1, 1, 1, -1, -1, -1, -1], b)
    pose = a + share * (b - a)
    pose[:, 3:] = _unit(pose[:, 3:])
    return pose


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


class FollowedPath:
    """The planned path, parameterized by arc length, world frame."""

    def __init__(
        self, start: np.ndarray, start_fingers: np.ndarray, approach: Approach, settled_pose: np.ndarray
    ):
        """
        Args:
            start: palm poses at the start, world frame, shape [N, 7].
            start_fingers: independent joints at the start [rad], shape [N, U].
            settled_pose: poses of the objects, world frame, shape [N, 7].
        """
        planned = compose(settled_pose[:, None], approach.wrist_pose[:, ::-1])
        self.poses = np.concatenate([start[:, None], planned], axis=1)
        self.fingers = np.concatenate([start_fingers[:, None], approach.fingers[:, ::-1]], axis=1)
        legs = np.linalg.norm(np.diff(self.poses[..., :3], axis=1), axis=-1)
        self.arc = np.concatenate(
            [np.zeros((len(start), 1)), np.cumsum(np.maximum(legs, 1e-4), axis=1)], axis=1
        )
        self.length = self.arc[:, -1]
        self.progress = np.zeros(len(start))

    def at(self, arc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return palm poses, shape [N, 7], and fingers, shape [N, U], at arc lengths [m], shape [N]."""
        arc = np.clip(arc, 0.0, self.length)
        leg = np.clip((self.arc <= arc[:, None]).sum(axis=1) - 1, 0, self.arc.shape[1] - 2)
        rows = np.arange(len(arc))
        share = ((arc - self.arc[rows, leg]) / (self.arc[rows, leg + 1] - self.arc[rows, leg]))[:, None]
        pose = _between(self.poses[rows, leg], self.poses[rows, leg + 1], share)
        fingers = self.fingers[rows, leg] + share * (self.fingers[rows, leg + 1] - self.fingers[rows, leg])
        return pose, fingers

    def advance(self, position: np.ndarray, lookahead: float) -> None:
        """Advance to the arc length nearest to the palm's setpoint, by at most ``lookahead`` [m].

        Args:
            position: position of the palm's setpoint, world frame [m], shape [N, 3].
        """
        tries = self.progress + np.linspace(0.0, lookahead, 17)[:, None]
        distances = [np.linalg.norm(self.at(arc)[0][:, :3] - position, axis=1) for arc in tries]
        best = np.argmin(distances, axis=0)
        self.progress = np.minimum(tries[best, np.arange(len(best))], self.length)
