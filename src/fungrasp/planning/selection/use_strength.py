"""What a use motion needs of a grasp, before it is tried: contacts that take its loads, on the right part."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.firmness import unresisted_wrenches
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.planning.expected_loads import use_loads
from fungrasp.planning.grip_forces import FRICTION, NEAR
from fungrasp.task import GraspPlan
from fungrasp.task.use import UseMotion, load_use_motions, motion_of
from fungrasp.task.use.functional_contact import touched_parts


def resisted_share(
    plans: GraspPlan, tasks: np.ndarray, hand: Hand, objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """Share of the worst load of each use motion that the contacts can take within friction cones and torque
    limits, from 0 to 1, shape [N]; 1 where the task has no motion.

    Args:
        plans: N planned grasps.
        tasks: what they are for, shape [N] str.
        hand: the robot hand.
        objects: by name.
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
        hand: the robot hand.
        objects: by name.
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
    models = [objects[name] for name in names]
    palm, joints = plans.grasp_palm_pose, plans.grasp_joints
    loads = np.array(
        [
            use_loads(
                motion, hand, model, plans.object_pose[i], palm[i], joints[i], float(plans.object_mass[i])
            )
            for i, model in enumerate(models)
        ]
    )
    around = CollisionScene.settled(names, plans.object_pose, objects)
    points = HandPoints(HandKinematics(hand, len(plans)))
    contacts = contacts_of_links(points, around, palm, joints)
    reach = np.array([0.5 * float(np.max(model.size)) for model in models])
    loads[..., 3:] /= reach[:, None, None]
    size = np.linalg.norm(loads, axis=-1)
    left = unresisted_wrenches(
        contacts,
        contacts.clearance < NEAR,
        np.array([model.center_of_mass for model in models]),
        reach,
        loads,
        size.max(axis=1),
        np.array([servo.force_limit for servo in hand.actuators.values()]),
        FRICTION,
    )
    return np.clip(1.0 - (np.linalg.norm(left, axis=-1) / size).max(axis=1), 0.0, 1.0)
