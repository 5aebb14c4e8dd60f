"""Policies by name, and letting one act until all trials are over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from fungrasp.errors import UnknownNameError
from fungrasp.objects import ObjectModel
from fungrasp.policies.reference import ReferenceController
from fungrasp.task import Action, LiftTask, Trials


class Policy(Protocol):
    """Acts in all worlds of a task, at the task's control rate."""

    def act(self) -> Action:
        """What to do in the next control period."""
        ...


POLICIES: dict[str, Callable[[LiftTask, Mapping[str, ObjectModel]], Policy]] = {
    "reference": ReferenceController
}
"""Makers of policies for a task that has been reset."""


def make_policy(name: str, task: LiftTask, objects: Mapping[str, ObjectModel]) -> Policy:
    """A policy by name, ready to act.

    Args:
        name: one of ``POLICIES``.
        task: reset.
        objects: by name.

    Raises:
        FungraspError: no such policy.
    """
    if name not in POLICIES:
        raise UnknownNameError("policy", name, POLICIES)
    return POLICIES[name](task, objects)


def play(task: LiftTask, policy: Policy, watch: Callable[[], None] | None = None) -> Trials:
    """Let a policy act until all trials are over. watch: called after each substep, to record."""
    while not task.done.all():
        task.step(policy.act(), watch)
    return task.trials()
