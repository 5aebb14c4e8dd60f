"""A robot brought up step by step: a checklist of commands, with a log that goes on where it ended."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fungrasp.cli import bring_up, devices
from fungrasp.cli.bring_up import FAILED, PASSED, SKIPPED, BringUp, BringUpLog, BringUpStep
from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.robots import single_devices
from fungrasp.robots.cell import load_cell
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState

CELL = "ur5e-inspire-emulated"


def played(
    monkeypatch: pytest.MonkeyPatch, log: Path, answers: Sequence[str], *names: str, **ended: int
) -> tuple[list[str], str]:
    """The steps that were done, and what was wrong. ended: exit status of a step's command, 0 if not said."""
    done: list[str] = []

    def run(words: Sequence[str], keyboard: bool) -> tuple[int, list[str]]:
        done.append(words[1])
        return ended.get(words[1], 0), [f"{words[1]} measured"]

    steps = [
        BringUpStep(name, f"Try {name}.", ("robots", name), "Well?" if name == "b" else "") for name in names
    ]
    left = iter(answers)
    monkeypatch.setattr(BringUp, "steps", lambda *given: steps)
    monkeypatch.setattr(bring_up, "run_fungrasp", run)
    monkeypatch.setattr("builtins.input", lambda question: next(left))
    try:
        BringUp(CELL, log).run()
    except FungraspError as error:
        return done, str(error)
    return done, ""


def test_a_log_goes_on_where_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, names = tmp_path / "log.md", ("a", "b", "c", "d")
    done, wrong = played(monkeypatch, log, ["yes", "skip no time", "yes"], *names, c=2)
    assert done == ["a", "c"] and "the step 'c' failed" in wrong
    assert BringUpLog(log, CELL, "").done == {"a": PASSED, "b": SKIPPED, "c": FAILED}
    assert "no time" in log.read_text() and "- c measured" in log.read_text()
    assert played(monkeypatch, log, ["yes", "what"], *names) == (["c"], "ended by the operator")
    assert played(monkeypatch, log, ["yes"], *names) == (["d"], "")
    assert played(monkeypatch, log, [], *names) == ([], "")


def test_the_operator_judges_what_no_command_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log.md"
    assert "'b' failed" in played(monkeypatch, log, ["yes", "no"], "b")[1]
    assert played(monkeypatch, log, ["yes", "yes"], "b") == (["b"], "")
    assert "- operator: Well? no" in log.read_text() and "- operator: Well? yes" in log.read_text()


def test_logs_of_others_are_refused_and_left_alone(tmp_path: Path) -> None:
    other, log = tmp_path / "other.md", tmp_path / "log.md"
    other.write_text("# My notes\n")
    with pytest.raises(FungraspError, match="is no log of a bring-up"):
        BringUpLog(other, "one", "0")
    assert other.read_text() == "# My notes\n"
    BringUpLog(log, "one", "0123").append(BringUpStep("doctor", "It answers.", ()), PASSED, ["a\nb"])
    with pytest.raises(FungraspError, match="is of the cell one, not two"):
        BringUpLog(log, "two", "0123")
    assert not BringUpLog(log, "one", "0123").other_cell
    assert BringUpLog(log, "one", "another").other_cell


def test_a_real_robot_is_brought_up_by_a_person(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = load_cell(CELL)
    real = replace(cell, arm=replace(cell.arm, address="192.168.0.10"))
    monkeypatch.setattr("fungrasp.robots.cell.load_cell", lambda name: real)
    for words in (["bring-up", CELL, "--yes"], ["bring-up", CELL]):
        assert main(["robots", *words, "--log", str(tmp_path / "log.md")]) == 2
        assert "by a person at a terminal" in capsys.readouterr().err
    assert main(["robots", "hold", CELL, "arm", "--yes"]) == 2
    assert "only if a person says so" in capsys.readouterr().err


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
    driver: Any = Turning(follow)
    assert (devices.Jog(CELL, "hand", "all")._moved(driver, 0, "thumb")[1] == []) is well


def test_steps_of_one_that_had_more_of_them_are_known(tmp_path: Path) -> None:
    """A log of before the checklist: its steps of the same name are done."""
    cell, log = load_cell(CELL), tmp_path / "log.md"
    log.write_text(
        f"# Bring-up of {cell.name}\n\n## doctor: passed\n\n## kinematics: passed\n\n## payload: skipped\n"
    )
    assert BringUpLog(log, cell.name, "").done == {"doctor": PASSED, "kinematics": PASSED, "payload": SKIPPED}


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
    monkeypatch.setattr(bring_up, "STOP_AFTER", 1.0)
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
            f'[tracker]\ndriver = "pose-stream"\naddress = "{tracker}"\ncalibration_residual = 0.001\n'
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


def in_this_process(words: Sequence[str], keyboard: bool) -> tuple[int, list[str]]:
    """As ``run_fungrasp``, without a second to import everything, and with shorter times."""
    said = io.StringIO()
    short = {"read": ["--seconds", "0"], "hold": ["--seconds", "0.3"]}
    with contextlib.redirect_stdout(said):
        status = main([*words, *short.get(words[1], [])])
    return status, said.getvalue().splitlines()


def test_emulated_devices_are_brought_up_to_the_plan(
    emulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bring_up, "run_fungrasp", in_this_process)
    every = BringUp.steps

    def of_devices(self: BringUp, *given: Any) -> list[BringUpStep]:
        return [step for step in every(self, *given) if step.words[0] == "robots"]

    monkeypatch.setattr(BringUp, "steps", of_devices)
    log = tmp_path / "bring-up.md"
    command = ["robots", "bring-up", str(emulated), "--log", str(log), "--yes"]
    # A step may fail on a computer that is too busy to keep an arm's time: the command goes on there.
    assert 0 in (main(command) for _ in range(3)), capsys.readouterr()
    done = BringUpLog(log, "small", "").done
    assert len(done) == 11 and {name for name, how in done.items() if how != PASSED} == {"stop", "base"}
    text = log.read_text()
    assert "the model's flange is 0.0 mm from the controller's" in text
    assert "further; it stays stopped" in text and not (tmp_path / "stop").exists()
    assert text.count("moved by 0.") + text.count("moved by -0.") >= 12


def test_a_command_runs_in_a_process_of_its_own() -> None:
    status, lines = bring_up.run_fungrasp(["--version"], False)
    assert status == 0 and lines[0].startswith("fungrasp ")
    assert bring_up.run_fungrasp(["robots", "check", "nothing"], False)[0] == 2
