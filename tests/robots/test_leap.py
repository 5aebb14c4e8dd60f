"""LEAP hand: packets of the protocol, the driver against emulated servos on a pseudo terminal."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest
from driver_contract import DeviceUnderTest, DriverContract, reach, wait_for
from loop_thread import LoopThread

from fungrasp.hands import load_hand
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, RobotError, StopKind
from fungrasp.robots.hands import leap as codec
from fungrasp.robots.hands.leap import LeapLoop, LeapSettings
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.leap import SYNC_READ, DynamixelEmulator, ServoPacket
from fungrasp_emulators.plants import ServoPlant

pytest.importorskip("dynamixel_sdk")
SERVOS = tuple(int(name) for name in load_hand("leap").actuators)


@contextlib.contextmanager
def emulated(**settings) -> Iterator[DeviceUnderTest]:
    plant = ServoPlant(np.full(16, 0.1), time_constant=0.02, velocity=8.0)
    with DynamixelEmulator(plant, SERVOS) as emulator:
        options = {"stale_after": 1.0, "build": "full"} | settings
        driver = LoopDriver(LeapLoop(LeapSettings(emulator.address, **options)), LoopThread)
        yield DeviceUnderTest(driver, emulator, plant, np.full(16, 0.3), 0.01)
        driver.close()


class TestLeap(DriverContract):
    disturbed = (*DriverContract.disturbed, Fault.DOUBLED)
    when_lost: ClassVar = {"stale_after": 0.4}
    # Positions that come again just after they were too old are followed again.
    latches = False

    def running(self, **settings):
        return emulated(**settings)


def test_units():
    assert codec.position_counts(np.array([0.0, np.pi / 2, -np.pi])) == [2048, 3072, 0]
    assert np.allclose(codec.joint_positions_of(np.array([2048, 3072])), [0, np.pi / 2])


def test_the_order_of_the_model_is_kept():
    with emulated() as device:
        device.driver.connect()
        goal = np.linspace(0.0, 0.3, 16)
        reach(device, goal)
        assert np.allclose(device.true_positions(), goal, atol=0.01)


def test_torque_comes_with_the_first_goal_and_a_closed_driver_leaves_it():
    with emulated() as device:
        device.driver.connect()
        assert not device.emulator.torque_on
        reach(device, device.near)
        assert device.emulator.torque_on
        device.driver.stop()
        device.driver.close()
        time.sleep(0.2)
        assert device.emulator.torque_on
        assert np.abs(device.true_positions() - device.near).max() < 0.02


def test_a_missing_servo_is_named():
    with emulated() as device:
        device.emulator.inject(Fault.WRONG_DEVICE)
        with pytest.raises(RobotError, match=f"servo {SERVOS[-1]} "):
            device.driver.connect()
    with pytest.raises(RobotError, match="cannot open the port"):
        LoopDriver(LeapLoop(LeapSettings("/dev/no-such-port", build="full")), LoopThread).connect()


def test_a_hardware_error_is_a_fault():
    with emulated() as device:
        device.driver.connect()
        device.emulator.report_error(5, 1 << 5)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "servo 5: overload" in device.driver.read().message


def test_a_late_answer_of_another_register_is_no_hardware_error(monkeypatch: pytest.MonkeyPatch) -> None:
    hot, read = 1 << 2, []

    def answers(self: DynamixelEmulator, packet: ServoPacket) -> list[bytes]:
        asked = packet.parameters[:1]
        if packet.instruction == SYNC_READ and asked == bytes([codec.HARDWARE_ERROR]):
            read.append(asked)
            # Positions that were asked for before, with a current that looks like this error.
            late = [self._status(servo, codec.PRESENT.pack(hot, 0, codec.CENTER)) for servo in SERVOS]
            return [*late, *told(self, packet)]
        return told(self, packet)

    told = DynamixelEmulator._answers
    monkeypatch.setattr(DynamixelEmulator, "_answers", answers)
    with emulated() as device:
        device.driver.connect()
        assert wait_for(lambda: len(read) > 3)
        assert device.driver.read().status is not DeviceStatus.FAULT, device.driver.read().message
        device.emulator.report_error(5, hot)
        assert wait_for(lambda: "servo 5: too hot" in device.driver.read().message)


def test_power_off_and_open():
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.driver.stop(StopKind.OPEN)
        assert wait_for(lambda: np.abs(device.true_positions()).max() < 0.4)
        device.driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not device.emulator.torque_on)
        time.sleep(0.05)
        assert device.driver.read().status is DeviceStatus.STOPPED


def test_a_loop_that_ended_with_an_error_of_a_library_is_started_again(monkeypatch: pytest.MonkeyPatch):
    with emulated() as device:
        device.driver.connect()
        monkeypatch.setattr(codec, "joint_positions_of", lambda counts: 1 / 0)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "ZeroDivisionError" in device.driver.read().message
        monkeypatch.undo()
        device.driver.connect()
        reach(device, device.near)


@pytest.mark.parametrize(("build", "current"), [("full", 550), ("lite", 350)])
def test_currents_and_gains_are_those_of_the_makers_examples(build: str, current: int):
    with emulated(build=build) as device:
        device.driver.connect()
        reach(device, device.near)
        for servo in SERVOS:
            share = 0.75 if servo in (0, 4, 8) else 1.0
            written = [
                device.emulator.register(servo, address)
                for address in (codec.CURRENT_LIMIT, codec.GOAL_CURRENT, codec.P_GAIN, codec.D_GAIN)
            ]
            assert written == [current, current, 600 * share, 200 * share]


def test_servos_with_torque_are_left_alone_while_they_are_looked_at():
    with emulated() as device:
        for servo in SERVOS:
            device.emulator._write(servo, codec.TORQUE_ENABLE, b"\x01")
        device.driver.connect()
        device.driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.STOPPED)
        device.driver.close()
        assert device.emulator.torque_on
        assert all(device.emulator.register(servo, codec.P_GAIN) == 0 for servo in SERVOS)


def test_a_servo_that_missed_a_write_is_told_again():
    with emulated(current_limit=100) as device:
        device.driver.connect()
        device.emulator.inject(Fault.UNHEARD)
        reach(device, device.near)
        assert wait_for(lambda: device.emulator.torque_on)
        for servo in SERVOS:
            assert device.emulator.register(servo, codec.GOAL_CURRENT) == 100
            mode = device.emulator.register(servo, codec.OPERATING_MODE) & 0xFF
            assert mode == codec.CURRENT_BASED_POSITION


def test_a_servo_that_takes_no_mode_is_refused(monkeypatch: pytest.MonkeyPatch):
    with emulated() as device:
        write, deaf = device.emulator._write, SERVOS[3]
        monkeypatch.setattr(
            device.emulator,
            "_write",
            lambda servo, address, data: (
                None if (servo, address) == (deaf, codec.OPERATING_MODE) else write(servo, address, data)
            ),
        )
        device.driver.connect()
        with pytest.raises(RobotError, match="does not accept: operating mode"):
            device.driver.command(device.near)
        assert not device.emulator.torque_on


def test_a_reading_a_turn_off_is_refused_and_nothing_moves():
    with emulated() as device:
        device.emulator.inject(Fault.WRAPPED)
        device.driver.connect()
        assert device.driver.read().positions.max() > 6.0, "it can be looked at"
        before = device.true_positions()
        with pytest.raises(RobotError, match=r"joint \d+ is read at 6\.\d\d rad, and its limits"):
            device.driver.command(device.near)
        time.sleep(0.3)
        assert not device.emulator.torque_on and np.abs(device.true_positions() - before).max() < 1e-3


def test_the_other_fingers_open_where_a_servo_has_a_fault():
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.MOTOR)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        device.driver.stop(StopKind.OPEN)
        assert wait_for(lambda: np.sort(np.abs(device.true_positions()))[-2] < 0.27)
        device.driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not any(device.emulator._memory[s][codec.TORQUE_ENABLE] for s in SERVOS))


def test_torques_of_the_lite_hand_are_its_motors():
    # XL330-M288 at 5 V, data sheet: 0.52 N m at 1.47 A.
    lite = LeapLoop(LeapSettings(build="lite")).limits.torque
    np.testing.assert_allclose(lite, 0.35 * 0.52 / 1.47, rtol=0.02)


def test_a_hand_whose_build_nobody_says_is_refused():
    with pytest.raises(RobotError, match="full"):
        LeapSettings("/dev/ttyUSB0")
