"""``fungrasp deploy``: one grasp on a robot, or on its twin; planned, looked at and carried out."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fungrasp.cli.console import Answer, Answering, suggestion
from fungrasp.deployment.grasp_choice import GraspChoice

if TYPE_CHECKING:
    from collections.abc import Callable

    from fungrasp.deployment.deployment import Confirm
    from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSpec
    from fungrasp.hands import Hand
    from fungrasp.robots.stop_switch import StopSwitch

OF_EXECUTION = ("execute", "until", "speed", "yes", "log", "fast", "json")
"""Options that go with ``--execute``; all else is in the plan."""


@dataclass(frozen=True)
class Deploy(Answering):
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
    save_plan: Path | None = None
    """Look, plan the whole way there and back, write it to this file (.npz) with a picture (.png) and a film
    (.mp4) beside it, and send nothing."""
    execute: Path | None = None
    """Carry out such a file, exactly, asking on the terminal before each phase. Refused if the cell, the
    hand, the object, the policy or the file itself is not as it was, or the object lies elsewhere."""
    until: Literal["approach", "grasp", "lift", "put-down", "home"] = "home"
    """Where to end: at the start of the grasp ("approach"), with closed fingers ("grasp"), with the object
    held up ("lift"), after it was put down, or at home."""
    speed: float = 1.0
    """Share of the cell's speed, 0.02 to 1: slow motion. Not for policies that watch (a student)."""
    yes: bool = False
    """Do not ask before each phase of --execute, or of a real robot."""
    dry_run: bool = False
    """Read everything, decide everything, log everything, and send nothing."""
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

    def run(self) -> Answer:
        if self.execute is not None:
            return self._execute(self.execute)
        if self.save_plan is not None:
            return self._plan(self.save_plan)
        return self._deploy()

    def _deploy(self) -> Answer:
        from fungrasp.deployment.deploy import deploy
        from fungrasp.robots.cell import is_wired, load_cell

        spec, hand = self._spec()
        cell, log = load_cell(self.robot), self._log()
        with _listening(cell.stop_file) as switch:
            confirm = self._confirm(switch) if is_wired(cell) and not self.dry_run else None
            grasp, objects = self.choice.robot(hand, self.seed)
            result = deploy(
                grasp,
                objects,
                spec=spec,
                log=log,
                about={"grasp": self.choice.words},
                switch=switch,
                threads=self.choice.threads,
                on_phase=_say,
                on_connect=_say_how_to_stop(switch),
                confirm=confirm,
            )
        return self._report(result, log)

    def _plan(self, path: Path) -> Answer:
        from fungrasp.core.errors import FungraspError
        from fungrasp.deployment.plan_ahead import plan_ahead
        from fungrasp.media.plan_pictures import write_plan_pictures
        from fungrasp.robots.cell import load_cell

        if path.suffix != ".npz":
            raise FungraspError(f"{path}: a plan is written to a file that ends in .npz")
        spec, hand = self._spec()
        grasp, objects = self.choice.robot(hand, self.seed)
        thing, cell = objects[str(grasp.object_name[0])], load_cell(self.robot)
        source = self.choice.source(thing)
        with _listening(cell.stop_file) as switch:
            saved = plan_ahead(
                grasp,
                objects,
                source,
                spec,
                about=self.choice.words,
                switch=switch,
                threads=self.choice.threads,
            )
        saved.save(path)
        print(f"plan: {path}: {saved.words()}", flush=True)
        picture, film = write_plan_pictures(path, saved, cell, hand, thing, self.choice.threads)
        text = (
            f"picture: {picture}\nfilm: {film}\nto carry it out: fungrasp deploy --execute {path} --speed 0.1"
        )
        return Answer({"plan": path, "picture": picture, "film": film}, text)

    def _execute(self, path: Path) -> Answer:
        from fungrasp.core.errors import FungraspError
        from fungrasp.deployment.plan_ahead import execute_plan
        from fungrasp.deployment.saved_plan import load_plan
        from fungrasp.robots.cell import load_cell

        usual = Deploy()
        for f in fields(self):
            if f.name not in OF_EXECUTION and getattr(self, f.name) != getattr(usual, f.name):
                name = "the grasp" if f.name == "choice" else f"--{f.name.replace('_', '-')}"
                raise FungraspError(f"--execute takes everything from the plan: leave out {name}")
        saved, log = load_plan(path), self._log()
        with _listening(load_cell(saved.origin.spec.cell).stop_file) as switch:
            confirm = self._confirm(switch)
            result = execute_plan(
                saved,
                until=self.until,
                speed=self.speed,
                real_time=not self.fast,
                log=log,
                switch=switch,
                on_phase=_say,
                on_connect=_say_how_to_stop(switch),
                confirm=confirm,
            )
        return self._report(result, log)

    def _confirm(self, switch: StopSwitch) -> Confirm | None:
        """Asks before each phase; None if nobody wants to be asked."""
        from fungrasp.core.errors import FungraspError
        from fungrasp.deployment.confirmation import ask_before_phases

        if self.yes:
            return None
        if not switch.keyboard:
            raise FungraspError("this asks before each phase: it needs a terminal, or --yes")
        return ask_before_phases(switch)

    def _spec(self) -> tuple[DeploymentSpec, Hand]:
        """What is asked, and the hand of the cell."""
        from fungrasp.core.errors import FungraspError
        from fungrasp.deployment.deployment_result import DeploymentSpec
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell

        cell = load_cell(self.robot)
        hand = load_hand(cell.hand)
        if self.hand and load_hand(self.hand).name != hand.name:
            raise FungraspError(f"robot cell '{cell.name}' carries the hand '{hand.name}', not '{self.hand}'")
        spec = DeploymentSpec(
            self.robot,
            self.policy,
            attempts=self.attempts,
            until=self.until,
            speed=self.speed,
            dry_run=self.dry_run,
            hand_dynamics=str(self.hand_dynamics or ""),
            seed=self.seed,
            twin=self.twin,
            real_time=not self.fast,
        )
        return spec, hand

    def _log(self) -> Path:
        from time import strftime

        return self.log or Path(strftime("deploy-%Y%m%d-%H%M%S.mcap"))

    def _report(self, result: DeploymentResult, log: Path) -> Answer:
        lines = [
            f"10 Hz: {result.ticks.summary()}",
            f"50 Hz: {result.setpoints.summary()}",
            f"log: {log}",
            suggestion("view", log),
        ]
        value = {
            "log": log,
            "phase": result.phase.name,
            "fault": result.fault,
            "attempts": result.attempts,
            "success": result.success,
            "height": result.height,
            "times": result.times,
        }
        if result.fault:
            return Answer(value, "\n".join(lines), fault=result.words())
        return Answer(value, "\n".join([*lines, result.words()]))


def _listening(stop_file: str) -> StopSwitch:
    from fungrasp.robots.stop_switch import StopSwitch

    return StopSwitch(stop_file, keyboard=True)


def _say(phase: str) -> None:
    print(phase, flush=True)


def _say_how_to_stop(switch: StopSwitch) -> Callable[[], None]:
    return lambda: print(f"to stop: {switch.ways or 'Ctrl-C'}", flush=True)


COMMAND = Deploy
