"""A robot brought up step by step: a checklist of commands, with a log that goes on where it ended."""

from __future__ import annotations

import contextlib
import io
import re
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fungrasp.cli import bring_up, devices
from fungrasp.cli.bring_up import FAILED, PASSED, SKIPPED, BringUp, BringUpLog, BringUpStep
from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.robots import single_devices
from fungrasp.robots.calibration.touched import TouchedPoint, touched_place
from fungrasp.robots.cell import load_cell
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState
from fungrasp_emulators.emulator import PlantCommand
from fungrasp_emulators.plants import ServoPlant

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
    with pytest.raises(FungraspError, match="is not a bring-up log"):
        BringUpLog(other, "one", "0")
    assert other.read_text() == "# My notes\n"
    BringUpLog(log, "one", "0123").append(BringUpStep("doctor", "It answers.", ()), PASSED, ["a\nb"])
    with pytest.raises(FungraspError, match="is from the cell one, not two"):
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
        assert "needs a person at a terminal" in capsys.readouterr().err
    assert main(["robots", "hold", CELL, "arm", "--yes"]) == 2
    assert "only after you confirm" in capsys.readouterr().err


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


@dataclass
class Emulated:
    """Emulated devices, and the cell that ``robots new`` writes for them, filled in."""

    file: Path
    arm: ServoPlant

    def guide(self, joints: np.ndarray) -> None:
        """Move the arm as a person does in freedrive."""
        self.arm.apply(PlantCommand(positions=joints), time.monotonic())
        until = time.monotonic() + 30.0
        while np.abs(self.arm.state(time.monotonic()).positions - joints).max() > 1e-4:
            assert time.monotonic() < until
            time.sleep(0.01)


HOME = [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]
MEASURED = {
    "pose_world_base = []": "pose_world_base = [-0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]",
    "home = []": f"home = {HOME}",
    "pose_flange_hand = []": "pose_flange_hand = [0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]",
}
"""What a person measures and fills in."""


@pytest.fixture
def emulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Emulated]:
    for module in ("rtde_control", "ruckig", "pymodbus", "zmq", "msgpack"):
        pytest.importorskip(module)
    from emulated_robots import ADDRESSES

    from fungrasp.robots.pose.stream import PosePublisher
    from fungrasp_emulators.inspire import InspireEmulator
    from fungrasp_emulators.ur import URControllerEmulator

    monkeypatch.setattr(single_devices, "JOG_SPEED", 0.15)
    monkeypatch.setattr(bring_up, "STOP_AFTER", 1.0)
    monkeypatch.chdir(tmp_path)
    arm_plant = ServoPlant(np.array(HOME), time_constant=0.02)
    hand_plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    address, path, end = next(ADDRESSES), tmp_path / "my-cell.toml", threading.Event()
    tracker = f"tcp://{address}:5556"
    with (
        URControllerEmulator(arm_plant, address, release_time=0.0),
        InspireEmulator(hand_plant, port=0) as fingers,
    ):
        assert main(["robots", "new", path.name, "--hand", "inspire"]) == 0
        text = path.read_text()
        # An emulator keeps up with more, on a computer that is busy.
        quick = "options = { velocity = 2.0, acceleration = 20.0, jerk = 1000.0, stale_after = 2.0 }"
        patient = f"options = {{ port = {fingers.port}, stale_after = 2.0, answer_timeout = 0.5 }}"
        emulators = {
            "options = { velocity = 0.3, acceleration = 1.0, jerk = 20.0 }": quick,
            'address = ""': f'address = "{address}"',
            'address = "192.168.11.210"': f'address = "{fingers.address}"',
            "options = { speed = 100, force = 100 }": patient,
            'address = "tcp://127.0.0.1:5556"': f'address = "{tracker}"\ncalibration_residual = 0.001',
        }
        for empty, filled in {**MEASURED, **emulators}.items():
            assert text.count(empty) == 1, empty
            text = text.replace(empty, filled)
        path.write_text(text + "[watchdog]\narm_silence = 1.0\nhand_silence = 1.0\noverrun = 1.5\n")
        publisher = PosePublisher(tracker, "box")

        def publish() -> None:
            while not end.wait(0.02):
                publisher.publish(np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]), time.monotonic())

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        yield Emulated(path, arm_plant)
        end.set()
        thread.join()
        publisher.close()


def in_this_process(words: Sequence[str], keyboard: bool) -> tuple[int, list[str]]:
    """As ``run_fungrasp``, without a second to import everything, and with shorter times. A grasp is carried
    out on a twin of the same cell, as fast as it goes."""
    said, words = io.StringIO(), list(words)
    if words[0] == "deploy":
        at = words.index("--robot") + 1
        text = Path(words[at]).read_text()
        twin = Path(words[at]).with_name("twin.toml")
        twin.write_text(re.sub(r'^driver = ".*"', 'driver = "twin"', text, flags=re.M))
        words[at] = str(twin)
        words += ["--fast", "--log", f"{time.monotonic()}.mcap"]
    short = {"read": ["--seconds", "0"], "hold": ["--seconds", "0.3"]}
    with contextlib.redirect_stdout(said):
        status = main([*words, *short.get(words[1], [])])
    return status, said.getvalue().splitlines()


PAGE = Path(__file__).parents[2] / "docs" / "robots" / "setup.md"
JOINTS = {"arm": "shoulder_pan_joint", "hand": next(iter(load_hand("inspire").actuators))}


def commands_of_the_page() -> list[list[str]]:
    """Command lines of fungrasp in the page's checklist, in its order, as words."""
    checklist = PAGE.read_text().partition("## Before the first power-on")[2]
    found = re.findall(r"`(fungrasp[^`]*)`|^\$ (fungrasp .*)$", checklist, flags=re.M)
    return [(inline or block).split()[1:] for inline, block in found]


@pytest.mark.slow
def test_the_page_of_the_first_power_on_is_true_of_emulated_devices(
    emulated: Emulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Command by command, up to the lift; a bring-up with all its steps."""
    monkeypatch.setattr(bring_up, "run_fungrasp", in_this_process)
    cell, hand = load_cell(emulated.file), load_hand("inspire")
    done = []
    for words in commands_of_the_page():
        verb = " ".join(words[:2]) if words[0] != "deploy" else "deploy"
        done.append(verb)
        # An Inspire that has to stay above the table does not get around the page's mug.
        words = ["bottle" if word == "mug" else word for word in words]
        words = [JOINTS[words[3]] if word == "JOINT" else word for word in words]
        if verb == "robots new":
            # Refused until it is filled in, which the fixture did.
            assert in_this_process(["robots", "new", "empty.toml", *words[3:]], False)[0] == 0
            assert in_this_process(["robots", "check", "empty.toml"], False)[0] == 2
            continue
        if verb == "robots touch":
            for turn in (-0.5, 0.0, 0.5):
                emulated.guide(posture := np.array([turn, *HOME[1:]]))
                flange = TouchedPoint(tuple(posture.tolist()), (0.0, 0.0, 0.0))
                at = [f"{x:.6f}" for x in touched_place(flange, cell, hand)]
                assert main([*words, "my-cell.toml", "touched.json", "--at", *at]) == 0
            emulated.guide(np.array(HOME))
            continue
        if verb == "robots emulate":
            continue  # Emulated they are already.
        more = {
            "hands show": ["inspire"],
            "robots bring-up": ["--yes", "--policy", "reference"],
            "deploy": ["--policy", "reference", "--grasp", "bottle"],
        }.get(verb, [])
        more += ["--yes"] * (verb in ("robots hold", "robots jog"))
        # A step may fail on a computer that is too busy to keep an arm's time: the command goes on there.
        assert 0 in (in_this_process([*words, *more], False)[0] for _ in range(3)), capsys.readouterr()
    assert len(done) >= 14 and {"robots touch", "robots bring-up", "deploy"} <= set(done)
    how = BringUpLog(tmp_path / "bring-up.md", "my-cell", "").done
    assert len(how) == 14 and {name for name, status in how.items() if status != PASSED} == {"stop"}
    text = (tmp_path / "bring-up.md").read_text()
    assert "the model's flange is 0.0 mm from the controller's" in text
    assert "further; it stays stopped" in text and not (tmp_path / "stop").exists()
    assert "3 touched points, within 0.0 mm" in text and (tmp_path / "bring-up-plan.png").exists()
    assert text.count("moved by 0.") + text.count("moved by -0.") >= 12
    # Whether the object stays up is the policy's matter, measured elsewhere; that the robot came home is not.
    assert "lifted" in text.rpartition("\n## lift: passed")[2]


def test_a_command_runs_in_a_process_of_its_own() -> None:
    status, lines = bring_up.run_fungrasp(["--version"], False)
    assert status == 0 and lines[0].startswith("fungrasp ")
    assert bring_up.run_fungrasp(["robots", "check", "nothing"], False)[0] == 2
