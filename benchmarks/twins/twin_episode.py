"""One grasp on one twin, kept on disk as soon as it is finished."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from fungrasp.core.jobs import PartStore, part_key
from fungrasp.deployment.deploy import DeploymentTask, deploy_on_twin
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import UnreachableError, reachable_placements
from fungrasp.deployment.spec import DeploymentSpec, Phase
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import ConstrainedPlanner, Planner
from fungrasp.planning.selection.search import Feasible
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import RobotCommand, RobotState
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.devices import TwinHand
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.twin_model import TwinPhysics
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.sim2real.joint_dynamics import HandDynamics
from fungrasp.task import Belief, GraspPlan, Policy

OutcomeT = TypeVar("OutcomeT")

MOST_PLACEMENTS = 3
"""Places where the object is put before a grasp counts as one that the robot can't reach."""


@dataclass(frozen=True)
class TwinVariant:
    """A way to deploy."""

    name: str
    """Name in results."""
    compensate: bool = True
    """Whether the hand's weight is carried."""
    identified: bool = True
    """Whether planner and robot know the identified dynamics of the hand."""
    attempts: int = 1
    """Most attempts of the robot at the object (``DeploymentSpec.attempts``)."""


@dataclass(frozen=True)
class TwinEpisode:
    """One grasp on one twin."""

    index: int
    """Row of the grasp in its file."""
    object: str
    """Name of the object."""
    twin: int
    """Which twin."""
    variant: str
    """How it was deployed."""
    success: bool
    """Whether the object was lifted and held."""
    height_m: float
    """Least height during the hold [m]; -1 where there was none."""
    fault: str
    """Why the robot stopped, "" if it did not."""
    tracking_rad: float
    """RMS error of the hand's joints before the fingers close [rad]; -1 where the motion did not begin."""
    sag_rad: float
    """Largest mean error of a joint over the same time [rad]; -1 where the motion did not begin."""
    placements: int = 0
    """Placements of the object; of all but the last the robot said that it can't reach the grasp."""
    attempts: int = 0
    """Attempts of the robot at the object."""
    held_as_shown: bool = False
    """Whether it was held where and how the person held it."""


@dataclass(frozen=True, eq=False)
class PlacedGrasp:
    """A grasp, and where a person would put the object so that the arm can reach it."""

    number: int
    """Row of the grasp in its file."""
    grasp: RobotGraspSet
    """One grasp."""
    placements: np.ndarray
    """Where the object is put, and where next if the robot says that it can't reach it there, world frame,
    shape [P, 7]; it settles. Empty if the arm can't reach the grasp from any placement that was tried."""


class RememberingPlanner:
    """Plans of one grasp: variants that know the same are planned once."""

    def __init__(self, planner: Planner):
        """planner: that plans what is not remembered."""
        self._planner = planner
        self._plans: dict[tuple[int, bytes], GraspPlan] = {}

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        return self._remembered(belief, seed, lambda: self._planner.plan(grasps, belief, seed, progress))

    def plan_within(
        self, grasps: RobotGraspSet, belief: Belief, feasible: Feasible, seed: int = 0
    ) -> GraspPlan:
        """See ``ConstrainedPlanner.plan_within``: what is feasible is the same in all variants."""
        planner = self._planner
        if not isinstance(planner, ConstrainedPlanner):
            return self.plan(grasps, belief, seed)
        return self._remembered(belief, seed, lambda: planner.plan_within(grasps, belief, feasible, seed))

    def _remembered(self, belief: Belief, seed: int, make: Callable[[], GraspPlan]) -> GraspPlan:
        key = seed, pickle.dumps(belief)
        if key not in self._plans:
            self._plans[key] = make()
        return self._plans[key]


@dataclass(frozen=True, eq=False)
class TwinSetup:
    """What all episodes of a test share, and what was kept of them."""

    objects: Mapping[str, ObjectModel]
    """By name."""
    hand: Hand
    """On the arm."""
    cell: RobotCell
    """The robot."""
    policy: Policy
    """What acts."""
    planner: Planner
    """Of the policy."""
    store: PartStore | None = None
    """Keeps what is finished, and knows what an earlier run has finished; None to keep nothing."""
    policy_key: str = ""
    """Tells policies and planners apart in the store."""

    def place(self, number: int, grasp: RobotGraspSet) -> PlacedGrasp:
        """A grasp, of that number in its file, with placements of the object from which the arm can reach
        it."""
        obj = self.objects[grasp.object_name[0]]

        def find() -> dict[str, np.ndarray]:
            try:
                some = islice(reachable_placements(self.cell, self.hand, obj, grasp), MOST_PLACEMENTS)
                return {"placements": np.array(list(some)).reshape(-1, 7)}
            except UnreachableError:
                return {"placements": np.zeros((0, 7))}

        found = self._kept("placements", grasp, find, MOST_PLACEMENTS)
        return PlacedGrasp(number, grasp, found["placements"])

    def identified(self, truth: TwinParameters, fit: Callable[[], HandDynamics]) -> HandDynamics:
        """What identification says of a twin's hand. fit: identifies it, where no earlier run has."""
        return HandDynamics(**self._kept("dynamics", None, lambda: vars(fit()), asdict(truth)))

    def run(
        self,
        placed: PlacedGrasp,
        twin: int,
        truth: TwinParameters,
        variant: TwinVariant,
        dynamics: HandDynamics | None,
        planner: RememberingPlanner,
    ) -> TwinEpisode:
        """Deploy one grasp on one twin. dynamics: what is known of the hand; the model's if None."""
        obj = self.objects[placed.grasp.object_name[0]]

        spec = DeploymentSpec(
            attempts=variant.attempts,
            until="lift",
            gravity_compensation=variant.compensate,
            look_time=0.4,
        )
        task = DeploymentTask(spec, self.cell, self.hand, obj, placed.grasp, self.policy, planner, dynamics)

        errors = FingerErrors()

        def deploy_at(where: np.ndarray) -> DeploymentResult:
            return deploy_on_twin(task, where, truth, observers=[errors], advise=False)

        def deploy() -> dict[str, np.ndarray]:
            outcome, count, said = deploy_where_reached(placed.placements, deploy_at)
            return (
                _refused(said[:80], count)
                if outcome is None
                else _measured(outcome, *errors.before_closing(outcome), count)
            )

        found = self._kept(
            "episode",
            placed.grasp,
            deploy,
            placed.placements,
            asdict(truth),
            {} if dynamics is None else vars(dynamics),
            variant.compensate,
            variant.attempts,
            TwinPhysics(),
            self.policy_key,
        )
        values = {name: value.item() for name, value in found.items()}
        return TwinEpisode(placed.number, obj.name, twin, variant.name, **values)

    def _kept(
        self,
        what: str,
        grasp: RobotGraspSet | None,
        make: Callable[[], dict[str, np.ndarray]],
        *besides: Any,
    ) -> dict[str, np.ndarray]:
        """Arrays that were kept, or are made and kept. besides: what they depend on beside cell, hand and
        grasp."""
        if self.store is None:
            return make()
        held = None if grasp is None else (grasp, self.objects[grasp.object_name[0]])
        return self.store.kept(part_key(what, self.cell, self.hand, held, *besides), make)


class FingerErrors(DeploymentObserver):
    """Keeps by how much the fingers of a twin's hand miss their setpoints during the grasp."""

    def __init__(self) -> None:
        self._world: TwinWorld | None = None
        self._errors: list[tuple[float, np.ndarray]] = []

    def connected(self, robot: Robot) -> None:
        assert isinstance(robot.hand_driver, TwinHand)
        self._world, self._errors = robot.hand_driver.world, []

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        if phase is Phase.GRASP and self._world is not None:
            self._errors.append((self._world.time, self._world.finger_positions() - command.hand))

    def before_closing(self, result: DeploymentResult) -> tuple[float, float]:
        """Before the fingers close: RMS of their errors, and the largest mean of a joint's [rad]; nan if the
        motion did not begin."""
        if not self._errors or result.prepared is None or Phase.GRASP not in result.times:
            return np.nan, np.nan
        plan = result.prepared.plan
        closing = result.times[Phase.GRASP] + float(plan.closing_step[0]) * plan.control_period
        before = np.array([error for time, error in self._errors if time < closing])
        if not len(before):
            return np.nan, np.nan
        return float(np.sqrt(np.mean(before**2))), float(np.abs(before.mean(axis=0)).max())


def _measured(
    outcome: DeploymentResult, tracking: float, sag: float, placements: int
) -> dict[str, np.ndarray]:
    """What was measured in an episode, by the names of ``TwinEpisode``."""
    values = {"height_m": outcome.height, "tracking_rad": tracking, "sag_rad": sag}
    return {
        "success": np.asarray(outcome.success),
        "held_as_shown": np.asarray(bool(outcome.held_as_shown)),
        "fault": np.asarray(outcome.fault),
        "placements": np.asarray(placements),
        "attempts": np.asarray(outcome.attempts),
        **{name: np.asarray(value if np.isfinite(value) else -1.0) for name, value in values.items()},
    }


def _refused(why: str, placements: int) -> dict[str, np.ndarray]:
    """The same of an episode in which nothing moved."""
    values = {"success": False, "fault": why, "placements": placements, "attempts": 0}
    values |= {"height_m": -1.0, "tracking_rad": -1.0, "sag_rad": -1.0}
    return {name: np.asarray(value) for name, value in values.items()}


def deploy_where_reached(
    placements: Iterable[np.ndarray], deploy: Callable[[np.ndarray], OutcomeT]
) -> tuple[OutcomeT | None, int, str]:
    """Deploy with the object at a placement, and elsewhere where the robot says that it can't reach it, as a
    person would do: at ``MOST_PLACEMENTS`` at most.

    Args:
        placements: of the object, world frame, each of shape [7]; looking for them may fail as well.
        deploy: with the object there; raises ``UnreachableError`` before anything moves.

    Returns:
        what came of it, None if all were refused; number of placements; and why the last was refused, "" if
        none was.
    """
    count, said, left = 0, "", iter(placements)
    while count < MOST_PLACEMENTS:
        try:
            where = next(left, None)
            if where is None:
                break
            count += 1
            return deploy(where), count, said
        except UnreachableError as error:
            said = str(error)
    return None, count, said
