"""Variations of grasps: what a search tries, and what a success predictor chooses from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.planning.grasp_motion import MotionSettings


@dataclass(frozen=True)
class VariationSpread:
    """How much variations differ, one standard deviation unless said."""

    position: float = 0.008
    """Standard deviation of the wrist's shift along each axis [m]."""
    rotation: float = 0.08
    """Standard deviation of the wrist's turn about each axis [rad]."""
    joints: float = 0.05
    """Standard deviation of each joint by itself [rad]."""
    closing: float = 0.08
    """Standard deviation of a change of all joints in proportion to their angle [fraction]."""
    force: float = 0.4
    """Standard deviation of the logarithm of the squeeze."""
    press: float = 0.012
    """Range of how far the wrist goes beyond its target [m]."""


def with_settings(grasps: RobotGraspSet, settings: MotionSettings | None = None) -> RobotGraspSet:
    """The grasps with the settings of their motion written out in ``extra`` where they have none."""
    s = settings or MotionSettings()
    count = len(grasps)
    defaults = {
        "force_scale": np.ones(count),
        "press_down": np.full(count, s.press_down),
        "press_in": np.full(count, s.press_in),
    }
    return replace(grasps, extra={**defaults, **grasps.extra})


def vary(
    grasps: RobotGraspSet,
    hand: Hand,
    indices: np.ndarray,
    attempts: np.ndarray,
    seed: int,
    spread: VariationSpread,
) -> RobotGraspSet:
    """Grasps with wrist, fingers, squeeze and last press varied; each depends on seed, index and attempt
    alone.

    Args:
        grasps: N grasps that have settings (``with_settings``).
        hand: the robot hand.
        indices: a number for each grasp, shape [N].
        attempts: a number for each variation of a grasp, 0 for the grasp as it is, shape [N].
        seed: of the random numbers.
        spread: of the variations.
    """
    kinematics = HandKinematics(hand, 1)
    independent = hand.independent(grasps.joint_positions)
    size = independent.shape[1]
    noise = np.stack(
        [
            np.random.default_rng([seed, int(i), int(a)]).normal(size=10 + size)
            for i, a in zip(indices, attempts, strict=True)
        ]
    )
    noise *= (attempts > 0)[:, None]
    shift = np.concatenate(
        [spread.position * noise[:, :3], quaternion_from_rotation_vector(spread.rotation * noise[:, 3:6])],
        axis=1,
    )
    fingers = independent * (1 + spread.closing * noise[:, 6:7]) + spread.joints * noise[:, 10:]
    fingers = np.clip(fingers, kinematics.lower, kinematics.upper)
    extra = dict(grasps.extra)
    extra["force_scale"] = np.clip(extra["force_scale"] * np.exp(spread.force * noise[:, 7]), 0.3, 3.0)
    for name, column in (("press_down", 8), ("press_in", 9)):
        extra[name] = np.clip(extra[name] + 0.5 * spread.press * noise[:, column], 0.0, 1.5 * spread.press)
    return replace(
        grasps,
        wrist_pose=compose(grasps.wrist_pose, shift),
        joint_positions=hand.all_joints(fingers),
        extra=extra,
    )
