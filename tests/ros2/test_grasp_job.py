"""What the node's action, stop and release do, without ROS."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.core.errors import FungraspError
from fungrasp.deployment import hold_after_stop
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.spec import GraspChoice
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.device import DeviceStatus, JointState, StopKind
from fungrasp_ros2 import grasp_node
from fungrasp_ros2.grasp_node import GraspJob, GraspRequest

pytest.importorskip("mcap")
STATE = JointState(np.zeros(6), np.zeros(6), None, 0.0, 0.0, DeviceStatus.READY)
MUG = GraspRequest(GraspChoice("mug"), until="lift", speed=0.5)


def wired() -> RobotCell:
    cell = load_cell("ur5e-inspire-emulated")
    return replace(cell, tracker=replace(cell.tracker, calibration_residual=0.001))


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A job whose deployment waits until it is stopped, then holds."""
    grasp = SimpleNamespace(object_name=np.array(["mug"]))
    monkeypatch.setattr(GraspChoice, "robot", lambda self, hand, seed=0: (grasp, {"mug": "a mug"}))
    monkeypatch.setattr(grasp_node, "deployment_task", lambda grasp, objects, spec: spec)
    monkeypatch.setattr(hold_after_stop, "OPENING", 0.0)
    stops: list[StopKind] = []
    robot: Any = SimpleNamespace(state=lambda: None, hand_driver=SimpleNamespace(stop=stops.append))

    def deploy(spec: Any, observers: Any, switch: Any) -> Any:
        assert (spec.cell, spec.until, spec.speed) == ("lab.toml", "lift", 0.5)
        log, job = observers
        assert log._about["grasp"] == "mug"
        job.phase(0.0, Phase.GRASP)
        job.setpoint(Phase.GRASP, SimpleNamespace(arm=STATE, hand=STATE), None)
        assert wait_for(lambda: switch.reason)
        assert job.hold(robot)
        return SimpleNamespace(fault=switch.reason, words=lambda: f"fault: {switch.reason}")

    made = GraspJob(wired(), "lab.toml", logs=tmp_path, deploy=deploy)
    made.stops = stops
    return made


def test_a_grasp_is_stopped_held_and_released(job: Any) -> None:
    assert job.stop() == (False, "nothing is running")
    assert not job.release()[0] and job.states == {}
    phases: list[str] = []
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(job.run(MUG, phases.append)))
    thread.start()
    assert wait_for(lambda: job.states)
    assert job.now == "grasp" and phases == ["grasp"]
    assert job.run(MUG, phases.append) == (False, "another grasp is running", "")
    assert job.stop()[0]
    assert wait_for(lambda: job.holding) and not results and not job.stops
    assert job.release() == (True, "opening")
    thread.join(10.0)
    done, words, log = results[0]
    assert not done and words == "fault: the service 'stop' was called" and Path(log).is_file()
    assert job.stops == [StopKind.OPEN] and job.wrong == "the service 'stop' was called"
    assert job.stop() == (False, "nothing is running")


def test_what_is_refused_is_said(job: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Any, hand: Any, seed: int = 0) -> Any:
        raise FungraspError("no such grasp")

    monkeypatch.setattr(GraspChoice, "robot", refuse)
    assert job.run(MUG, lambda phase: None) == (False, "no such grasp", "")
    assert job.wrong == "no such grasp"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"until": "left"}, "unknown end of a grasp 'left'"), ({"speed": 1.5}, "at most 1, not 1.5")],
)
def test_goals_that_can_not_be_are_refused(job: Any, wrong: dict[str, Any], words: str) -> None:
    done, said, _ = job.run(replace(MUG, **wrong), lambda phase: None)
    assert not done and words in said


def test_cells_that_are_no_robots_are_refused() -> None:
    with pytest.raises(FungraspError, match="is a twin"):
        GraspJob(load_cell("ur5e-allegro"), "ur5e-allegro")
    cell = wired()
    bare = replace(cell, tracker=replace(cell.tracker, calibration_residual=-1.0))
    with pytest.raises(FungraspError, match="no calibration"):
        GraspJob(bare, "lab.toml")
