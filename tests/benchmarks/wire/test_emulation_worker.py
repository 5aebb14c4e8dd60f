"""A cell's emulators in a process of their own, and when a twin's object counts as lifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wire.emulation_worker import EmulationProcess, EmulationTask
from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object
from fungrasp.robots.cell import load_cell
from fungrasp.robots.twin.judge import HoldSample, held_throughout
from fungrasp.task import LiftProtocol

HELD = [HoldSample(0.1 * i, 0.12, True, True) for i in range(31)]


def test_an_object_that_stays_up_in_the_hand_is_held() -> None:
    assert held_throughout(HELD, 3.0, LiftProtocol())


@pytest.mark.parametrize(
    ("samples", "seconds"),
    [
        ([], 3.0),
        (HELD, 2.0),
        ([*HELD, HoldSample(3.1, 0.09, True, True)], 3.1),
        ([*HELD, HoldSample(3.1, 0.12, False, True)], 3.1),
        ([HoldSample(s.time, s.height, True, False) for s in HELD], 3.0),
    ],
    ids=["nothing seen", "too short", "too low", "touches the table", "not in the hand"],
)
def test_what_is_not_held(samples: list[HoldSample], seconds: float) -> None:
    assert not held_throughout(samples, seconds, LiftProtocol())


def _task(address: str) -> EmulationTask:
    pytest.importorskip("can")
    pytest.importorskip("zmq")
    cell = load_cell("ur5e-allegro-emulated")
    tracker = replace(cell.tracker, address="tcp://127.0.0.1:5591")
    hand = replace(cell.hand_device, address="43191")
    cell = replace(cell, arm=replace(cell.arm, address=address), hand_device=hand, tracker=tracker)
    placement = np.array([0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return EmulationTask(cell, load_object("wine_glass", None, None), placement, 0)


def test_the_process_tells_what_was_true() -> None:
    with EmulationProcess(_task("127.0.0.91")) as process:
        record = process.end()
    assert record.seconds > 0
    # Nobody has commanded anything: the glass stands where it settled.
    assert all(abs(s.height) < 0.005 and not s.in_hand for s in record.samples)


def test_an_address_that_cannot_be_emulated_is_told() -> None:
    with pytest.raises(FungraspError, match="loopback"), EmulationProcess(_task("192.168.0.10")):
        pass
