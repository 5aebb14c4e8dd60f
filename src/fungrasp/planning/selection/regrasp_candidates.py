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
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.wrench_resistance import DEEPEST, grip_of, lift_loads, resisted_share_of
from fungrasp.planning.expected_loads import use_loads
from fungrasp.planning.grasp_adaptation import adapt_to_settled_object
from fungrasp.retargeting.contact_optimization import STARTS, Start, moved_starts
from fungrasp.sim2real import random_stream
from fungrasp.simulation.scene import GRAVITY
from fungrasp.task import Belief, GraspPlan
from fungrasp.task.use import UseMotion, load_use_motions, motion_of
from fungrasp.task.use.outcome import touched_parts

STRENGTH_POWER = 4.0
"""How fast the chance to withstand a use falls with the share of its load that contacts take: of 37 grasps
that held, 10 of 21 passed above a share of 0.9, 3 of 16 below, whose mean was 0.6."""

PASSED = 0.5
"""How many of those pass whose contacts can take all of it: these 10 of 21."""

DEEPEST_ON_THE_WAY = 0.001
"""A hand whose way goes farther into the object than this strikes it [m]: rollouts begin at its end, and do
not see that. Of 30 chosen plans five went 2 to 22 mm into it, and four of their objects were not lifted."""


def chance_of_use(
    plans: GraspPlan, tasks: np.ndarray, hand: Hand, objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """What remains of the expected success of plans in view of their tasks, shape [N]: a half, which is what
    an object counts that is held and withstands nothing, and the chance of use, the greater the more of the
    task's load the contacts can take, counts another; nothing where the hand strikes the object on its way.
    Arguments as for ``resisted_share``."""
    withstood = resisted_share(plans, tasks, hand, objects) ** STRENGTH_POWER
    struck = depth_on_the_way(plans, hand, objects) > DEEPEST_ON_THE_WAY
    return np.where(struck, 0.0, 0.5 + 0.5 * PASSED * withstood)


def depth_on_the_way(plans: GraspPlan, hand: Hand, objects: Mapping[str, ObjectModel]) -> np.ndarray:
    """How deep hands go into their objects along the setpoints until the fingers close [m], shape [N].

    Args:
        plans: N of them.
    """
    depth = np.zeros(len(plans))
    steps = np.arange(plans.palm_setpoint_object.shape[1])
    plan, step = np.nonzero(steps <= plans.closing_step[:, None])
    names = plans.object_name[plan].tolist()
    around = CollisionScene.settled(names, plans.object_pose[plan], objects)
    points = HandPoints(HandKinematics(hand, len(plan)))
    grip = plans.palm_setpoint_object[plan, step], plans.finger_targets[plan, step]
    clearance = contacts_of_links(points, around, *grip, within=0.0).clearance.min(axis=1)
    np.maximum.at(depth, plan, np.where(np.isfinite(clearance), -clearance, 0.0))
    return depth


def resisted_share(
    plans: GraspPlan, tasks: np.ndarray, hand: Hand, objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """Share of the worst load of each use motion that the contacts can take within friction cones and torque
    limits, from 0 to 1, shape [N]; 1 where the task has no motion.

    Args:
        plans: N planned grasps.
        tasks: what they are for, shape [N] str.
    """
    known = load_use_motions().values()
    motions = [motion_of(task, known) for task in tasks.tolist()]
    share = np.ones(len(plans))
    # Those of one motion have as many loads.
    for motion in dict.fromkeys(motions):
        if motion is not None:
            rows = np.array([i for i, other in enumerate(motions) if other is motion])
            share[rows] = _share(plans.select(rows), motion, hand, objects)
    return share


def parts_to_hold(
    grasps: RobotGraspSet, hand: Hand, objects: Mapping[str, ObjectModel]
) -> list[frozenset[str]]:
    """Parts of the objects on which the links lie that should touch, N sets: where the person held them, as
    far as a robot's grasp tells. Empty where nothing should touch, and for objects without parts.

    Args:
        grasps: N grasps, not varied.
    """
    models = [objects[name] for name in grasps.object_name.tolist()]
    palm = compose(invert(grasps.object_pose), grasps.wrist_pose)
    touched = touched_parts(hand, models, palm, hand.independent(grasps.joint_positions))
    return [
        frozenset(name for name in parts[wanted].tolist() if name)
        for parts, wanted in zip(touched, grasps.link_contacts, strict=True)
    ]


def _share(plans: GraspPlan, motion: UseMotion, hand: Hand, objects: Mapping[str, ObjectModel]) -> np.ndarray:
    names = plans.object_name.tolist()
    around = CollisionScene.settled(names, plans.object_pose, objects)
    models = [objects[name] for name in names]
    grip = plans.grasp_palm_pose, plans.grasp_joints
    loads = loads_of_use(motion, hand, models, plans.object_pose, *grip, plans.object_mass)
    points = HandPoints(HandKinematics(hand, len(plans)))
    return resisted_share_of(grip_of(points, around, models, *grip), loads)


def loads_of_use(
    motion: UseMotion,
    hand: Hand,
    models: Sequence[ObjectModel],
    object_pose: np.ndarray,
    palm: np.ndarray,
    joints: np.ndarray,
    mass: np.ndarray,
) -> np.ndarray:
    """``use_loads`` of N grasps for one motion, shape [N, K, 6]; arguments as there, N of each."""
    return np.array(
        [
            use_loads(motion, hand, model, object_pose[i], palm[i], joints[i], float(mass[i]))
            for i, model in enumerate(models)
        ]
    )


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


def regrasp_candidates(
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
        number: starts of each grasp in a round: of the first around the grasp, then around the best so far.
        kept: grips of each that are returned.
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
