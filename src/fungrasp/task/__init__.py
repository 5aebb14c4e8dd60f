"""What a policy observes, does and is rewarded for; the lift test; when a grasp has succeeded."""

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
