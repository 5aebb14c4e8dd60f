"""Reading, holding and moving one joint of emulated devices from the command line."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.hands import load_hand
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.plants import ServoPlant

pytest.importorskip("pymodbus")


@pytest.fixture
def emulated(tmp_path: Path) -> Any:
    plant = ServoPlant(np.full(6, 0.3), time_constant=0.02, velocity=10.0)
    with InspireEmulator(plant, port=0) as emulator:
        cell = tmp_path / "cell.toml"
        cell.write_text(
            f'hand = "inspire"\nstop_file = "{tmp_path / "stop"}"\n'
            '[arm]\ndriver = "ur-rtde"\naddress = "127.0.0.99"\n'
            '[tracker]\ndriver = "pose-stream"\naddress = "tcp://127.0.0.1:9"\noptions = { timeout = 0.1 }\n'
            f'[hand_device]\ndriver = "inspire"\naddress = "{emulator.address}"\n'
            f"options = {{ port = {emulator.port}, stale_after = 1.0 }}\n[watchdog]\nhand_silence = 1.0\n"
        )
        yield str(cell), plant


def yes(monkeypatch: pytest.MonkeyPatch, answer: str = "yes") -> list[str]:
    asked: list[str] = []

    def ask(self: StopSwitch, question: str) -> str:
        asked.append(question)
        return answer

    monkeypatch.setattr(StopSwitch, "ask", ask)
    return asked


def test_one_joint_moves_there_and_back_after_a_yes(
    emulated: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, plant = emulated
    joint = next(iter(load_hand("inspire").actuators))
    asked, seen = yes(monkeypatch), []
    apply = plant.apply

    def watch(command: Any, now: float) -> None:
        apply(command, now)
        seen.append(plant.state(time.monotonic()).positions)

    monkeypatch.setattr(plant, "apply", watch)
    assert main(["robots", "jog", cell, "hand", joint, "--by", "0.1"]) == 0, capsys.readouterr().err
    assert len(asked) == 1 and joint in asked[0]
    moved = np.abs(np.array(seen) - 0.3).max(axis=0)
    assert moved[0] == pytest.approx(0.1, abs=0.02) and moved[1:].max() < 0.01
    assert abs(plant.state(time.monotonic()).positions[0] - 0.3) < 0.02
    assert "moved by 0." in capsys.readouterr().out


@pytest.mark.parametrize("how", ["no", "nobody", "stop file", "far"])
def test_nothing_moves_otherwise(
    how: str,
    emulated: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cell, plant = emulated
    if how != "nobody":
        yes(monkeypatch, "no" if how == "no" else "yes")
    if how == "stop file":
        (tmp_path / "stop").touch()
    joint = next(iter(load_hand("inspire").actuators))
    assert main(["robots", "jog", cell, "hand", joint, "--by", "0.5" if how == "far" else "0.1"]) != 0
    said = {"no": "not confirmed", "nobody": "needs a terminal", "stop file": "stop file", "far": "0.2 rad"}
    assert said[how] in capsys.readouterr().err
    assert np.abs(plant.state(time.monotonic()).positions - 0.3).max() < 0.01


def test_holding_reading_and_the_doctor(
    emulated: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, _ = emulated
    yes(monkeypatch)
    assert main(["robots", "hold", cell, "hand", "--seconds", "0.3"]) == 0
    assert "held within 0.00" in capsys.readouterr().out
    assert main(["robots", "read", cell, "hand", "--seconds", "0"]) == 0
    assert "ready" in (said := capsys.readouterr().out) and "0.300" in said
    assert main(["robots", "doctor", cell]) != 0
    told = capsys.readouterr()
    assert "hand: Inspire RH56" in told.out and "2 of 3 devices can't be used" in told.err


def test_a_twin_has_no_devices(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", "read", "ur5e-allegro", "hand"]) != 0
    assert "is a twin" in capsys.readouterr().err
