"""Series of faults over deployments: what is drawn, brought and judged."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from robot_cells import cell_and_hand, grasp_and_object, near_cell, placed

from benchmarks.fault_series.__main__ import BenchFaultSeries, drawn_faults, series_rows
from benchmarks.fault_series.moments import Moment, Scene, scene
from benchmarks.fault_series.trial import KINDS, Drawn, FaultKind, Place, TruthWatch, judged
from benchmarks.fault_series.twin_trial import twin_trial
from benchmarks.fault_series.wire_trial import wire_trial
from fungrasp.core.errors import UnknownNameError
from fungrasp.deployment.spec import Phase

pytest.importorskip("mink")

BY_NAME = {kind.name: kind for kind in KINDS}


@pytest.fixture(scope="module")
def held() -> Scene:
    grasp, obj = grasp_and_object()
    found = scene(near_cell(), cell_and_hand()[1], obj, grasp, placed(), 0)
    assert found is not None
    return found


def drawn(name: str, moment: Moment, share: float = 0.5) -> Drawn:
    return Drawn(0, moment, share, BY_NAME[name], 0.5)


def test_the_same_seed_draws_the_same_faults_in_every_phase() -> None:
    faults = drawn_faults("allegro", 200, 3)
    assert faults[:50] == drawn_faults("allegro", 50, 3)
    assert faults != drawn_faults("allegro", 200, 4)
    assert {fault.moment for fault in faults} == set(Moment)
    assert {fault.kind.name for fault in faults} == {k.name for k in KINDS if "allegro" in k.hands}
    assert all(fault.moment in fault.kind.moments for fault in faults)
    with pytest.raises(UnknownNameError, match="kind of fault"):
        drawn_faults("inspire", 1, 0, ["bus off"])


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("Ctrl-C", Moment.LOOK),
        ("hand silent", Moment.PUT_DOWN),
        ("tracker jumps", Moment.APPROACH),
        ("tracker silent", Moment.LIFT),
        ("disk full", Moment.HOLD),
        ("error in the policy", Moment.LIFT),
        ("computer hangs", Moment.CLOSE),
    ],
)
def test_a_fault_on_the_twin_ends_as_it_should(held: Scene, name: str, moment: Moment) -> None:
    trial = twin_trial(held, drawn(name, moment))
    assert trial.success, trial
    assert trial.carried == (moment in BY_NAME[name].carried)
    assert trial.held_before == (moment in (Moment.LIFT, Moment.HOLD))


class Still:
    """A world in which nothing changes but what a test says."""

    def __init__(self) -> None:
        self.time, self.height, self.palm = 0.0, 0.2, 0.3

    def look(self) -> Any:
        pose = np.array([0.0, 0.0, self.palm, 1.0, 0.0, 0.0, 0.0])
        return type("Truth", (), {"palm_pose": pose, "in_hand": True, "on_table": False})

    def center_of_mass(self) -> np.ndarray:
        return np.array([0.0, 0.0, self.height])


@pytest.mark.parametrize(
    ("change", "good"),
    [
        ({}, True),
        ({"sinks": 0.03}, False),
        ({"goes": 0.1}, False),
        ({"creeps": 0.01}, False),
        ({"reason": "the log can't be written"}, False),
        ({"ended": Phase.DONE}, False),
    ],
)
def test_what_is_not_as_it_should_be_is_told(held: Scene, change: dict[str, Any], good: bool) -> None:
    world: Any = Still()
    watch = TruthWatch(world)
    for step in range(101):
        world.time = 0.02 * step
        if step:
            world.height = 0.2 - change.get("sinks", 0.0)
            world.palm = 0.3 + change.get("goes", 0.0) + change.get("creeps", 0.0) * world.time
        watch.look()
    ended, reason = change.get("ended", Phase.FAULT), change.get("reason", "the stop key was pressed")
    fault = drawn("stop key", Moment.HOLD)
    trial = judged(held, fault, watch, ended=ended, when=0.0, reason=reason, lifted=True)
    assert trial.success == good


def test_hands_that_let_go_are_excused_and_counted(held: Scene) -> None:
    world: Any = Still()
    watch = TruthWatch(world)
    watch.look()
    world.time, world.height = 1.0, 0.05
    watch.look()
    kill = drawn("kill -9", Moment.HOLD)
    dropped = judged(held, kill, watch, ended=None, when=0.0, reason="", lifted=True)
    assert dropped.success and dropped.lets_go and dropped.held_before and not dropped.held_after
    inspire = replace(held, cell=replace(held.cell, hand="inspire"))
    assert not judged(inspire, kill, watch, ended=None, when=0.0, reason="", lifted=True).success
    rows = list(series_rows([vars(dropped)]))
    assert rows[1][-2] == "0 of 1 *"


def test_a_stopped_series_goes_on(
    held: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Any, capsys: Any
) -> None:
    monkeypatch.setattr(BenchFaultSeries, "_scenes", lambda self: [held])
    path, begun = tmp_path / "series.json", []

    def counted(self: BenchFaultSeries, scene: Scene, one: Drawn) -> Any:
        begun.append(one.number)
        return twin_trial(scene, one)

    monkeypatch.setattr(BenchFaultSeries, "_trial", counted)
    for count in (1, 2):
        given = ("--faults", count, "--kinds", "stop key", "--json", path)
        status, out, _ = run_benchmark(capsys, "fault_series", *given)
        assert status == 0 and f"{count} of {count} as they should be" in out
    assert begun == [0, 1]
    assert json.loads(path.read_text())["seed"] == 0
    status, _, error = run_benchmark(capsys, "fault_series", *given, "--seed", 1)
    assert status == 2 and "another series" in error


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kill -9", "safeguard stop"])
def test_a_fault_over_the_wire_ends_as_it_should(held: Scene, name: str) -> None:
    for package in ("can", "rtde_control", "zmq", "mcap", "ruckig"):
        pytest.importorskip(package)
    kind: FaultKind = BY_NAME[name]
    assert kind.place is Place.WIRE
    from fungrasp.robots.cell import load_cell

    cell = load_cell("ur5e-allegro-emulated")
    grasp, obj = grasp_and_object()
    wired = scene(cell, held.hand, obj, grasp, placed(), 0)
    assert wired is not None
    trial = wire_trial(wired, drawn(name, Moment.START), patience=10.0)
    assert trial.success, trial
