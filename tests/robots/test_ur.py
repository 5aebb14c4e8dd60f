"""UR arm: packages against the RTDE guide, the driver against an emulated controller."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest
from driver_contract import DeviceUnderTest, DriverContract, reach, wait_for

from fungrasp.robots.arms.ur import URLoop, URSettings, arm_flange
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, RobotError
from fungrasp_emulators import rtde as codec
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.plants import ServoPlant
from fungrasp_emulators.ur import DASHBOARD_PORT, URControllerEmulator
from fungrasp_emulators.ur_kinematics import UR5, UR5E, tool_pose

for module in ("rtde_control", "ruckig"):
    pytest.importorskip(module)

HOME = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
ADDRESSES = (f"127.0.{os.getpid() % 200 + 1}.{n}" for n in itertools.count(2))


@contextlib.contextmanager
def emulated(
    version: tuple[int, int, int] = (5, 11, 0), tool: tuple[float, ...] = (0.0,) * 6, **settings
) -> Iterator[DeviceUnderTest]:
    address = next(ADDRESSES)
    plant = ServoPlant(HOME, time_constant=0.02)
    driver = LoopDriver(URLoop(URSettings(address, **({"stale_after": 1.0} | settings))))
    with URControllerEmulator(plant, address, version, release_time=0.0, tool=tool) as emulator:
        yield DeviceUnderTest(driver, emulator, plant, HOME + 0.1, 0.005)
        driver.close()


class TestUR(DriverContract):
    lost = (Fault.KILLED, Fault.STALLED, Fault.RESET, Fault.FROZEN)
    disturbed = (Fault.LOST, Fault.DOUBLED, Fault.LATE, Fault.CLOCK_JUMP)
    # A watchdog of a second: a busy machine keeps packages for longer than 0.2 s.
    when_disturbed: ClassVar = {"watchdog": 1.0}

    def running(self, **settings):
        return emulated(**settings)


def test_packages():
    assert codec.package(codec.PROTOCOL_VERSION, b"\x00\x02") == bytes.fromhex("0005560002")
    recipe = codec.make_recipe("timestamp,runtime_state,actual_q,input_int_register_3,")
    assert recipe.types == ("DOUBLE", "UINT32", "VECTOR6D", "INT32") and recipe.valid
    data = codec.encode_values(recipe, 1, {"timestamp": 0.5, "runtime_state": 2, "input_int_register_3": -1})
    assert data[:3] == struct.pack(">H", 3 + 1 + 8 + 4 + 48 + 4) + b"U"
    assert data[3:16].hex() == "01" + "3fe0000000000000" + "00000002"
    assert data[-4:].hex() == "ffffffff"
    values = codec.decode_values(recipe, data[4:])
    assert values["timestamp"] == 0.5 and values["actual_q"] == (0.0,) * 6
    assert not codec.make_recipe("actual_q,no_such_thing").valid


def test_another_model_or_serial_number_and_a_stopped_arm_are_refused():
    for fault, said in ((Fault.WRONG_DEVICE, "UR3"), (Fault.PROTECTIVE_STOP, "PROTECTIVE_STOP")):
        with emulated() as device:
            device.emulator.inject(fault)
            with pytest.raises(RobotError, match=said):
                device.driver.connect()
    with emulated(serial="1") as device, pytest.raises(RobotError, match="serial number"):
        device.driver.connect()


def test_impossible_limits_are_refused():
    with pytest.raises(RobotError, match="rad/s"):
        URSettings(velocity=10.0)
    with pytest.raises(RobotError, match="lookahead"):
        URSettings(lookahead=0.5)


@pytest.mark.parametrize("fault", [Fault.PROTECTIVE_STOP, Fault.EMERGENCY_STOP])
def test_a_safety_stop_latches_until_a_person_has_acknowledged_it(fault: Fault):
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(fault)
        expected = (
            DeviceStatus.PROTECTIVE_STOP if fault is Fault.PROTECTIVE_STOP else DeviceStatus.EMERGENCY_STOP
        )
        assert wait_for(lambda: device.driver.read().status is expected)
        with pytest.raises(RobotError):
            device.driver.command(device.near)
        with pytest.raises(RobotError):
            device.driver.connect()
        device.emulator.clear()
        device.emulator.unlock_protective_stop()
        time.sleep(0.1)
        assert device.driver.read().status is expected
        assert not device.emulator.program_running
        device.driver.connect()
        assert not device.emulator.program_running
        device.driver.take_control()
        assert device.emulator.program_running
        reach(device, device.near)


def test_a_guard_that_opens_is_named_and_its_closing_moves_nothing():
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.SAFEGUARD_STOP)
        assert wait_for(lambda: "safeguard stop: close the guard" in device.driver.read().message)
        time.sleep(0.2)
        stood = device.driver.read().positions
        # The controller itself would go on.
        device.emulator.clear()
        time.sleep(0.3)
        assert "safeguard stop" in device.driver.read().message
        assert np.abs(device.driver.read().positions - stood).max() < 1e-3
        device.driver.connect()
        device.driver.take_control()
        reach(device, device.near)


def test_random_bytes_are_not_believed():
    with emulated() as device:
        device.driver.connect()
        device.emulator.inject(Fault.CORRUPT)
        assert wait_for(lambda: device.driver.read().status is not DeviceStatus.READY)


def test_the_controller_stops_when_its_client_dies():
    """Killed without a chance to say anything: the watchdog on the controller ends the program."""
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        os.kill(device.driver.process_id, signal.SIGKILL)
        began = time.monotonic()
        assert wait_for(lambda: not device.emulator.program_running)
        assert time.monotonic() - began < 1.0
        assert device.driver.read().status is DeviceStatus.DISCONNECTED


def test_the_arm_brakes_when_the_process_of_the_policy_dies():
    code = """
import sys, time, numpy as np
from fungrasp.robots.arms.ur import URLoop, URSettings
from fungrasp.robots.control_loop.loop_driver import LoopDriver
driver = LoopDriver(URLoop(URSettings(sys.argv[1], stale_after=1.0)))
driver.connect()
driver.command(np.full(6, 3.0))
print("moving", flush=True)
while True:
    driver.read()
    time.sleep(0.01)
"""
    with emulated() as device:
        child = subprocess.Popen(
            [sys.executable, "-c", code, device.emulator.address], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None and child.stdout.readline() == "moving\n"
        time.sleep(0.3)
        child.kill()
        child.wait()
        assert wait_for(lambda: not device.emulator.program_running)
        time.sleep(0.1)
        before = device.true_positions()
        time.sleep(0.2)
        assert np.allclose(device.true_positions(), before)


@pytest.mark.parametrize(("arm", "lengths"), [("ur5", UR5), ("ur5e", UR5E)])
def test_our_models_put_the_flange_where_the_makers_parameters_do(arm, lengths):
    """Our base_link is half a turn from the controller's Base."""
    flange = arm_flange(arm)
    for joints in np.random.default_rng(0).uniform(-3, 3, (20, 6)):
        x, y, z, *_ = tool_pose(lengths, joints, np.zeros(6))
        np.testing.assert_allclose(flange(joints), [-x, -y, z], atol=1e-6)


def test_the_stretched_out_ur5_is_where_its_parameters_add_up():
    # x = a2 + a3, y = -(d4 + d6), z = d1 - d5
    x, y, z, *_ = tool_pose(UR5, np.zeros(6), np.zeros(6))
    np.testing.assert_allclose([x, y, z], [-0.81725, -0.19145, -0.005491], atol=1e-9)


@pytest.mark.parametrize(("version", "arm"), [((3, 15, 0), "ur5e"), ((5, 11, 0), "ur5")])
def test_an_arm_of_another_generation_is_refused(version, arm):
    """Both controllers say "UR5"."""
    with emulated(version, tool=(0.0, 0.0, 0.15, 0.0, 0.0, 1.0), arm=arm) as device:
        device.driver.connect()
        with pytest.raises(RobotError, match=rf"model '{arm}' the flange is \d\d mm"):
            device.driver.command(device.near)
        assert np.array_equal(device.true_positions(), HOME)


def test_a_cb3_arm_follows_with_a_tool_on_its_flange():
    with emulated((3, 15, 0), tool=(0.0, 0.02, 0.15, 0.0, 0.5, 1.0), arm="ur5") as device:
        device.driver.connect()
        reach(device, device.near)


def test_a_running_program_survives_looking():
    with emulated() as device:
        device.emulator.play_other_program()
        device.driver.connect()
        assert np.allclose(device.driver.read().positions, HOME)
        device.driver.stop()
        device.driver.close()
        assert device.emulator.other_program_running and not device.emulator.program_running
        device.driver.connect()
        for place in (device.near, device.near + 0.05):
            # Another program is ended where control is taken, after a program of ours as well.
            reach(device, place)
            assert device.emulator.program_running and not device.emulator.other_program_running
            device.driver.close()
            device.emulator.play_other_program()
            device.driver.connect()


def test_a_second_program_is_refused_and_the_first_goes_on(tmp_path, monkeypatch):
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        second = LoopDriver(URLoop(device.driver._loop.settings))
        # A program on another computer finds no lock; there the controller refuses its registers.
        for elsewhere, said in ((False, "moved by another program on this"), (True, "registers are in use")):
            if elsewhere:
                monkeypatch.setenv("TMPDIR", str(tmp_path))
            second.connect()
            assert second.read().status is DeviceStatus.READY
            with pytest.raises(RobotError, match=said):
                second.take_control()
            second.close()
        monkeypatch.undo()
        reach(device, device.near + 0.05)
        device.driver.close()
        second.connect()
        second.take_control()
        second.close()


def test_below_full_speed_the_controller_is_refused():
    with emulated() as device:
        device.emulator.set_speed_slider(0.5)
        device.driver.connect()
        with pytest.raises(RobotError, match=r"50 %.*slider"):
            device.driver.take_control()
        device.emulator.set_speed_slider(1.0)
        device.driver.connect()
        reach(device, device.near)


def test_a_slider_that_is_lowered_during_motion_stops_the_arm():
    with emulated() as device:
        device.driver.connect()
        far = HOME + 1.0
        assert wait_for(lambda: device.driver.command(far) is not None and moved(device) > 0.1)
        device.emulator.set_speed_slider(0.8)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "80 %" in device.driver.read().message
        with pytest.raises(RobotError):
            device.driver.command(far)
        time.sleep(0.5)
        before = device.true_positions()
        time.sleep(0.2)
        assert np.abs(device.true_positions() - before).max() < 1e-3 and moved(device) < 0.9
        assert device.emulator.program_running
        with pytest.raises(RobotError, match="slider"):
            device.driver.connect()
        device.emulator.set_speed_slider(1.0)
        assert wait_for(lambda: connects(device))
        reach(device, device.near)


def moved(device: DeviceUnderTest) -> float:
    return float(np.abs(device.true_positions() - HOME).max())


def connects(device: DeviceUnderTest) -> bool:
    try:
        device.driver.connect()
    except RobotError:
        return False
    return True


def test_the_dashboard_answers_like_the_real_one():
    with emulated() as device, socket.create_connection((device.emulator.address, DASHBOARD_PORT)) as client:
        file = client.makefile("rw")
        assert file.readline().startswith("Connected: Universal Robots Dashboard Server")
        for line, answer in {
            "robotmode": "Robotmode: RUNNING",
            "nonsense": "could not understand: 'nonsense'",
        }.items():
            file.write(line + "\n")
            file.flush()
            assert file.readline().strip() == answer


def test_a_payload_that_is_not_the_pendants_is_refused():
    weight = {"payload": 1.2, "payload_center": (0.0, 0.0, 0.06)}
    with emulated(**weight) as device:
        device.emulator.payload, device.emulator.payload_center = 1.25, (0.0, 0.0, 0.063)
        device.driver.connect()
        reach(device, device.near)
    for mass, center in ((0.0, (0.0, 0.0, 0.06)), (1.2, (0.0, 0.0, 0.0))):
        with emulated(**weight) as device:
            device.emulator.payload, device.emulator.payload_center = mass, center
            with pytest.raises(RobotError, match="the pendant says a payload of"):
                device.driver.connect()
                reach(device, device.near)


def test_what_was_compared_is_said_once_control_is_taken():
    with emulated(payload=1.2, payload_center=(0.0, 0.0, 0.06)) as device:
        device.emulator.payload, device.emulator.payload_center = 1.2, (0.0, 0.0, 0.06)
        device.driver.connect()
        assert device.driver.read().message == ""
        device.driver.take_control()
        said = "the model's flange is 0.0 mm from the controller's; payload 1.20 kg, as the cell says"
        assert wait_for(lambda: device.driver.read().message == said), device.driver.read().message
