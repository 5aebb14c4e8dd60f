"""Policies by name. ``fungrasp.planning.make_planner`` makes their planners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, list_policies, load_policy, read_card
from fungrasp.policies.open_loop import OpenLoopPolicy
from fungrasp.policies.residual_policy import residual_policy
from fungrasp.task import Policy, PrivilegedPolicy

REFERENCE = "reference"
"""Policy that plays one planned motion open loop, without network or rollouts."""
PLAN = "plan"
"""Policy that plays the best of many plans open loop, selected by rollouts. It needs no network and works for
any hand."""
KINDS = ("teacher", "student")
"""Short names of the built-in policies ``<hand>-<kind>-free``."""

MADE_BY = {
    "teacher": "train one (fungrasp train)",
    "student": "train a teacher, distill it (fungrasp train, fungrasp distill)",
}
"""How to make a policy of each kind."""


@dataclass(frozen=True, eq=False)
class PolicySource:
    """Network and planner type of a policy."""

    network: Path | None
    """File of the network; None for open-loop policies."""
    searches: bool
    """Whether rollouts select the plan among many; otherwise there is one motion per grasp."""

    @property
    def digest(self) -> str:
        """SHA-256 of the network's file, "" without a network.

        Raises:
            FungraspError: the file can't be read.
        """
        return "" if self.network is None else read_card(self.network).sha256


def policy_source(name: str, hand: str) -> PolicySource:
    """Resolve the name of a policy.

    Args:
        name: "reference", "plan", one of ``KINDS``, a built-in policy, or a file.
        hand: name of the hand.

    Raises:
        FungraspError: the policy is unknown, or its file is unreadable.
    """
    if not isinstance(name, (str, Path)):
        raise FungraspError(f"a policy is given by its name or file, not {type(name).__name__}")
    if name in (REFERENCE, PLAN):
        return PolicySource(None, name == PLAN)
    path = _find(name, hand)
    card = read_card(path)
    if card.kind == "predictor":
        raise FungraspError(
            f"{path} is a success predictor, which nothing needs any more: use the policy '{PLAN}'"
        )
    return PolicySource(path, bool(card.plans))


def _find(name: str, hand: str) -> Path:
    if Path(name).suffix == SUFFIX:
        return Path(name)
    known = list_policies()
    full = f"{hand}-{name}-free" if name in KINDS else name
    if full in known:
        return known[full]
    if name in KINDS:
        raise FungraspError(
            f"no {name} for the hand '{hand}' comes with fungrasp: {MADE_BY[name]}, and give its file"
        )
    raise UnknownNameError("policy", name, [REFERENCE, PLAN, *KINDS, *known])


def default_policy(hand: str) -> str:
    """Return the name of a hand's built-in student, or "plan" if there is none. hand: name of the hand."""
    name = f"{hand}-student-free"
    return name if name in list_policies() else PLAN


def make_policy(
    name: str, hand: Hand | str | Path, objects: Mapping[str, ObjectModel]
) -> Policy | PrivilegedPolicy:
    """Make a policy by name.

    Args:
        name: see ``policy_source``.
        hand: robot hand, its name, or the path of its TOML file.

    Raises:
        FungraspError: hand or policy is unknown, or the policy is for another hand.
    """
    hand = as_hand(hand)
    path = policy_source(name, hand.name).network
    return OpenLoopPolicy() if path is None else residual_policy(load_policy(path), hand, objects)
