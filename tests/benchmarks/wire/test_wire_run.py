"""What a bench over the wire does where the robot says that it can't reach the object."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.twins.twin_episode import MOST_PLACEMENTS
from benchmarks.wire import wire_run
from benchmarks.wire.wire_run import run_over_the_wire
from fungrasp.deployment.preparation import UnreachableError

TASK: Any = SimpleNamespace(
    cell=None, hand=None, thing=SimpleNamespace(name="mug"), grasp=None, spec=SimpleNamespace(seed=0)
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
            raise UnreachableError("the arm doesn't reach so far")
        return wire_run._not_begun(task, twin, "", 0, 0.0)

    monkeypatch.setattr(wire_run, "reachable_placements", placements)
    monkeypatch.setattr(wire_run, "_run_at", run)
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
    assert run.fault in ("the arm doesn't reach so far", "no placement was found")
    assert set(run.ticks_10hz.values()) == {0}
