"""What contacts can take of a task's loads, before a plan is tried."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import CollisionScene
from fungrasp.optimization.wrench_resistance import grip_of, resisted_share_of
from fungrasp.planning.expected_loads import use_loads
from fungrasp.task import GraspPlan
from fungrasp.task.use import UseMotion, load_use_motions, motion_of

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


def _share(plans: GraspPlan, motion: UseMotion, hand: Hand, objects: Mapping[str, ObjectModel]) -> np.ndarray:
    names = plans.object_name.tolist()
    around = CollisionScene.settled(names, plans.object_pose, objects)
    models = [objects[name] for name in names]
    grip = plans.grasp_palm_pose, plans.grasp_joints
    loads = np.array(
        [
            use_loads(motion, hand, model, plans.object_pose[n], grip[0][n], grip[1][n], float(mass))
            for n, (model, mass) in enumerate(zip(models, plans.object_mass.tolist(), strict=True))
        ]
    )
    points = HandPoints(HandKinematics(hand, len(plans)))
    return resisted_share_of(grip_of(points, around, models, *grip), loads)
