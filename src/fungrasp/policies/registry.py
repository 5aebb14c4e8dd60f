"""Policies by name; their planners are made by ``fungrasp.planning.make_planner``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, list_policies, load_policy, read_card
from fungrasp.policies.open_loop import OpenLoopPolicy
from fungrasp.policies.residual_policy import residual_policy
from fungrasp.task import Policy, PrivilegedPolicy

REFERENCE = "reference"
"""Name of the policy that plays one planned motion open loop, without a network and without rollouts."""
PLAN = "plan"
"""Name of the policy that plays the student's plan open loop: the difference is the benefit of feedback."""
KINDS = ("teacher", "student", "predictor")
"""Short for the policies ``<hand>-<kind>-free`` that come with the package."""

MADE_BY = {
    "teacher": "train one (fungrasp train)",
    "student": "train a teacher, distill it (fungrasp train, fungrasp distill)",
    "predictor": "train one (fungrasp predictor)",
}
"""What makes each kind."""


@dataclass(frozen=True, eq=False)
class PolicyFiles:
    """What a policy's name stands for."""

    network: Path | None
    """File of the network that acts; None where the plan is played open loop."""
    predictor: Path | None
    """File of the success predictor that candidates are chosen by; None where there is one motion for each
    grasp."""

    def digests(self) -> tuple[str, str]:
        """SHA-256 of both files, "" for none.

        Raises:
            FungraspError: a file can't be read.
        """

        def sha256(path: Path | None) -> str:
            return "" if path is None else read_card(path).sha256

        return sha256(self.network), sha256(self.predictor)


def policy_files(name: str, hand: str) -> PolicyFiles:
    """The files of a policy.

    Args:
        name: "reference", "plan", one of ``KINDS``, a policy that comes with the package, or a file.
        hand: name of the hand that it should move.

    Raises:
        FungraspError: no such policy, or a file that can't be read.
    """
    if name == REFERENCE:
        return PolicyFiles(None, None)
    if name == PLAN:
        return PolicyFiles(None, policy_files("student", hand).predictor)
    path = _find(name, hand)
    card = read_card(path)
    if card.kind == "predictor":
        return PolicyFiles(None, path)
    return PolicyFiles(path, path.with_name(card.plans + SUFFIX) if card.plans else None)


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
    """The student of a hand, or "reference" if none comes with the package. hand: its name."""
    name = f"{hand}-student-free"
    return name if name in list_policies() else REFERENCE


def make_policy(name: str, hand: Hand, objects: Mapping[str, ObjectModel]) -> Policy | PrivilegedPolicy:
    """A policy by name.

    Args:
        name: as for ``policy_files``.

    Raises:
        FungraspError: no such policy, or one for another hand.
    """
    path = policy_files(name, hand.name).network
    return OpenLoopPolicy() if path is None else residual_policy(load_policy(path), hand, objects)
