"""Checks of user-defined policies before their first step."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.arrays import is_numpy
from fungrasp.geometry.poses import compose
from fungrasp.task.grasp_plan import GraspPlan
from fungrasp.task.policy import Action, Observation

SAME_PLACE = 1e-6
"""Palm goals closer than this are equal [m]."""


def check_policy(policy: Any) -> None:
    """Check that an object is a policy.

    Raises:
        FungraspError: a method is missing, or a class was passed instead of an instance.
    """
    name = policy.__name__ if isinstance(policy, type) else type(policy).__name__
    if isinstance(policy, type):
        raise FungraspError(f"the policy is the class {name}: pass an instance, {name}()")
    acts = callable(getattr(policy, "act", None)) or callable(getattr(policy, "act_privileged", None))
    lacking = [] if callable(getattr(policy, "reset", None)) else ["reset(plan, observation)"]
    lacking += [] if acts else ["act(observation)"]
    if lacking:
        raise FungraspError(f"the policy {name} lacks the method {' and '.join(lacking)}")


def check_action(action: Any, plan: GraspPlan, observation: Observation) -> None:
    """Check the first action of an episode.

    Args:
        plan: plans that are followed, W of them.
        observation: observation passed to the policy.

    Raises:
        FungraspError: the value is not an action of W robots, or its goal is in a frame other than the
            world's.
    """
    if not isinstance(action, Action):
        raise FungraspError(f"the policy's act must return a fungrasp.Action, not a {type(action).__name__}")
    if not is_numpy(observation.time):
        return
    expected = {
        "palm_goal_world": (len(plan), 7),
        "finger_targets": observation.joint_positions.shape,
        "lift": (len(plan),),
    }
    for name, shape in expected.items():
        value = np.asarray(getattr(action, name))
        if value.shape != shape:
            raise FungraspError(f"the policy's {name} has shape {value.shape}, expected {shape}")
        if name == "lift" and value.dtype != bool:
            raise FungraspError(f"the policy's lift holds {value.dtype}, expected bool")
    goal = np.asarray(action.palm_goal_world)
    if np.abs(np.linalg.norm(goal[:, 3:], axis=1) - 1).max() > 1e-3:
        raise FungraspError(
            "the policy's palm_goal_world is no pose [x y z qw qx qy qz] with a quaternion of length 1"
        )
    step = np.rint(observation.time / plan.control_period).astype(int)
    local = plan.at(step)[0]
    apart = np.linalg.norm(compose(plan.object_pose, local)[:, :3] - local[:, :3], axis=1)
    as_local = np.linalg.norm(goal[:, :3] - local[:, :3], axis=1) < SAME_PLACE
    if (as_local & (apart > SAME_PLACE)).any():
        raise FungraspError(
            "the policy's palm_goal_world is the plan's palm_goal_object, which is in the object's frame: "
            "give fungrasp.geometry.poses.compose(observation.object_pose, goal)"
        )


def check_finite(policy: Any, action: Action, plan: GraspPlan, time: Any, ended: Any) -> None:
    """Check that an action is finite, because such an episode would look like a diverged simulation. Actions
    on a GPU are not checked.

    Args:
        plan: plans that are followed, W of them.
        time: time of each episode [s], shape [W].
        ended: episodes that ended or diverged, whose actions are not used, shape [W] bool.

    Raises:
        FungraspError: a value is NaN or infinite.
    """
    if not is_numpy(time):
        return
    for name in ("palm_goal_world", "finger_targets"):
        bad = np.flatnonzero(~np.isfinite(getattr(action, name)).all(axis=1) & ~ended)
        if len(bad):
            row = int(bad[0])
            step = round(float(time[row] / plan.control_period))
            raise FungraspError(
                f"the policy {type(policy).__name__} returned {name} that is not finite at control step "
                f"{step} of world {row} ('{plan.object_name[row]}')"
            )
