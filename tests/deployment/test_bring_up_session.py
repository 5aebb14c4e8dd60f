"""A robot brought up step by step: on emulated devices, with a log that goes on where it ended."""

from __future__ import annotations

import functools
import io
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from robot_cells import cell_and_hand

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.bring_up import grasp_steps, session, steps
from fungrasp.deployment.bring_up.log import FAILED, PASSED, SKIPPED, BringUpLog, StepResult
from fungrasp.deployment.bring_up.operator import BringUpEnded, Operator, StepSkipped
from fungrasp.deployment.bring_up.steps import BringUpStep, BringUpTask
from fungrasp.deployment.grasp_choice import GraspChoice
from fungrasp.deployment.plan_ahead import execute_plan
from fungrasp.robots import single_devices
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState
from fungrasp.robots.stop_switch import StopSwitch


def task(tmp_path: Path, answers: str | None = None, name: str = "ur5e-allegro") -> BringUpTask:
    """On a twin's cell; None as answers says yes to everything."""
    cell, hand = cell_and_hand()
    switch, said = StopSwitch(), []
    operator = Operator(switch, cell, said.append, answers is None)
    return BringUpTask(
        name,
        cell,
        hand,
        switch,
        operator,
        GraspChoice(),
        "reference",
        1.0,
        0,
        None,
        tmp_path / "plan.npz",
        lambda path, saved: (path.with_suffix(".png"),),
    )


class Played:
    """Steps that end as told, by name."""

    def __init__(self, ends: dict[str, Any]):
        self.ends, self.run = ends, []

    def steps(self) -> tuple[BringUpStep, ...]:
        return tuple(
            BringUpStep(name, f"{name} is tried.", functools.partial(self._do, name)) for name in self.ends
        )

    def _do(self, name: str, task: BringUpTask) -> StepResult:
        self.run.append(name)
        end = self.ends[name]
        if isinstance(end, Exception):
            raise end
        return StepResult(end, (f"{name} measured",))


def play(
    monkeypatch: pytest.MonkeyPatch, given: BringUpTask, log: Path, start: str = "", **ends: Any
) -> list[str]:
    played = Played(ends)
    monkeypatch.setattr(session, "STEPS", played.steps())
    try:
        session.bring_up(given, log, start)
    except FungraspError as error:
        played.run.append(str(error))
    return played.run


def test_a_log_goes_on_where_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given, log = task(tmp_path), tmp_path / "log.md"
    first = play(
        monkeypatch, given, log, a=PASSED, b=StepSkipped("no time"), c=FungraspError("no cable"), d=PASSED
    )
    assert first[:3] == ["a", "b", "c"] and "the step 'c' failed" in first[3]
    assert BringUpLog(log, "ur5e-allegro", "").done == {"a": PASSED, "b": SKIPPED, "c": FAILED}
    assert "no time" in log.read_text() and "no cable" in log.read_text()
    assert play(monkeypatch, given, log, a=PASSED, b=PASSED, c=PASSED, d=PASSED) == ["c", "d"]
    assert play(monkeypatch, given, log, a=PASSED, b=PASSED, c=PASSED, d=PASSED) == []
    again = play(monkeypatch, given, log, "b", a=PASSED, b=FAILED, c=PASSED, d=PASSED)
    assert again[0] == "b" and "'b' failed" in again[1]
    assert "unknown step 'e'" in play(monkeypatch, given, log, "e", a=PASSED)[0]


def test_logs_of_others_are_refused_and_left_alone(tmp_path: Path) -> None:
    other, log = tmp_path / "other.md", tmp_path / "log.md"
    other.write_text("# My notes\n")
    with pytest.raises(FungraspError, match="is no log of a bring-up"):
        BringUpLog(other, "one", "0")
    assert other.read_text() == "# My notes\n"
    BringUpLog(log, "one", "0123456789abcdef").append("doctor", "It answers.", StepResult(PASSED, ("a\nb",)))
    with pytest.raises(FungraspError, match="is of the cell one, not two"):
        BringUpLog(log, "two", "0123456789abcdef")
    assert not BringUpLog(log, "one", "0123456789abcdef").other_cell
    assert BringUpLog(log, "one", "another").other_cell


def test_answers_are_read_from_a_pipe_and_only_for_emulated_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = task(tmp_path, "").operator
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\nskip no board here\nwhat\nno\n"))
    operator.begin("Move.")
    with pytest.raises(StepSkipped, match="no board here"):
        operator.begin("Move.")
    with pytest.raises(BringUpEnded, match="by the operator"):
        operator.begin("Move.")
    assert not operator.judges("Right?")
    with pytest.raises(BringUpEnded, match="no more answers"):
        operator.begin("Move.")
    cell = cell_and_hand()[0]
    real = replace(cell, arm=replace(cell.arm, driver="ur-rtde", address="192.168.0.10"))
    for always in (True, False):
        with pytest.raises(FungraspError, match="by a person at a terminal"):
            Operator(StopSwitch(), real, print, always)


class Turning:
    """A driver whose joints follow in their own way."""

    limits = JointLimits(np.full(3, -1.0), np.full(3, 1.0), np.full(3, 9.0), np.full(3, 9.0))

    def __init__(self, follow: np.ndarray):
        self.follow, self.positions = follow, np.zeros(3)

    def read(self) -> JointState:
        now = time.monotonic()
        return JointState(self.positions, np.zeros(3), None, now, now, DeviceStatus.READY)

    def command(self, goal: np.ndarray) -> np.ndarray:
        self.positions = self.follow @ goal
        return goal


@pytest.mark.parametrize(
    ("follow", "well"),
    [
        (np.eye(3), True),
        (-np.eye(3), False),
        (np.diag([0.3, 1.0, 1.0]), False),
        (np.roll(np.eye(3), 1, axis=0), False),
        (np.eye(3) + np.array([[0, 0, 0], [0.9, 0, 0], [0, 0, 0]]), False),
    ],
    ids=["right", "wrong sign", "too little", "another joint", "another joint as well"],
)
def test_a_joint_that_moves_otherwise_is_wrong(
    follow: np.ndarray, well: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(single_devices, "GOAL_PERIOD", 1e-4)
    monkeypatch.setattr(single_devices, "JOG_SPEED", 100.0)
    assert steps._jogged(Turning(follow), 0, "hand")[1] is well  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("answer", ["yes", "skip nobody has a ruler"])
def test_a_real_arms_base_is_not_passed_over(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "is_wired", lambda cell: True)
    monkeypatch.setattr(Operator, "ask", lambda operator, question: answer)
    task: Any = SimpleNamespace(cell=None, touched=None, operator=object.__new__(Operator))
    if answer == "yes":
        result = steps.check_touched(task)
        assert result.status == "failed" and "fungrasp robots touch" in result.measured[0]
        return
    with pytest.raises(StepSkipped, match="nobody has a ruler"):
        steps.check_touched(task)


def test_the_last_steps_plan_go_there_and_lift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mink")
    pytest.importorskip("mcap")
    given = task(tmp_path)
    monkeypatch.setattr(grasp_steps, "execute_plan", functools.partial(execute_plan, real_time=False))
    planned = grasp_steps.make_plan(given)
    assert planned.status == PASSED and "wine_glass" in planned.measured[0]
    lifted = grasp_steps.lift(given)
    assert lifted.status == PASSED, lifted.measured
    assert "the tracker saw the object 1" in lifted.measured[-1]


@pytest.fixture
def emulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The file of a cell of emulated devices, quick and patient."""
    for module in ("rtde_control", "ruckig", "pymodbus", "zmq", "msgpack"):
        pytest.importorskip(module)
    from emulated_robots import ADDRESSES

    from fungrasp.robots.pose.stream import PosePublisher
    from fungrasp_emulators.inspire import InspireEmulator
    from fungrasp_emulators.plants import ServoPlant
    from fungrasp_emulators.ur import URControllerEmulator

    monkeypatch.setattr(single_devices, "JOG_SPEED", 0.4)
    monkeypatch.setattr(steps, "HOLD_TIME", 0.3)
    monkeypatch.setattr(steps, "STOP_AFTER", 0.2)
    home = [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]
    arm_plant = ServoPlant(np.array(home), time_constant=0.02)
    hand_plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    address, path, end = next(ADDRESSES), tmp_path / "cell.toml", threading.Event()
    tracker = f"tcp://{address}:5556"
    with (
        URControllerEmulator(arm_plant, address, release_time=0.0),
        InspireEmulator(hand_plant, port=0) as fingers,
    ):
        path.write_text(
            f'name = "small"\nhand = "inspire"\nstop_file = "{tmp_path / "stop"}"\n'
            f'[arm]\ndriver = "ur-rtde"\naddress = "{address}"\nhome = {home}\n'
            "options = { velocity = 2.0, acceleration = 20.0, jerk = 1000.0, stale_after = 2.0 }\n"
            "pose_world_base = [-0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]\n"
            f'[hand_device]\ndriver = "inspire"\naddress = "{fingers.address}"\n'
            f"options = {{ port = {fingers.port}, stale_after = 2.0, answer_timeout = 0.5 }}\n"
            f'[tracker]\ndriver = "pose-stream"\naddress = "{tracker}"\n'
            "[watchdog]\narm_silence = 1.0\nhand_silence = 1.0\noverrun = 1.5\n"
        )
        publisher = PosePublisher(tracker, "box")

        def publish() -> None:
            while not end.wait(0.02):
                publisher.publish(np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]), time.monotonic())

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        yield path
        end.set()
        thread.join()
        publisher.close()


def test_emulated_devices_are_brought_up_to_the_plan(
    emulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices = tuple(step for step in session.STEPS if step.name not in ("plan", "approach", "lift"))
    monkeypatch.setattr(session, "STEPS", devices)
    begin = Operator.begin

    def think(self: Operator, what: str) -> None:
        # Longer than a device waits to be asked before it holds by itself.
        if "wrist_3_joint" in what or "pinky" in what:
            time.sleep(0.8)
        begin(self, what)

    monkeypatch.setattr(Operator, "begin", think)
    log = tmp_path / "bring-up.md"
    command = ["robots", "bring-up", str(emulated), "--log", str(log), "--yes"]
    # A step may fail on a computer that is too busy to keep an arm's time: the command goes on there.
    assert 0 in (main(command) for _ in range(3)), capsys.readouterr()
    done = BringUpLog(log, "small", "").done
    skipped = {"payload", "base"}
    assert done == {step.name: SKIPPED if step.name in skipped else PASSED for step in devices}
    text = log.read_text()
    assert "the model's flange is 0.0 mm from the controller's" in text
    assert text.count("further; it stays stopped") >= 2 and not (tmp_path / "stop").exists()
    assert text.count("moved +0.") + text.count("moved -0.") >= 12


def test_an_arm_that_is_not_stopped_fails(
    emulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(steps, "STOP_AFTER", 60.0)
    log = tmp_path / "bring-up.md"
    assert main(["robots", "bring-up", str(emulated), "--log", str(log), "--yes", "--start", "stop"]) == 2
    assert "the step 'stop' failed" in capsys.readouterr().err
    assert "it was not stopped" in log.read_text()
