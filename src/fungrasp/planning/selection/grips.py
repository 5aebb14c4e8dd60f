"""Other grips of the same object for its use: solved from starts far around the given grasp, and chosen by
what their contacts can take of the task's loads.

Variations of one grasp (``variations.vary``) touch where it touches. Where no forces at those places resist a
pull or a tilt, other places must be found: fingers around the far side, the palm behind a handle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fungrasp.geometry.poses import compose, invert, rotate
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.wrench_resistance import DEEPEST, grip_of, lift_loads, resisted_share_of
from fungrasp.planning.grasp_adaptation import adapt_to_settled_object
from fungrasp.planning.selection.use_strength import loads_of_use
from fungrasp.retargeting.contact_optimization import STARTS, Start, moved_starts
from fungrasp.sim2real import random_stream
from fungrasp.simulation.scene import GRAVITY
from fungrasp.task import Belief
from fungrasp.task.use import load_use_motions, motion_of

TURN, SHIFT, BENT = 0.4, 0.02, 0.2
"""Standard deviations of the starts beyond ``STARTS``, as of those that these were chosen from: turn about
the fingertips' mean [rad], shift [m], share of the joints' angles."""

LIKENESS = 0.1
"""Mean distance of the key points from the given grasp's that counts like a whole load unresisted [m], as in
retargeting."""

PARENTS = 8
"""The best grips so far, around which more are solved."""

NEARER = 0.35
"""How far around them, as a share of the standard deviations above."""

DISTURBANCE = 0.5
"""What a grip is to take in the lift besides the weight, in weights."""


def grips_for_use(
    grasps: RobotGraspSet,
    belief: Belief,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    number: int,
    rounds: int,
    kept: int,
    seed: int,
) -> RobotGraspSet:
    """The best ``kept`` of other grips of each of G grasps, G after G, the best first.

    Args:
        grasps: G grasps for tasks; of one without a motion the loads of the lift alone count.
        belief: G rows, table at zero.
        hand: the robot hand.
        objects: by name.
        number: starts of each grasp in a round: of the first around the grasp, then around the best so far.
        rounds: how often.
        kept: grips of each that are returned.
        seed: of the starts.
    """
    count = len(grasps)
    rows = np.tile(np.arange(count), number)
    given = grasps.select(rows)
    scorer = _Grips(given, belief.select(rows), hand, objects, count)
    best = scorer.solve(*scorer.given, _starts(number, seed))
    for again in range(1, rounds):
        order = np.argsort(best[2].reshape(-1, count), axis=0, kind="stable")
        parents = (order[np.arange(number) % PARENTS] * count + np.arange(count)).ravel()
        near = scorer.solve(best[0][parents], best[1][parents], _draw(number, NEARER, seed, again))
        both = [np.concatenate(pair) for pair in zip(best, near, strict=True)]
        order = np.argsort(both[2].reshape(-1, count), axis=0, kind="stable")[:number]
        chosen = (order * count + np.arange(count)).ravel()
        best = both[0][chosen], both[1][chosen], both[2][chosen]
    order = np.argsort(best[2].reshape(-1, count), axis=0, kind="stable")[:kept]
    chosen = (order * count + np.arange(count)).ravel()
    found = given.select(chosen)
    return replace(
        found,
        wrist_pose=compose(found.object_pose, best[0][chosen]),
        joint_positions=hand.all_joints(best[1][chosen]),
    )


class _Grips:
    """Solves and judges N grips."""

    def __init__(
        self,
        given: RobotGraspSet,
        belief: Belief,
        hand: Hand,
        objects: Mapping[str, ObjectModel],
        groups: int,
    ):
        # Every second start draws all links to the object, not only those that should touch.
        wrapped = given.link_contacts | (np.arange(len(given)) // groups % 2 == 1)[:, None]
        self._grasps = replace(given, link_contacts=wrapped)
        self._belief, self._hand, self._objects = belief, hand, objects
        self.given = (
            compose(invert(given.object_pose), given.wrist_pose),
            hand.independent(given.joint_positions),
        )
        """Palm, object frame, shape [N, 7], and independent joints [rad], shape [N, U], of the grasps."""
        self._points = HandPoints(HandKinematics(hand, len(given)))
        self._tips = self._tips_of(*self.given)
        names, pose = given.object_name.tolist(), belief.object_pose
        self._models = [objects[name] for name in names]
        self._around = CollisionScene.settled(names, pose, objects)
        up = rotate(invert(pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
        self._lifting = lift_loads(up, GRAVITY * belief.object_mass, DISTURBANCE)
        known = load_use_motions().values()
        assert given.task is not None
        self._motions = [motion_of(task, known) for task in given.task.tolist()]

    def solve(
        self, palm: np.ndarray, joints: np.ndarray, starts: Sequence[Start]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Grips near moved ones: palm [N, 7], joints [N, U], and cost, shape [N].

        Args:
            palm, joints: as ``given``.
            starts: how they are moved, each for N / K grasps in turn.
        """
        start = moved_starts(self._points, palm, joints, starts)
        palm, joints = adapt_to_settled_object(
            self._hand, self._grasps, self._objects, self._belief.object_pose, *start
        )
        return palm, joints, self._cost(palm, joints)

    def _cost(self, palm: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Unresisted share of the worst load, and how far the fingers are from the given grasp's."""
        pose, mass = self._belief.object_pose, self._belief.object_mass
        share = np.empty(len(palm))
        # Those of one motion have as many loads.
        for motion in dict.fromkeys(self._motions):
            some = np.array([i for i, other in enumerate(self._motions) if other is motion])
            models, loads = [self._models[i] for i in some], self._lifting[some]
            if motion is not None:
                of_use = loads_of_use(
                    motion, self._hand, models, pose[some], palm[some], joints[some], mass[some]
                )
                loads = np.concatenate([loads, of_use], axis=1)
            points, around = self._points.for_hands(len(some)), self._around.rows(some)
            share[some] = resisted_share_of(grip_of(points, around, models, palm[some], joints[some]), loads)
        collisions = [
            partial(terms.object_penetration, unit=DEEPEST),
            partial(terms.table_penetration, unit=DEEPEST, margin=0.0),
            partial(terms.self_penetration, unit=DEEPEST),
        ]
        # A hand in the object, the table or itself by twice ``DEEPEST`` has no grip.
        share[minimize(self._points, self._around, collisions, palm, joints, 0)[2] > 2.0] = 0.0
        apart = np.linalg.norm(self._tips_of(palm, joints) - self._tips, axis=2).mean(axis=1)
        return 1.0 - share + apart / LIKENESS

    def _tips_of(self, palm: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Far key points of the finger links [m], object frame, shape [N, S, 3]."""
        self._points.kinematics.update(palm, joints)
        return self._points.kinematics.points(self._points.keypoints)[:, self._points.match.far]


def _starts(number: int, seed: int) -> list[Start]:
    """``STARTS`` and as many random ones as are missing."""
    return [*STARTS, *_draw(max(number - len(STARTS), 0), 1.0, seed, 0)][:number]


def _draw(number: int, share: float, seed: int, stream: int) -> list[Start]:
    """Random starts. share: of the standard deviations above."""
    noise = share * random_stream("grips for use", seed, stream).normal(size=(number, 7))
    return [Start(tuple(TURN * row[:3]), tuple(SHIFT * row[3:6]), float(BENT * row[6])) for row in noise]
