"""Allegro Hand: frames against the protocol tables, the driver against an emulated hand."""

from __future__ import annotations

import contextlib
import os
import signal
import struct
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest
from driver_contract import DeviceUnderTest, DriverContract, reach, wait_for
from loop_thread import LoopThread

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, RobotError, StopKind
from fungrasp.robots.hands import allegro_bus as codec
from fungrasp.robots.hands.allegro import AllegroLoop, AllegroSettings
from fungrasp_emulators.allegro import AllegroEmulator
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.plants import TorquePlant

Message = pytest.importorskip("can").Message


@contextlib.contextmanager
def emulated(
    generation: int = 4, friction: float = 0.01, load: float = 0.0, **settings
) -> Iterator[DeviceUnderTest]:
    channel = uuid.uuid4().hex
    plant = TorquePlant(np.full(16, 0.5), inertia=0.01, damping=0.2, friction=friction, load=load)
    emulator = AllegroEmulator(plant, "virtual", channel, generation)
    settings = {"stale_after": 1.0, "generation": generation} | settings
    driver = LoopDriver(AllegroLoop(AllegroSettings("virtual", channel, **settings)), LoopThread)
    with emulator:
        yield DeviceUnderTest(driver, emulator, plant, np.full(16, 0.4), 0.02)
        driver.close()


class TestAllegro(DriverContract):
    # Below, more strictly.
    disturbed = ()
    when_lost: ClassVar = {"stale_after": 1.0}

    def running(self, **settings):
        return emulated(**settings)


@pytest.mark.parametrize("generation", [4, 5])
def test_a_hand_follows_in_the_units_of_its_generation_and_is_limp_without_power(generation: int):
    with emulated(generation) as device:
        device.driver.connect()
        reach(device, device.near)
        device.driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not device.emulator.servos_on)


def test_frames_of_the_fourth_generation():
    # 90° is 90 / (333.3 / 65536) = 17696.5 counts = 0x4520; 1 count is 0.005086°.
    assert codec.identifier(0x20) == 0x80 and codec.code_of(0x18C) == 0x63
    data = bytes.fromhex("2045e0ba01000000")
    positions = np.rad2deg(codec.decode_positions(codec.ALLEGRO_V4, [data]))
    assert np.allclose(positions, [89.9976, -89.9976, 0.0050858, 0.0], atol=1e-4)
    # 0.1 N m is 120 counts; the second joint of a finger is clipped at 675 = 0x2a3.
    torques = np.concatenate([[0.1, 5.0, -0.1, 0.0], np.zeros(8), np.full(4, 5.0)])
    frames = codec.encode_torques(codec.ALLEGRO_V4, torques)
    assert len(frames) == codec.FINGERS_ON_BUS
    assert frames[0] == bytes.fromhex("7800a30288ff0000")
    # The thumb's first joint is clipped at 525 = 0x20d.
    assert frames[3][:2] == bytes.fromhex("0d02")


def test_frames_of_the_fifth_generation():
    # 90° is 1022.7 counts of 0.088°.
    data = bytes.fromhex("ff0301fc01000000")
    positions = np.rad2deg(codec.decode_positions(codec.ALLEGRO_V5, [data]))
    assert np.allclose(positions, [90.024, -90.024, 0.088, 0.0])
    # 0.1 N m is 143 mA; 240 mA at most; geared joints take half.
    torques = np.concatenate([[0.1, 0.1, 5.0, -5.0], np.zeros(12)])
    assert codec.encode_torques(codec.ALLEGRO_V5, torques)[0] == bytes.fromhex("8f008f00f00010ff")
    assert codec.encode_torques(codec.ALLEGRO_V5_GEARED, torques)[0][:4] == bytes.fromhex("8f004800")


def test_frames_of_periods_and_information():
    assert codec.encode_periods(3) == bytes.fromhex("030000000000")
    info = codec.decode_info(bytes.fromhex("0004010001230300"))
    assert info.hardware >> 8 == 4 and info.left and info.temperature == 0x23
    assert info.servos_on and info.overheated and not info.communication_fault


@pytest.mark.parametrize("generation", [4, 5])
def test_another_generation_is_refused(generation: int):
    with emulated(generation) as device:
        other = device.driver._loop.settings
        wrong = AllegroSettings(other.interface, other.channel, generation=9 - generation)
        with pytest.raises(RobotError, match=f"V{generation}"):
            LoopDriver(AllegroLoop(wrong), LoopThread).connect()


def test_a_left_hand_with_the_model_of_a_right_one_is_refused():
    with pytest.raises(RobotError, match="model of a right hand"):
        LoopDriver(AllegroLoop(AllegroSettings("virtual", "none", side="left")))


@pytest.mark.parametrize("generation", [4, 5])
def test_another_side_is_refused_before_anything_moves(generation: int):
    with emulated(generation) as device:
        device.emulator.inject(Fault.WRONG_DEVICE)
        with pytest.raises(RobotError, match="left"):
            device.driver.connect()
        assert not device.emulator.servos_on


def test_feedforward_carries_the_weight():
    """Without it the servo sags by weight / kp; with it the goal is reached."""
    with emulated(load=0.08, friction=0.0) as device:
        device.driver.connect()
        goal = np.full(16, 0.4)

        def error(feedforward):
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                device.driver.command(goal, feedforward)
                time.sleep(0.02)
            return np.abs(device.true_positions() - goal).max()

        assert error(None) == pytest.approx(0.08 / 4.0, rel=0.1)
        assert error(np.full(16, 0.08)) < 0.003


def test_a_hand_that_somebody_else_drives_is_left_alone_while_it_is_looked_at():
    with emulated(load=0.05, friction=0.0) as device:
        settings = device.driver._loop.settings
        other = codec.open_can_bus(settings.interface, settings.channel)

        def say(code: int, data: bytes = b"") -> None:
            other.send(Message(arbitration_id=codec.identifier(code), data=data, is_extended_id=False))

        say(codec.PERIODS, codec.encode_periods(3))
        say(codec.SERVOS_ON)
        for finger, data in enumerate(codec.encode_torques(codec.ALLEGRO_V4, np.full(16, 0.05))):
            say(codec.TORQUE + finger, data)
        assert wait_for(lambda: device.emulator.servos_on and device.emulator.torques.all())
        before = device.emulator.torques
        device.driver.connect()
        time.sleep(0.2)
        assert device.driver.read().status is DeviceStatus.READY
        device.driver.stop(StopKind.POWER_OFF)
        time.sleep(0.1)
        device.driver.close()
        while other.recv(0.0) is not None:
            pass
        assert device.emulator.servos_on and np.array_equal(device.emulator.torques, before)
        assert other.recv(1.0) is not None
        other.shutdown()


def test_a_hand_that_another_program_drives_keeps_its_torques():
    with emulated(load=0.05, friction=0.0) as device:
        settings = device.driver._loop.settings
        device.driver.connect()
        reach(device, device.near)
        held = device.emulator.torques.copy()
        second = LoopDriver(AllegroLoop(settings), LoopThread)
        second.connect()
        with pytest.raises(RobotError, match="moved by another program on this computer"):
            second.take_control()
        second.close()
        # One on another computer has no such lock: its torques are seen on the bus.
        third = AllegroLoop(settings)
        third.open()
        time.sleep(0.05)
        third.step(LoopGoal(LoopMode.IDLE, np.zeros(16), np.zeros(16)))
        with pytest.raises(RobotError, match="another program sends torques"):
            third.take_control()
        third.close()
        assert device.emulator.servos_on and held.any()
        assert device.driver.read().status is DeviceStatus.READY


def test_closing_takes_the_torque_away():
    with emulated(load=0.05) as device:
        device.driver.connect()
        goal = np.full(16, 0.4)
        for _ in range(20):
            device.driver.command(goal)
            time.sleep(0.01)
        assert device.emulator.servos_on and np.abs(device.emulator.torques).max() > 0.02
        device.driver.close()
        assert wait_for(lambda: not device.emulator.servos_on)
        assert not device.emulator.torques.any()


@pytest.mark.parametrize("fault", [Fault.LOST, Fault.DOUBLED, Fault.LATE, Fault.CORRUPT])
def test_a_disturbed_bus_does_not_throw_the_hand(fault: Fault):
    with emulated() as device:
        device.driver.connect()
        device.emulator.inject(fault)
        reach(device, device.near)
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            assert device.driver.read().status is DeviceStatus.READY
            # A busy machine stops the emulated hand and its driver for a while, too.
            assert np.abs(device.true_positions() - device.near).max() < 0.25
            device.driver.command(device.near)
            time.sleep(0.01)


def test_error_frames_are_counted_and_no_positions():
    """The identifier of a bus error, 0x80, is that of the index finger's positions."""
    with emulated(friction=0.0) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.BUS_ERRORS)
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            device.driver.command(device.near)
            state = device.driver.read()
            assert np.abs(state.positions - device.near).max() < 0.1, state
            time.sleep(0.002)
        assert state.status is DeviceStatus.READY and "error frames" in state.message


def test_a_bus_that_is_off_is_a_fault():
    with emulated(stale_after=5.0) as device:
        device.driver.connect()
        device.emulator.inject(Fault.BUS_OFF)
        assert wait_for(lambda: device.driver.read().status is not DeviceStatus.READY, 2.0)
        assert "bus is off" in device.driver.read().message
        device.emulator.clear()
        device.driver.connect()
        reach(device, device.near)


@pytest.mark.parametrize(("fault", "reason"), [(Fault.TOO_HOT, "too hot (85"), (Fault.INTERNAL, "internal")])
def test_heat_and_faults_that_the_hand_says_on_request_only_end_control(fault: Fault, reason: str):
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(fault)
        assert wait_for(lambda: device.driver.read().status is not DeviceStatus.READY, 3.0)
        assert reason in device.driver.read().message
        assert wait_for(lambda: not device.emulator.servos_on and not device.emulator.torques.any())
        with pytest.raises(RobotError, match=r"internal|hot"):
            device.driver.connect()
        device.emulator.clear()
        device.driver.connect()
        reach(device, device.near)


@contextlib.contextmanager
def over_the_loopback(
    port: int, load: float = 0.05
) -> Iterator[tuple[AllegroEmulator, LoopDriver, TorquePlant]]:
    """A hand that holds, in processes of their own."""
    channel = str(port + os.getpid() % 5000)
    # With a stop: joints without torque fall, further than is believed while a busy machine starts a driver.
    plant = TorquePlant(np.full(16, 0.5), inertia=0.01, damping=0.2, friction=0.01, load=load, lower=0.3)
    with AllegroEmulator(plant, "loopback", channel) as emulator:
        with LoopDriver(AllegroLoop(AllegroSettings("loopback", channel, stale_after=0.5))) as driver:
            driver.command(np.full(16, 0.4))
            assert wait_for(lambda: emulator.servos_on and emulator.torques.any())
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                driver.command(np.full(16, 0.4))
                time.sleep(0.02)
            yield emulator, driver, plant
        assert wait_for(lambda: not emulator.servos_on and not emulator.torques.any())


def holds(emulator: AllegroEmulator, driver: LoopDriver, plant: TorquePlant, seconds: float = 0.5) -> bool:
    """Whether the hand carries the load for some time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        driver.read()
        if not emulator.servos_on or plant.state(time.monotonic()).positions.min() < 0.33:
            return False
        time.sleep(0.01)
    return True


def test_a_hand_whose_process_has_died_is_held_by_another_one():
    with over_the_loopback(20000) as (emulator, driver, plant):
        os.kill(driver.process_id, signal.SIGKILL)
        assert wait_for(lambda: driver.read().status is DeviceStatus.DISCONNECTED)
        assert wait_for(lambda: driver.read().status is DeviceStatus.FAULT)
        assert "another process controls" in driver.read().message
        assert wait_for(lambda: plant.state(time.monotonic()).positions.min() > 0.35)
        assert holds(emulator, driver, plant)
        driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not emulator.servos_on)
        driver.connect()
        driver.command(np.full(16, 0.4))
        assert wait_for(lambda: emulator.servos_on)


def test_a_bus_that_comes_back_finds_the_hand_held_and_obeying():
    with over_the_loopback(25000) as (emulator, driver, plant):
        emulator.inject(Fault.BUS_OFF)
        assert wait_for(lambda: "bus is off" in driver.read().message)
        driver.stop()
        time.sleep(0.7)
        emulator.clear()
        assert wait_for(lambda: "answers again" in driver.read().message)
        assert driver.read().status is DeviceStatus.FAULT
        assert wait_for(lambda: plant.state(time.monotonic()).positions.min() > 0.35)
        assert holds(emulator, driver, plant)
        driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not emulator.servos_on and not emulator.torques.any())


@pytest.mark.parametrize("fault", [Fault.BUS_OFF, Fault.STALLED])
def test_torques_end_after_the_program_though_the_bus_was_off_as_it_ended(
    fault: Fault, caplog: pytest.LogCaptureFixture
):
    # The last assertion of the context: they are gone.
    with over_the_loopback(31000) as (emulator, driver, _):
        emulator.inject(fault)
        assert wait_for(lambda: driver.read().status is DeviceStatus.DISCONNECTED)
        driver.close()
        assert emulator.torques.any() and "may still have torque" in caplog.text
        emulator.clear()


def test_frames_that_a_full_queue_refuses_drop_nothing():
    with over_the_loopback(36000) as (emulator, driver, plant):
        emulator.inject(Fault.NO_BUFFERS)
        assert holds(emulator, driver, plant, 1.0)
        assert driver.read().status is DeviceStatus.READY
        emulator.clear()
        emulator.fill_buffers(2000)
        assert wait_for(lambda: "takes no frames" in driver.read().message)
        assert wait_for(lambda: "answers again" in driver.read().message)
        assert wait_for(lambda: plant.state(time.monotonic()).positions.min() > 0.35)
        assert holds(emulator, driver, plant)


def test_a_hand_that_has_cooled_down_opens_as_it_is_told():
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.TOO_HOT)
        assert wait_for(lambda: not device.emulator.servos_on, 3.0)
        device.driver.stop(StopKind.OPEN)
        device.emulator.clear()
        assert wait_for(lambda: device.true_positions().min() < 0.1)
        assert device.driver.read().status is DeviceStatus.FAULT, "it stays a fault"


def test_servos_that_did_not_hear_are_told_again():
    with emulated() as device:
        device.emulator.inject(Fault.UNHEARD)
        device.driver.connect()
        reach(device, device.near)
        device.emulator._servos_on = False
        assert wait_for(lambda: device.emulator.servos_on, 3.0)
        device.driver.stop(StopKind.POWER_OFF)
        assert wait_for(lambda: not device.emulator.servos_on)


def test_the_hand_loses_its_torque_when_the_process_of_the_policy_dies():
    code = """
import sys, time, numpy as np
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.hands.allegro import AllegroLoop, AllegroSettings
driver = LoopDriver(AllegroLoop(AllegroSettings("loopback", sys.argv[1], stale_after=1.0)))
driver.connect()
driver.command(np.full(16, 0.4))
print("moving", flush=True)
while True:
    driver.read()
    time.sleep(0.01)
"""
    channel = str(30000 + os.getpid() % 10000)
    with AllegroEmulator(
        TorquePlant(np.full(16, 0.5), load=0.05, lower=0.3), "loopback", channel
    ) as emulator:
        child = subprocess.Popen([sys.executable, "-c", code, channel], stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None and child.stdout.readline() == "moving\n"
        assert wait_for(lambda: emulator.servos_on and emulator.torques.any())
        child.kill()
        child.wait()
        assert wait_for(lambda: not emulator.servos_on and not emulator.torques.any())


def test_positions_that_no_hand_has_are_not_believed_after_a_silence():
    loop = AllegroLoop(AllegroSettings("virtual", "none"))
    count = round(0.4 / codec.ALLEGRO_V4.radians_per_count)
    loop._frames.update(dict.fromkeys(range(4), struct.pack("<4h", *[count] * 4)))
    loop._take_positions(10.0)
    good = loop._state
    # A second of silence would explain a jump of 20 rad.
    loop._frames.update(dict.fromkeys(range(4), b"\xff\x7f" * 4))
    loop._take_positions(11.0)
    assert loop._state is good
    assert not loop._frames
