"""What a policy is: it sees observations and nothing else."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from fungrasp.task.action import Action
from fungrasp.task.grasp_plan import GraspPlan
from fungrasp.task.observation import Observation, Privileged


@runtime_checkable
class Policy(Protocol):
    """Acts for W robots at the plan's control rate, in simulation and on robots alike."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes.

        Args:
            plan: what to follow, one for each robot.
            observation: what is seen as the episodes begin.
        """
        ...

    def act(self, observation: Observation) -> Action:
        """What to do in the next control period. observation: at its beginning; the first is that of
        ``reset``."""
        ...


@runtime_checkable
class PrivilegedPolicy(Protocol):
    """A policy that also gets the privileged state, which only a simulation knows: a teacher."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """Begin new episodes, see ``Policy.reset``."""
        ...

    def act_privileged(self, observation: Observation, privileged: Privileged) -> Action:
        """What to do in the next control period, see ``Policy.act``. privileged: at the beginning of the
        control period."""
        ...
