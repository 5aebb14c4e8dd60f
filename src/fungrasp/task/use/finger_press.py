"""How a finger presses a trigger: by torques, as far as the encoders tell them."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import relative
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.task.environment import LiftEnvironment
from fungrasp.task.use.motion import TriggerPress

PRESS_MARGIN = 1.5
"""The press of a finger over the force that the trigger needs: it touches beside the point that is planned,
and a part of it is lost."""


def press_offsets(environment: LiftEnvironment, world: int, trigger: TriggerPress) -> np.ndarray:
    """Offsets of the finger servos that raise the force at the finger's tip, straight into the object, to the
    trigger's and a margin [rad], shape [U]: ``J^T f`` over the servos' stiffness. What the finger presses
    with already is what its servos' torques give in that direction.

    Args:
        environment: it is read.
        world: that the finger is in.
        trigger: what is pressed, with which finger.
    """
    engine, hand = environment.engine, environment.scene.hand
    object_pose, palm = engine.object_pose[[world]], engine.palm_pose[[world]]
    joints = hand.independent(engine.joint_positions[[world]])
    kinematics = HandKinematics(hand, 1)
    kinematics.update(relative(object_pose, palm), joints)
    tip = kinematics.body_points((hand.fingers[trigger.finger].tip,))
    place = kinematics.points(tip)
    model = environment.scene.models[engine.object_index[world]]
    outward = SignedDistanceBank([model.signed_distance]).query(np.zeros(1, dtype=int), place)[1][0, 0]
    torques = -(outward / np.linalg.norm(outward)) @ kinematics.jacobian(tip.bodies, place)[0, 0, :, 6:]
    stiffness = np.array([servo.kp for servo in hand.actuators.values()])
    squeeze = environment.task.setpoints.fingers[world] - joints[0]
    pressing = torques @ (stiffness * squeeze) / (torques @ torques)
    missing = PRESS_MARGIN * trigger.force - max(pressing, 0.0)
    return max(missing, 0.0) * torques / stiffness
