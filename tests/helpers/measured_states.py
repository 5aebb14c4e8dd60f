"""Random measurements for the tests of features."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose
from fungrasp.hands import Hand
from fungrasp.task.features import MeasuredState, PlanTarget
from fungrasp.task.policy import Privileged


def poses(rng: np.random.Generator, count: int) -> np.ndarray:
    turns = Rotation.random(count, rng=rng).as_quat(scalar_first=True)
    return np.concatenate([rng.normal(size=(count, 3)), turns], axis=1)


def measured_state(rng: np.random.Generator, hand: Hand, count: int) -> MeasuredState:
    servos, points = len(hand.actuators), len(hand.keypoint_names)
    return MeasuredState(
        rng.normal(size=(count, servos)),
        rng.normal(size=(count, servos)),
        poses(rng, count),
        poses(rng, count),
        poses(rng, count),
        rng.normal(size=(count, points, 3)),
        0.05 * rng.normal(size=(count, points)),
        rng.normal(size=(count, points, 3)),
    )


def plan_target(rng: np.random.Generator, hand: Hand, count: int) -> PlanTarget:
    return PlanTarget(
        poses(rng, count),
        rng.normal(size=(count, len(hand.actuators))),
        poses(rng, count),
        rng.normal(size=(count, len(hand.keypoint_names), 3)),
        0.01 * rng.normal(size=(count, len(hand.keypoint_names))),
        rng.normal(size=(count, len(hand.keypoint_names), 3)),
        rng.random((count, len(hand.links))) < 0.5,
        poses(rng, count),
        rng.uniform(0.05, 1.0, count),
        rng.normal(size=(count, 3)),
        rng.uniform(0.01, 0.3, (count, 3)),
        rng.normal(size=count),
        rng.normal(size=count),
    )


def privileged(rng: np.random.Generator, hand: Hand, count: int) -> Privileged:
    links = len(hand.links)
    return Privileged(
        contacts=rng.random((count, links)) < 0.5,
        forces=rng.exponential(size=(count, links)),
        object_velocity=rng.normal(size=(count, 6)),
        table_forces=rng.exponential(size=(count, links)),
        self_force=rng.exponential(size=count),
        object_on_table=rng.random(count) < 0.5,
        object_mass=rng.uniform(0.05, 1.0, count),
        friction=rng.uniform(0.5, 1.0, count),
        lifted_height=rng.uniform(0.0, 0.2, count),
    )


def action(rng: np.random.Generator, hand: Hand, count: int) -> np.ndarray:
    return rng.uniform(-1, 1, (count, 6 + len(hand.actuators)))


def moved(values: MeasuredState | PlanTarget, motion: np.ndarray) -> Any:
    """The same with all world poses carried along. motion: pose, shape [7]."""
    carried = ("palm_pose", "palm_setpoint", "object_pose", "palm_goal_world", "settled_pose")
    names = [field.name for field in fields(values) if field.name in carried]
    return replace(values, **{name: compose(motion, getattr(values, name)) for name in names})
