"""Slow motion, ends before the end, and a question before each phase."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from robot_cells import Told, cell_and_hand, deploy, near_cell

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.observer import DeploymentObserver, PhaseQuestions
from fungrasp.deployment.spec import Phase
from fungrasp.robots.device import RobotCommand, RobotState, SafetyStop, StopKind
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp.robots.kinematics.joint_path import timed_leg
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinHand

pytest.importorskip("mink")


class Kept(DeploymentObserver):
    """Keeps setpoints."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, float, np.ndarray, np.ndarray]] = []

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        self.rows.append((phase, state.time, command.palm, command.arm))

    def of(self, *phases: Phase) -> tuple[np.ndarray, np.ndarray]:
        """Times, shape [T], and places of the palm, shape [T, 3]."""
        rows = [row for row in self.rows if row[0] in phases]
        return np.array([row[1] for row in rows]), np.array([row[2][:3] for row in rows])


def test_slow_motion_is_the_same_way_at_the_same_rate_of_setpoints() -> None:
    usual, slow = Kept(), Kept()
    assert deploy(usual).success
    outcome = deploy(slow, speed=0.4)
    assert outcome.success, outcome.fault
    (t, p), (u, q) = (kept.of(Phase.GRASP) for kept in (usual, slow))
    assert np.diff(u) == pytest.approx(0.02, abs=0.003)
    assert (u[-1] - u[0]) / (t[-1] - t[0]) == pytest.approx(1 / 0.385, rel=0.02)
    fastest = [np.linalg.norm(np.diff(way, axis=0), axis=1).max() / 0.02 for way in (p, q)]
    assert fastest[1] < 0.42 * fastest[0]
    assert max(np.linalg.norm(p - place, axis=1).min() for place in q[::20]) < 2e-3


def test_a_hand_that_falls_silent_is_noticed_as_soon_in_slow_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    read = TwinHand.read

    def failing(self: Any) -> Any:
        if self.world.time > 3.0 and self.name.startswith("twin"):
            self.frozen = True
        return read(self)

    monkeypatch.setattr(TwinHand, "read", failing)
    result = deploy(speed=0.1)
    assert "the hand has been silent" in result.fault
    assert result.times["fault"] - 3.0 < cell_and_hand()[0].watchdog.hand_silence + 0.05


def test_ways_of_joints_are_slowed_down_too() -> None:
    cell, hand = cell_and_hand()
    home = np.array(cell.arm.home)
    usual, slow = (
        timed_leg(home, home + 0.3, ArmKinematics(cell, hand), cell.limits, 0.02, s) for s in (1.0, 0.1)
    )
    assert len(slow) == 10 * len(usual)
    np.testing.assert_allclose(slow[9::10], usual)


@pytest.mark.parametrize("speed", [0.0, -1.0, 1.5])
def test_other_speeds_are_refused(speed: float) -> None:
    with pytest.raises(FungraspError, match="share of the plan's"):
        deploy(speed=speed)


ENDS = {
    "plan": [],
    "approach": ["move to start"],
    "grasp": ["move to start", "grasp"],
    "put-down": ["move to start", "grasp", "lift", "hold", "put down"],
}


@pytest.mark.parametrize("until", ENDS)
def test_it_ends_where_it_is_told_to(until: Any) -> None:
    worlds: list[Any] = []
    result = deploy(until=until, spoil=worlds.append)
    world = worlds[0]
    assert result.phase is Phase.DONE and not result.fault
    assert [name for name in result.times if name != "idle"] == ENDS[until]
    if until in ("plan", "approach"):
        # The near cell's arm stands at the start already.
        assert np.abs(world.arm_state()[0] - near_cell().arm.home).max() < 0.02
    if until == "grasp":
        assert not result.success
        before = world.center_of_mass()[2]
        world.advance(world.time + 1.0)
        assert abs(world.center_of_mass()[2] - before) < 0.005


class Asked(DeploymentObserver):
    """Answers after some seconds, yes unless a phase is named."""

    def __init__(self, no: Phase | None = None, seconds: float = 1.0):
        self.no, self.seconds = no, seconds
        self.phases: list[Phase] = []

    def confirm(self, phase: Phase, meanwhile: Callable[[], None]) -> None:
        self.phases.append(phase)
        for _ in range(round(self.seconds / 0.02)):
            meanwhile()
        if phase is self.no:
            raise SafetyStop("not confirmed", StopKind.HOLD)


def test_each_phase_is_asked_for_and_the_plan_waits() -> None:
    asked, kept = Asked(), Kept()
    outcome = deploy(asked, kept, until="home")
    assert outcome.success and not outcome.fault
    motions = [Phase.MOVE_TO_START, Phase.GRASP, Phase.LIFT, Phase.PUT_DOWN, Phase.HOME]
    assert asked.phases == motions
    # Setpoints go on meanwhile, in place: nothing is silent, and the hand keeps its grip.
    times = np.array([row[1] for row in kept.rows if row[0] == Phase.GRASP])
    assert np.diff(times).max() < 0.05
    still = np.array([row[3] for row in kept.rows if row[0] == Phase.GRASP])[-50:-5]
    assert np.ptp(still, axis=0).max() < 1e-9


@pytest.mark.parametrize("no", [Phase.MOVE_TO_START, Phase.GRASP, Phase.LIFT])
def test_a_phase_that_is_not_confirmed_does_not_begin(no: Phase) -> None:
    result = deploy(Asked(no, 0.1))
    assert result.fault == "not confirmed" and result.phase is Phase.FAULT
    assert no not in result.times


def test_what_goes_wrong_while_somebody_thinks_stops_the_robot() -> None:
    switch = StopSwitch()

    def press(phase: Phase, meanwhile: Callable[[], None]) -> None:
        if phase is Phase.LIFT:
            meanwhile()
            switch.press("pressed by a test")
            meanwhile()
            pytest.fail("it went on")

    result = deploy(Told(confirm=press), switch=switch)
    assert result.fault == "pressed by a test" and Phase.LIFT not in result.times


def test_the_question_is_answered_on_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    switch, waited = StopSwitch(), []
    monkeypatch.setattr(switch, "keyboard", True)

    def meanwhile() -> None:
        waited.append(1)
        if len(waited) == 3:
            switch._answers.put("yes\n")

    PhaseQuestions(switch).confirm(Phase.LIFT, meanwhile)
    assert len(waited) == 3
    switch._answers.put("\n")
    with pytest.raises(SafetyStop, match="'home' was not confirmed"):
        PhaseQuestions(switch).confirm(Phase.HOME, meanwhile)
    switch._answers.put("")
    with pytest.raises(SafetyStop, match="terminal has closed"):
        PhaseQuestions(switch).confirm(Phase.HOME, meanwhile)
    assert not switch.reason
