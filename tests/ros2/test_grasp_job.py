"""What the node's action, stop and release do, without ROS."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driver_contract import wait_for

from fungrasp.core.errors import FungraspError
from fungrasp.deployment import hold_after_stop
from fungrasp.deployment.spec import GraspChoice, Phase
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.device import DeviceStatus, JointState, StopKind, WallClock
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
    monkeypatch.setattr(hold_after_stop, "OPENING", 0.05)
    monkeypatch.setattr(hold_after_stop, "LOOK", 0.01)
    stops: list[StopKind] = []
    robot: Any = SimpleNamespace(
        state=lambda: SimpleNamespace(arm=STATE, hand=STATE),
        hand_driver=SimpleNamespace(stop=stops.append, read=lambda: STATE),
        hand=SimpleNamespace(open_joints=np.zeros(6), actuators="abcdef"),
        clock=WallClock(),
    )

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


def test_cancelling_stops_and_ends_with_the_hold(job: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    node: Any = object.__new__(grasp_node.GraspNode)
    node._job, node._accept = job, "accepted"
    node._result = node._feedback = SimpleNamespace
    monkeypatch.setattr(grasp_node, "fill", lambda message, values: values)
    ends: list[str] = []
    goal: Any = SimpleNamespace(
        request=SimpleNamespace(grasp="mug", grasps="", objects="", until="lift", speed=0.5),
        publish_feedback=lambda feedback: None,
        is_cancel_requested=True,
        **{name: lambda name=name: ends.append(name) for name in ("canceled", "succeed", "abort")},
    )
    thread = threading.Thread(target=node.execute, args=(goal,))
    thread.start()
    assert wait_for(lambda: job.states)
    assert node.cancel(goal) == "accepted"
    assert wait_for(lambda: job.holding) and not ends
    assert "The hand holds" in job.wrong
    job.release()
    thread.join(10.0)
    assert ends == ["canceled"] and job.stops == [StopKind.OPEN]


@pytest.mark.parametrize("released", [True, False])
def test_an_interrupt_stops_and_the_node_serves_until_the_hold_ends(job: Any, released: bool) -> None:
    """In a process of its own signals come to the main thread."""
    thread = threading.Thread(target=lambda: job.run(MUG, lambda phase: None))
    thread.start()
    assert wait_for(lambda: job.states)
    said: list[str] = []
    times = []
    before = signal.getsignal(signal.SIGTERM)

    def press() -> None:
        # Before it has its own, a signal would go to the test's handler and never be seen again.
        assert wait_for(lambda: signal.getsignal(signal.SIGTERM) is not before)
        os.kill(os.getpid(), signal.SIGTERM)
        assert wait_for(lambda: job.holding)
        times.append(job.running)
        time.sleep(1.2)
        if released:
            job.release()
        else:
            os.kill(os.getpid(), signal.SIGTERM)

    presser = threading.Thread(target=press)
    presser.start()
    grasp_node.serve_until_told(job, said.append)
    presser.join()
    thread.join(10.0)
    assert times == [True] and "until 'release'" in said[0] and not job.running
    assert job.stops == [StopKind.OPEN] * released


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
