"""A log shown again to the policy: it must answer as it did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.log import RecordedDeployment
from fungrasp.task import Policy


@dataclass(frozen=True)
class ReplayResult:
    """How a policy's answers compare with those in a log."""

    steps: int
    """Number of control steps."""
    different: int
    """Number of those with another action."""
    largest: float
    """Largest difference of any number of an action."""


def replay_log(log: RecordedDeployment, policy: Policy) -> ReplayResult:
    """Show a policy the observations of a log.

    Raises:
        FungraspError: the log ends before the policy began.
    """
    if log.plan is None or not log.observations:
        raise FungraspError("the log ends before the policy began: nothing to replay")
    policy.reset(log.plan, log.observations[0])
    further, before = iter(log.further_plans), -np.inf
    different, largest = 0, 0.0
    for observation, logged in zip(log.observations, log.actions, strict=True):
        if observation.time[0] < before:
            policy.reset(next(further), observation)
        before = observation.time[0]
        action = policy.act(observation).arrays()
        apart = [
            float(np.max(np.abs(action[name].astype(float) - value.astype(float))))
            for name, value in logged.arrays().items()
        ]
        different += max(apart) > 0
        largest = max(largest, *apart)
    return ReplayResult(len(log.observations), different, largest)
