"""Faults of the computer that controls a robot, brought over emulated wires."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.control_bench import CONTROL, ControlBench
from benchmarks.faults.control_faults import control_reactions
from benchmarks.faults.control_session import ControlFault
from fungrasp.deployment.spec import GraspChoice
from fungrasp.hands import load_hand
from fungrasp.robots.cell import load_cell

for package in ("can", "rtde_control", "zmq", "mcap", "ruckig", "mink"):
    pytest.importorskip(package)

PATIENCE = 10.0
"""A busy machine stops processes for long."""


@pytest.fixture(scope="module")
def bench() -> ControlBench:
    robot, grasp = CONTROL["control-allegro"]
    cell = load_cell(robot)
    chosen, objects = GraspChoice(grasp=grasp, threads=1).robot(load_hand(cell.hand))
    return ControlBench(cell, chosen, objects[str(chosen.object_name[0])], PATIENCE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (ControlFault.POLICY_NAN, "not finite"),
        (ControlFault.DISK_FULL, "the log can't be written"),
        (ControlFault.ALL_KILLED, ""),
    ],
)
def test_the_arm_stops_and_the_log_can_be_read(bench: ControlBench, fault: ControlFault, said: str) -> None:
    arm, hand = control_reactions(bench, fault, 1, np.random.default_rng(0))
    assert (arm.fault, hand.fault) == (fault.value, fault.value)
    assert said in arm.status
    assert arm.detected is not None and arm.detected < 1.5
    assert arm.stopped is not None
    assert arm.log_readable
    assert arm.restarted
    if fault is ControlFault.ALL_KILLED:
        # Nobody is left to switch the hand off.
        assert hand.detected is None
