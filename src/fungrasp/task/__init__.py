"""Observations, actions and rewards of policies; the lift test; success criteria."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.task.belief import Belief
    from fungrasp.task.environment import LiftEnvironment, play
    from fungrasp.task.grasp_plan import GraspPlan
    from fungrasp.task.lift import LiftTask
    from fungrasp.task.outcome import DIVERGED, Outcomes
    from fungrasp.task.policy import Action, Observation, Policy, Privileged, PrivilegedPolicy
    from fungrasp.task.protocol import LiftProtocol

__all__ = [
    "DIVERGED",
    "Action",
    "Belief",
    "GraspPlan",
    "LiftEnvironment",
    "LiftProtocol",
    "LiftTask",
    "Observation",
    "Outcomes",
    "Policy",
    "Privileged",
    "PrivilegedPolicy",
    "play",
]

__getattr__ = lazy_names(
    __name__,
    {
        "belief": "Belief",
        "environment": "LiftEnvironment play",
        "grasp_plan": "GraspPlan",
        "lift": "LiftTask",
        "outcome": "DIVERGED Outcomes",
        "policy": "Action Observation Policy Privileged PrivilegedPolicy",
        "protocol": "LiftProtocol",
    },
)
