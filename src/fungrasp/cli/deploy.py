"""``fungrasp deploy``: grasp an object with a robot or its simulated twin."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import Answering, CommandResult, suggestion
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import check_suffix
from fungrasp.deployment.spec import DeploymentSpec, GraspChoice

if TYPE_CHECKING:
    from collections.abc import Callable

    from fungrasp.deployment.observer import DeploymentObserver
    from fungrasp.deployment.preparation import PreparedGrasp
    from fungrasp.deployment.spec import Phase
    from fungrasp.robots.robot import Robot
    from fungrasp.robots.stop_switch import StopSwitch


NOT_LIFTED = 4
"""Exit status if the run finished but the twin's object was not lifted and held."""


@dataclass(frozen=True)
class Deploy(Answering):
    """Grasp an object with a robot: look, plan, move to the start, grasp, lift, hold, put down, go home.

    Exit status 4: on a twin, the object was not lifted and held.
    """

    spec: DeploymentSpec = field(default_factory=DeploymentSpec)
    """Settings of the deployment."""
    hand: str = ""
    """Expected hand of the robot; another hand is an error. Empty: no check."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp."""
    picture: Path | None = None
    """Before the robot moves, simulate the motion, check every setpoint with the safety filter, and draw the
    motion to this file (.png)."""
    yes: bool = False
    """Do not ask before each phase on a real robot."""
    log: Path | None = None
    """MCAP file to write; must not exist. Default: deploy-<time>.mcap."""
    fast: bool = False
    """For a twin: run as fast as possible instead of in real time."""

    def run(self) -> CommandResult:
        from time import strftime

        from fungrasp.deployment.deploy import deploy
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import is_wired, load_cell
        from fungrasp.robots.stop_switch import StopSwitch

        cell = load_cell(self.spec.cell)
        hand = load_hand(cell.hand)
        if self.hand and load_hand(self.hand).name != hand.name:
            raise FungraspError(f"robot cell '{cell.name}' carries the hand '{hand.name}', not '{self.hand}'")
        if self.picture is not None:
            check_suffix(self.picture, "--picture", ".png")
        log = self.log or Path(strftime("deploy-%Y%m%d-%H%M%S.mcap"))
        choice, picture = self.choice, self.picture
        spec = replace(self.spec, real_time=not self.fast, threads=choice.threads, about=choice.words)
        with StopSwitch(cell.stop_file, keyboard=True) as switch:
            asks = is_wired(cell) and not self.yes
            if asks and not switch.keyboard:
                raise FungraspError("deploy asks before each phase: run it in a terminal, or give --yes")
            grasp, objects = choice.robot(hand, spec.seed)

            def draw(robot: Robot, prepared: PreparedGrasp) -> None:
                from fungrasp.deployment.rehearsal import rehearse
                from fungrasp.media.plan_picture import write_plan_picture

                assert picture is not None
                motion = rehearse(robot, grasp, prepared)
                obj = objects[str(grasp.object_name[0])]
                write_plan_picture(picture, motion, cell, hand, obj, choice.threads)
                print(f"look at: {picture}", flush=True)

            terminal = _terminal(switch, asks, None if picture is None else draw)
            result = deploy(grasp, objects, spec=spec, log=log, observer=terminal, switch=switch)
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
            "held_as_shown": result.held_as_shown,
            "times": result.times,
        }
        if result.fault:
            return CommandResult(value, "\n".join(lines), fault=result.words())
        if result.success is not False:
            return CommandResult(value, "\n".join([*lines, result.words()]))
        reached = isfinite(result.height)
        why = f"at {100 * result.height:.1f} cm in the hold" if reached else "no hold was reached"
        return CommandResult(value, "\n".join([*lines, f"{result.words()}: {why}"]), status=NOT_LIFTED)


def _terminal(
    switch: StopSwitch, asks: bool, draw: Callable[[Robot, PreparedGrasp], None] | None
) -> DeploymentObserver:
    """Return an observer that prints the phases and how to stop.

    Args:
        asks: whether to ask before each phase.
        draw: function to call with the first plan.
    """
    from fungrasp.deployment.observer import PhaseQuestions

    class Terminal(PhaseQuestions):
        drawn = draw is None

        def connected(self, robot: Robot) -> None:
            print(f"to stop: {switch.ways or 'Ctrl-C'}", flush=True)

        def planned(self, robot: Robot, prepared: PreparedGrasp) -> None:
            if draw is not None and not self.drawn:
                self.drawn = True
                draw(robot, prepared)

        def confirm(self, phase: Phase, meanwhile: Callable[[], None]) -> None:
            if asks:
                super().confirm(phase, meanwhile)

        def phase(self, time: float, phase: Phase) -> None:
            print(phase, flush=True)

        def fault(self, time: float, reason: str) -> None:
            print(f"fault: {reason}", flush=True)

    return Terminal(switch)


COMMAND = Deploy
