"""Policies by name, and letting one act until all trials are over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.objects import ObjectModel
from fungrasp.planning.selection.search import Planner
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, list_policies, load_policy, read_card
from fungrasp.policies.residual_policy import LearnedPolicy, check_card
from fungrasp.policies.scripted import ReferenceController
from fungrasp.task import Action, LiftTask, Trials


class Policy(Protocol):
    """Acts in all worlds of a task, at the task's control rate."""

    def act(self) -> Action:
        """What to do in the next control period."""
        ...


POLICIES: dict[str, Callable[[LiftTask, Mapping[str, ObjectModel]], Policy]] = {
    "reference": ReferenceController
}
"""Makers of policies that need no weights, for a task that has been reset."""

KINDS = ("teacher", "student", "critic")
"""Short for the policies ``<hand>-<kind>-free`` that come with the package."""


def resolve_policy(name: str, hand: str) -> Path | None:
    """The file of a policy, None for one of ``POLICIES``.

    Args:
        name: one of ``POLICIES`` or ``KINDS``, a policy that comes with the package, or a file.
        hand: name of the hand that it should move.

    Raises:
        FungraspError: no such policy.
    """
    if name in POLICIES:
        return None
    if Path(name).suffix == SUFFIX:
        return Path(name)
    known = list_policies()
    full = f"{hand}-{name}-free" if name in KINDS else name
    if full in known:
        return known[full]
    if name in KINDS:
        raise FungraspError(
            f"no {name} for the hand '{hand}' comes with fungrasp: train one (fungrasp train), "
            "and give its file"
        )
    raise UnknownNameError("policy", name, [*POLICIES, *KINDS, *known])


def free_policy(hand: str) -> str:
    """The freely licensed student of a hand, or the reference controller if none comes with the package.

    hand: its name.
    """
    name = f"{hand}-student-free"
    return name if name in list_policies() else "reference"


def chooses(name: str, hand: str) -> bool:
    """Whether a policy chooses what to follow among variations of a grasp, which depends on a seed.

    Args: as for ``resolve_policy``.
    """
    path = resolve_policy(name, hand)
    card = None if path is None else read_card(path)
    return card is not None and (card.kind == "critic" or bool(card.plans))


def make_policy(
    name: str,
    task: LiftTask,
    objects: Mapping[str, ObjectModel],
    planner: Planner | None = None,
    seed: int = 0,
) -> Policy:
    """A policy by name, ready to act.

    Args:
        name: as for ``resolve_policy``.
        task: reset.
        objects: by name.
        planner: of policies that choose what to follow; one with the default settings if None.
        seed: of that choice.

    Raises:
        FungraspError: no such policy, or one that does not fit the task's hand.
    """
    path = resolve_policy(name, task.scene.hand.name)
    if path is None:
        return POLICIES[name](task, objects)
    network, planner = load_policy(path), planner or Planner()
    if network.card.kind == "critic":
        return ReferenceController(task, objects, motion=planner(task, objects, network, seed)[0].motion)
    if not network.card.plans:
        return LearnedPolicy(task, objects, network)
    check_card(network.card, task)
    critic = load_policy(path.with_name(network.card.plans + SUFFIX))
    return LearnedPolicy(task, objects, network, planner(task, objects, critic, seed, network)[0])


def play(task: LiftTask, policy: Policy, watch: Callable[[], None] | None = None) -> Trials:
    """Let a policy act until all trials are over. watch: called after each substep, to record."""
    while not task.done.all():
        task.step(policy.act(), watch)
    return task.trials()
