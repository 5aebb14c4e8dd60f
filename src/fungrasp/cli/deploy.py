"""``fungrasp deploy``: one grasp on a robot, or on its twin."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fungrasp.cli.grasp_choice import GraspChoice, deployment_task

if TYPE_CHECKING:
    from fungrasp.deployment.deployment import DeploymentResult
    from fungrasp.deployment.emergency_stop import StopSwitch
    from fungrasp.deployment.log import DeploymentLog
    from fungrasp.deployment.wired_deployment import DeploymentTask


@dataclass(frozen=True)
class Deploy:
    """Grasp an object with a robot: look, plan, move to the start, grasp, lift, hold, put down, go home."""

    robot: str = "ur5e-allegro"
    """A robot cell: one that comes with the package (`fungrasp robots list`), or a TOML file."""
    hand: str = ""
    """The hand that you expect on the robot; another one is refused. Empty: whatever the cell says."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference" (planned motions, open loop), "student", or a policy file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); by default those that the cell names."""
    dry_run: bool = False
    """Read everything, decide everything, log everything, and send nothing."""
    no_gravity_compensation: bool = False
    """Let the hand sag under its own weight."""
    stay: bool = False
    """End after the hold, with the object held: it is not put down."""
    attempts: int = 1
    """Most attempts. A policy that watches (a student) sees that the object is not held: the hand withdraws,
    looks where the object lies, plans anew and tries again."""
    log: Path | None = None
    """MCAP file to write; it must not exist. By default deploy-<time>.mcap."""
    seed: int = 0
    """Seed of the plan."""
    twin: int = 0
    """For a twin: which one, 0, 1, 2 ... Its true parameters are hidden."""
    fast: bool = False
    """For a twin: run as fast as the machine goes, not on the clock of the wall."""

    def run(self) -> None:
        from contextlib import ExitStack
        from time import strftime

        from fungrasp.deployment.emergency_stop import StopSwitch
        from fungrasp.deployment.log import McapLog
        from fungrasp.errors import FungraspError
        from fungrasp.hands import load_hand
        from fungrasp.policies import OpenLoopPolicy, check_attempts
        from fungrasp.robots.assembly import is_twin
        from fungrasp.robots.cell import check_calibrated, load_cell

        cell = load_cell(self.robot)
        if not is_twin(cell):
            check_calibrated(cell)
        hand = load_hand(cell.hand)
        if self.hand and load_hand(self.hand).name != hand.name:
            raise FungraspError(f"robot cell '{cell.name}' carries the hand '{hand.name}', not '{self.hand}'")
        chosen = self.choice.chosen(hand, self.seed)
        task = deployment_task(
            cell,
            hand,
            chosen,
            self.policy,
            self.choice.threads,
            hand_dynamics=self.hand_dynamics,
            compensate=not self.no_gravity_compensation,
            dry_run=self.dry_run,
            seed=self.seed,
        )
        check_attempts(self.attempts, not isinstance(task.policy, OpenLoopPolicy))
        with ExitStack() as stack:
            log = stack.enter_context(McapLog(self.log or Path(strftime("deploy-%Y%m%d-%H%M%S.mcap"))))
            switch = stack.enter_context(StopSwitch(cell.stop_file, keyboard=True))
            run = self._on_twin if is_twin(cell) else self._on_robot
            success, result = run(task, log, switch)
        print(f"10 Hz: {result.ticks.summary()}")
        print(f"50 Hz: {result.setpoints.summary()}")
        print(f"log: {log.path}")
        if result.fault:
            raise FungraspError(f"fault: {result.fault}")
        print(success)

    def _on_twin(
        self, task: DeploymentTask, log: DeploymentLog, switch: StopSwitch
    ) -> tuple[str, DeploymentResult]:
        from fungrasp.deployment.deployment import DeploymentSettings
        from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
        from fungrasp.robots.twin.parameters import cell_twin

        cell, hand = task.cell, task.hand
        outcome = deploy_on_twin(
            cell,
            hand,
            task.thing,
            task.grasp,
            reachable_placement(cell, hand, task.thing, task.grasp, self.seed),
            task.policy,
            task.planner,
            cell_twin(cell, hand, self.twin),
            wall_clock=not self.fast,
            dynamics=task.dynamics,
            compensate=task.compensate,
            dry_run=self.dry_run,
            seed=self.seed,
            log=log,
            switch=switch,
            settings=DeploymentSettings(put_down=not self.stay, attempts=self.attempts),
            about=self._about(),
            on_phase=lambda phase: print(phase, flush=True),
        )
        if outcome.success and outcome.result.attempts > 1:
            print(f"by attempt {outcome.result.attempts}")
        if outcome.success:
            return f"lifted and held at {100 * outcome.height:.1f} cm (twin {self.twin})", outcome.result
        return f"not lifted (twin {self.twin})" + _why_no_more(outcome.result), outcome.result

    def _on_robot(
        self, task: DeploymentTask, log: DeploymentLog, switch: StopSwitch
    ) -> tuple[str, DeploymentResult]:
        from fungrasp.deployment.deployment import DeploymentSettings
        from fungrasp.deployment.wired_deployment import deploy_on_robot

        result = deploy_on_robot(
            task,
            log=log,
            switch=switch,
            settings=DeploymentSettings(put_down=not self.stay, attempts=self.attempts),
            about=self._about(),
            on_phase=lambda phase: print(phase, flush=True),
            on_connect=lambda robot: print("press Enter to stop", flush=True),
        )
        said = f"not held, as far as is seen, after {result.attempts} attempts" if result.missed else "done"
        return said + _why_no_more(result), result

    def _about(self) -> dict[str, str]:
        from fungrasp.version import __version__

        grasp = self.choice.grasp if self.choice.image is None else f"image {self.choice.image}"
        return {"version": __version__, "robot": self.robot, "policy": self.policy, "grasp": grasp}


@dataclass(frozen=True)
class ReplayLog:
    """Show the observations of a log to a policy again: it must act as it did."""

    log: Annotated[Path, tyro.conf.Positional]
    """An MCAP file of `fungrasp deploy`."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    policy: str = ""
    """Another policy than the one that is named in the log."""

    def run(self) -> None:
        from fungrasp.deployment.log import read_log
        from fungrasp.deployment.replay import replay_log
        from fungrasp.errors import FungraspError
        from fungrasp.hands import load_hand
        from fungrasp.objects import load_object
        from fungrasp.policies import make_policy
        from fungrasp.task import Policy

        log = read_log(self.log)
        if log.plan is None:
            raise FungraspError(f"{self.log} ends before a plan was made: nothing to replay")
        name, mass = str(log.plan.object_name[0]), float(log.plan.object_mass[0])
        objects = {name: load_object(name, mass, self.objects)}
        policy = make_policy(self.policy or log.about["policy"], load_hand(log.plan.hand), objects)
        if not isinstance(policy, Policy):
            raise FungraspError("this policy needs what only a simulation knows")
        result = replay_log(log, policy)
        if result.different:
            raise FungraspError(
                f"{result.different} of {result.steps} actions differ, by {result.largest:.3g} at most"
            )
        print(f"{result.steps} actions, all the same")


COMMAND = Deploy


def _why_no_more(result: DeploymentResult) -> str:
    """Why no further attempt was made, for the end of a line."""
    return f"; no further attempt: {result.why_no_more}" if result.why_no_more else ""
