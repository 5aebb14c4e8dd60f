"""Whatever stops a device while a grasp is planned is a fault: nothing connects again, nothing moves."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
import pytest
from emulated_robots import GRASP, EmulatedRobot, MeanwhilePreparer, emulated_robot
from robot_cells import Told

from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.spec import DeploymentSpec, Phase
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.device import RobotError
from fungrasp_emulators.emulator import Fault

for module in ("rtde_control", "ruckig", "pymodbus", "mink"):
    pytest.importorskip(module)


def planned(device: EmulatedRobot, meanwhile: Any) -> tuple[str, float, list[Phase]]:
    """What was wrong with a run to the start of a plan, by how much the arm moved [rad], and its phases."""
    begun: list[Phase] = []
    preparer, spec = MeanwhilePreparer(meanwhile), DeploymentSpec(look_time=0.1)
    before, grasp = device.postures()[0], GRASP
    run = Deployment(device.robot, OpenLoopPolicy(), preparer, spec, [Told(begun.append)])
    # After the motion to the start: there is no plan.
    with contextlib.suppress(AttributeError):
        run.run(grasp)
    if run.fault:
        # It is latched.
        with pytest.raises(RobotError, match="in the state 'fault'"):
            run.run(grasp)
    return run.fault, float(np.abs(device.postures()[0] - before).max()), begun


@pytest.mark.parametrize("fault", [Fault.EMERGENCY_STOP, Fault.PROTECTIVE_STOP])
def test_a_stop_that_was_released_meanwhile_is_a_fault(fault: Fault) -> None:
    with emulated_robot() as device:

        def press_and_release() -> None:
            device.arm.inject(fault)
            time.sleep(0.7)
            device.arm.clear()
            time.sleep(0.7)

        wrong, moved, begun = planned(device, press_and_release)
    assert "the arm stopped while the grasp was planned" in wrong and fault.value in wrong
    assert moved < 1e-3
    assert Phase.MOVE_TO_START not in begun


def test_a_stop_by_software_meanwhile_is_a_fault() -> None:
    with emulated_robot() as device:

        def stop() -> None:
            device.robot.stop()
            time.sleep(0.3)

        wrong, moved, begun = planned(device, stop)
    assert "stopped while the grasp was planned" in wrong and moved < 1e-3
    assert Phase.MOVE_TO_START not in begun


def test_silence_of_planning_is_none() -> None:
    with emulated_robot() as device:
        wrong, moved, begun = planned(device, lambda: time.sleep(1.2))
    assert Phase.MOVE_TO_START in begun and moved > 0.02, wrong
