"""Policies by name, each with the planner whose plans it follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner, MotionSettings, Planner
from fungrasp.planning.selection import SearchPlanner, SelectionSettings
from fungrasp.policies.checkpoint.checkpoint_file import SUFFIX, list_policies, load_policy, read_card
from fungrasp.policies.open_loop import OpenLoopPolicy
from fungrasp.policies.residual_policy import NetworkPredictor, check_card, residual_policy
from fungrasp.task import LiftProtocol, Policy, PrivilegedPolicy

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


def make_planner(
    name: str,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    settings: SelectionSettings | None = None,
    protocol: LiftProtocol | None = None,
    threads: int = 0,
    motions: MotionSettings | None = None,
) -> Planner:
    """The planner whose plans a policy follows.

    Args:
        name: of the policy, as for ``policy_files``.
        settings: of the selection among candidates; the defaults if None.
        protocol: of the motions; the published one if None.
        threads: 0 means all processors. Plans do not depend on it.
        motions: how grasps are adapted, approached, closed and lifted; the defaults if None.

    Raises:
        FungraspError: no such policy, or one for another hand.
    """
    # The student's own plans, selected by rollouts of the student, are what "plan" plays open loop.
    files = policy_files("student" if name == PLAN else name, hand.name)
    if files.predictor is None:
        return MotionPlanner(hand, objects, motions, protocol)
    predictor = NetworkPredictor(load_policy(files.predictor), hand, objects)
    policy: Policy = OpenLoopPolicy()
    if files.network is not None:
        check_card(read_card(files.network), hand)
        made = residual_policy(load_policy(files.network), hand, objects)
        policy = made  # pyright: ignore[reportAssignmentType]
    digest = files.digests()[0]
    return SearchPlanner(hand, objects, predictor, policy, digest, settings, protocol, threads, motions)


def check_attempts(attempts: int, watches: bool) -> None:
    """Complain about a number of attempts that can't be.

    Args:
        attempts: of an episode, at most.
        watches: whether the policy acts on what it sees.

    Raises:
        FungraspError: none, or several of a policy that plays a plan blindly.
    """
    if attempts < 1:
        raise FungraspError(f"there must be 1 attempt or more, not {attempts}")
    if attempts > 1 and not watches:
        raise FungraspError(
            "a plan that is played blindly can't be tried again, as nothing says that it failed: take "
            "--policy student, or --attempts 1"
        )
