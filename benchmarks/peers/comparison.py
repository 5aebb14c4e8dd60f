"""Retargeting methods of this package and of others side by side: same grasps, same hand, same judge."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from benchmarks.peers.mink_solver import solve_mink
from benchmarks.peers.position_solvers import solve_dex_retargeting, solve_dexi
from benchmarks.peers.problem import CpuClock, PeerProblem
from fungrasp.evaluation import LiftTestResult, evaluate
from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionSettings, make_planner
from fungrasp.retargeting import METHODS, retarget

Solve = Callable[[PeerProblem], tuple[RobotGraspSet, float]]

PEERS: Mapping[str, tuple[str, Solve]] = {
    "dex-retargeting": ("dex_retargeting", solve_dex_retargeting),
    "dexi-rs": ("dexi_rs", solve_dexi),
    "mink": ("mink", solve_mink),
}
"""Module that must be installed, and how the peer solves. pyroki is not on PyPI, and has no entry."""

ROUNDS = 3
"""Rounds of this package's methods, of which the fastest counts, as other processes disturb short ones."""


@dataclass(frozen=True)
class MethodResult:
    """One method's grasps."""

    robot: RobotGraspSet
    """The grasps."""
    cpu_seconds: float
    """Processor time of the solving alone, one thread: no imports, compiling or reading of files."""
    quality: StaticQuality
    """By the judge for all methods."""
    adapted: LiftTestResult | None = None
    """Lift test by the reference controller; the planner fits each grasp to the settled object."""
    as_given: LiftTestResult | None = None
    """The same without that."""

    @property
    def grasps_per_cpu_second(self) -> float:
        """Speed."""
        return len(self.robot) / self.cpu_seconds


def installed_peers() -> list[str]:
    """Names of the peers whose packages are there."""
    return [name for name, (module, _) in PEERS.items() if find_spec(module) is not None]


def compare_method(
    name: str,
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    lift: bool = False,
    threads: int = 0,
) -> MethodResult:
    """Solve and judge by one method.

    Args:
        name: of ``fungrasp.retargeting.METHODS`` or ``PEERS``.
        human: the grasps.
        objects: by name.
        hand: the robot hand.
        lift: lift the objects too, with and without adaptation.
        threads: of the lift test.
    """
    for model in objects.values():
        _ = model.signed_distance
    if name in METHODS:
        robot, seconds = _own(name, human, objects, hand)
    else:
        robot, seconds = PEERS[name][1](PeerProblem.of(human, objects, hand))
    quality = static_quality(robot, human, objects, hand)
    if not lift:
        return MethodResult(robot, seconds, quality)
    lifted = [
        evaluate(
            robot,
            objects,
            hand=hand,
            planner=make_planner("reference", hand, objects, motions=motions, threads=threads),
            threads=threads,
        )
        for motions in (None, MotionSettings(adapt=None))
    ]
    return MethodResult(robot, seconds, quality, *lifted)


def _own(
    name: str, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
) -> tuple[RobotGraspSet, float]:
    robot = retarget(human, objects, hand, name, threads=1)
    seconds = []
    for _ in range(ROUNDS):
        with CpuClock() as clock:
            robot = retarget(human, objects, hand, name, threads=1)
        seconds.append(clock.seconds)
    return robot, min(seconds)
