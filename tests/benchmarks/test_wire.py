"""Deployments over emulated wires: the emulators' process, when an object counts as lifted, and what happens
where the robot says that it can't reach it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import wire
from benchmarks.twins.twin_episode import MOST_PLACEMENTS
from benchmarks.wire import EmulationProcess, EmulationTask, run_over_the_wire
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.preparation import UnreachableError
from fungrasp.objects import load_object
from fungrasp.robots.cell import load_cell
from fungrasp.robots.twin.world import HoldSample, held_throughout
from fungrasp.task.outcome import HoldMiddle

HAND = HoldMiddle(np.zeros((1, 7)), np.zeros((1, 16)), np.ones((1, 17), dtype=bool))
HELD = [HoldSample(0.1 * i, 0.12, True, True, HAND) for i in range(31)]


def test_an_object_that_stays_up_in_the_hand_is_held() -> None:
    assert held_throughout(HELD, 3.0)


@pytest.mark.parametrize(
    ("samples", "seconds"),
    [
        ([], 3.0),
        (HELD, 2.0),
        ([*HELD, HoldSample(3.1, 0.09, True, True, HAND)], 3.1),
        ([*HELD, HoldSample(3.1, 0.12, False, True, HAND)], 3.1),
        ([HoldSample(s.time, s.height, True, False, HAND) for s in HELD], 3.0),
    ],
    ids=["nothing seen", "too short", "too low", "touches the table", "not in the hand"],
)
def test_what_is_not_held(samples: list[HoldSample], seconds: float) -> None:
    assert not held_throughout(samples, seconds)


def _emulation(address: str) -> EmulationTask:
    pytest.importorskip("can")
    pytest.importorskip("zmq")
    cell = load_cell("ur5e-allegro-emulated")
    tracker = replace(cell.tracker, address="tcp://127.0.0.1:5591")
    hand = replace(cell.hand_device, address="43191")
    cell = replace(cell, arm=replace(cell.arm, address=address), hand_device=hand, tracker=tracker)
    placement = np.array([0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return EmulationTask(cell, load_object("wine_glass", None, None), placement, 0)


def test_the_process_tells_what_was_true() -> None:
    with EmulationProcess(_emulation("127.0.0.91")) as process:
        record = process.end()
    assert record.seconds > 0
    # Nobody has commanded anything: the glass stands where it settled.
    assert all(abs(s.height) < 0.005 and not s.in_hand for s in record.samples)


def test_an_address_that_cannot_be_emulated_is_told() -> None:
    with pytest.raises(FungraspError, match="loopback"), EmulationProcess(_emulation("192.168.0.10")):
        pass


TASK: Any = SimpleNamespace(
    cell=None, hand=None, obj=SimpleNamespace(name="mug"), grasp=None, spec=SimpleNamespace(seed=0)
)


def _places(monkeypatch: pytest.MonkeyPatch, count: int, reached: int) -> list[float]:
    tried: list[float] = []

    def placements(*arguments: Any) -> Any:
        if not count:
            raise UnreachableError("no placement was found")
        yield from (np.full(7, float(i)) for i in range(count))

    def run(task: Any, twin: int, placement: np.ndarray) -> Any:
        tried.append(placement[0])
        if len(tried) <= reached:
            raise UnreachableError("the arm can't reach that far")
        return wire._not_begun(task, twin, "", 0, 0.0)

    monkeypatch.setattr(wire, "reachable_placements", placements)
    monkeypatch.setattr(wire, "_run_at", run)
    return tried


def test_the_object_is_put_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = _places(monkeypatch, 5, 1)
    run = run_over_the_wire(TASK, 3)
    assert tried == [0.0, 1.0]
    assert run.placements == 2
    assert run.seconds > 0
    assert not run.fault


@pytest.mark.parametrize(("count", "tries"), [(5, MOST_PLACEMENTS), (1, 1), (0, 0)])
def test_out_of_reach_is_a_run_that_failed(monkeypatch: pytest.MonkeyPatch, count: int, tries: int) -> None:
    tried = _places(monkeypatch, count, 9)
    run = run_over_the_wire(TASK, 3)
    assert len(tried) == run.placements == tries
    assert not run.success
    assert run.phase == "idle"
    assert run.fault in ("the arm can't reach that far", "no placement was found")
    assert set(run.ticks_10hz.values()) == {0}
