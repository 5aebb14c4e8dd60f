"""Inspire RH56: registers and frames, the driver against an emulated hand over TCP and serial lines."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
import tty
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest
from driver_contract import DeviceUnderTest, DriverContract, reach, wait_for
from loop_thread import LoopThread

from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import DeviceStatus, RobotError, StopKind
from fungrasp.robots.hands import inspire_link as codec
from fungrasp.robots.hands.inspire import InspireLoop, InspireSettings
from fungrasp.robots.hands.inspire_link import open_link
from fungrasp_emulators.emulator import Fault
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.plants import ServoPlant

pytest.importorskip("pymodbus")


@contextlib.contextmanager
def emulated(protocol: str = "tcp", **settings) -> Iterator[DeviceUnderTest]:
    plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    with InspireEmulator(plant, port=0, protocol=protocol) as emulator:
        options = {"stale_after": 1.0, "answer_timeout": 0.5, "protocol": protocol} | settings
        driver = LoopDriver(
            InspireLoop(InspireSettings(emulator.address, emulator.port, **options)), LoopThread
        )
        yield DeviceUnderTest(driver, emulator, plant, np.full(6, 0.4), 0.01)
        driver.close()


class TestInspireTCP(DriverContract):
    lost = (Fault.KILLED, *DriverContract.lost)
    disturbed = (*DriverContract.disturbed, Fault.RESET)
    latches = False
    when_lost: ClassVar = {"stale_after": 0.5, "answer_timeout": 0.2}
    when_disturbed: ClassVar = {"answer_timeout": 0.1}

    def running(self, **settings):
        return emulated(**settings)


class TestInspireSerial(TestInspireTCP):
    disturbed = DriverContract.disturbed

    def running(self, **settings):
        return emulated("serial", **settings)


@pytest.mark.parametrize("closing", [False, True])
def test_a_stop_keeps_the_squeeze_of_fingers_that_something_holds_up(closing):
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        # The object: fingers go no farther.
        device.plant.apply = lambda command, now: None
        lower, upper = device.driver.limits.lower, device.driver.limits.upper
        asked = codec.encode_angles(device.near + 0.3, lower, upper)
        registers = device.emulator._registers

        def keeps() -> bool:
            return [registers[codec.ANGLE_SET + motor] for motor in range(6)] == asked

        def arrived() -> bool:
            device.driver.command(device.near + 0.3)
            return keeps()

        assert wait_for(arrived)
        device.driver.stop()
        time.sleep(0.2)
        if closing:
            device.driver.close()
        assert keeps()


def test_angles():
    lower, upper = np.zeros(6), np.array([1.47, 1.47, 1.47, 1.47, 1.308, 0.6])
    # Index half closed, pinky closed, thumb rotation a quarter, thumb bend open.
    positions = np.array([0.735, 0.0, 0.0, 1.47, 0.327, 0.0])
    angles = codec.encode_angles(positions, lower, upper)
    assert angles == [0, 1000, 1000, 500, 1000, 750]
    assert np.allclose(codec.decode_angles(angles, lower, upper), positions, atol=1e-3)
    assert codec.encode_angles(np.full(6, 9.0), lower, upper) == [0] * 6
    assert np.allclose(codec.decode_angles([65526] * 6, lower, upper), upper * 1.01)
    assert codec.unpack_bytes([0x0201, 0x0403, 0x0605]) == [1, 2, 3, 4, 5, 6]
    assert codec.closing_speed(375) == pytest.approx((706 + 1449) / 2)


SERIAL_REQUESTS = {
    # Maker: manual of the RH56 series, examples of the protocol, as two published clients test against them.
    "read ANGLE_ACT (maker)": ("eb90 01 04 11 0a06 0c 32", 1546, b"\x0c"),
    "write ANGLE_SET (maker)": (
        "eb90 01 0f 12 ce05 6400 6400 6400 6400 d007 0000 5c",
        1486,
        codec.register_bytes([100, 100, 100, 100, 2000, 0]),
    ),
    # brVrzl/embodied-hand-lab, a hand behind a JAKA arm: all open, all closed.
    "open (JAKA)": ("eb90 01 0f 12 ce05 e803e803e803e803e803e803 77", 1486, codec.register_bytes([1000] * 6)),
    "close (JAKA)": ("eb90 01 0f 12 ce05 000000000000000000000000 f5", 1486, bytes(12)),
    # rh56_sdk's tests of its frames: two motors; the force sensors' calibration, one byte to 1009.
    "two motors (rh56_sdk)": ("eb90 01 07 12 ce05 e8038403 5f", 1486, codec.register_bytes([1000, 900])),
    "calibrate (rh56_sdk)": ("eb90 01 04 12 f103 01 0c", 1009, b"\x01"),
}


@pytest.mark.parametrize("case", SERIAL_REQUESTS)
def test_frames_of_published_clients_on_a_serial_line(case: str):
    text, address, data = SERIAL_REQUESTS[case]
    frame = bytes.fromhex(text)
    request = codec.InspireFrame(1, codec.READ if case.startswith("read") else codec.WRITE, address, data)
    assert codec.encode_frame(codec.REQUEST, request) == frame
    assert codec.split_frames(codec.REQUEST, b"\x00\xeb" + frame + b"\xeb") == ([request], b"\xeb")
    wrong = frame[:-1] + bytes([frame[-1] ^ 1])
    assert codec.split_frames(codec.REQUEST, wrong + frame)[0] == [request]


def test_answers_on_a_serial_line():
    # Both of the maker's manual: the angles, and a write that was taken.
    angles = bytes.fromhex("90eb 01 0f 11 0a06 6400 6400 6400 6400 d007 0000 98")
    (answer,), rest = codec.split_frames(codec.ANSWER, angles)
    assert codec.registers_of(answer.data) == [100, 100, 100, 100, 2000, 0] and rest == b""
    taken = bytes.fromhex("90eb 01 04 12 ce05 01 eb")
    assert codec.split_frames(codec.ANSWER, taken)[0] == [
        codec.InspireFrame(1, codec.WRITE, 1486, codec.TAKEN)
    ]
    # Half of an answer waits for the rest; a length that can't be is skipped.
    assert codec.split_frames(codec.ANSWER, b"\x90\xeb\x01\x00" + angles[:9]) == ([], angles[:9])


def test_the_driver_sends_frames_of_the_makers_protocol():
    """As seen by a bare terminal: nothing of the project answers."""
    master, slave = os.openpty()
    tty.setraw(slave)
    heard: list[bytes] = []

    def hand() -> None:
        answers = {
            "eb900104 11 e803 01 02": "90eb0104 11 e803 01 02",
            "eb900104 12 ec03 01 07": "90eb0104 12 ec03 01 07",
            "eb90010f 12 ce05 e803e803e803e803e803e803 77": "90eb0104 12 ce05 01 eb",
        }
        for _ in answers:
            heard.append(os.read(master, 64))
            # An adapter that echoes what was sent, and an answer in two parts.
            os.write(master, heard[-1])
            answer = bytes.fromhex({bytes.fromhex(k): v for k, v in answers.items()}.get(heard[-1], ""))
            os.write(master, answer[:4])
            time.sleep(0.01)
            os.write(master, answer[4:])

    thread = threading.Thread(target=hand, daemon=True)
    thread.start()
    link = open_link(os.ttyname(slave), 0, 115200, "serial", 1, 5.0)
    assert link.read(codec.HAND_ID, 1) == [1]
    assert link.write(codec.CLEAR_ERRORS, [1])
    assert link.write(codec.ANGLE_SET, [1000] * 6)
    thread.join(5.0)
    link.close()
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    ("address", "protocol", "words"),
    [
        ("/dev/ttyUSB0", "", "'protocol' is missing"),
        ("/dev/ttyUSB0", "tcp", "'protocol' is not 'tcp'"),
        ("192.168.11.210", "serial", "'protocol' is not 'serial'"),
    ],
)
def test_a_serial_port_says_its_protocol(address: str, protocol: str, words: str):
    with pytest.raises(RobotError, match=words):
        InspireSettings(address, protocol=protocol)


def test_a_command_moves_after_its_delay_at_the_measured_speed():
    with emulated(speed=250) as device:
        device.driver.connect()
        start, began = device.true_positions(), time.monotonic()
        device.driver.command(np.full(6, 0.6))
        assert wait_for(lambda: np.abs(device.true_positions() - start).max() > 1e-6)
        assert time.monotonic() - began > 0.06
        reach(device, np.full(6, 0.55))
    expected = 706 / 1000 * 1.47
    assert device.driver.limits.velocity[0] == pytest.approx(expected)


@pytest.mark.parametrize("protocol", ["tcp", "serial"])
def test_a_hand_with_another_number_is_refused(protocol: str):
    with emulated(protocol) as device:
        device.emulator.inject(Fault.WRONG_DEVICE)
        with pytest.raises(RobotError, match="number 2"):
            device.driver.connect()


@pytest.mark.parametrize("protocol", ["tcp", "serial"])
def test_a_fault_of_a_motor_latches_until_somebody_connects(protocol: str):
    with emulated(protocol) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.report_error(3, 0b00101)
        time.sleep(0.5)
        assert device.driver.read().status is DeviceStatus.READY, "stall and overcurrent belong to grasping"
        device.emulator.report_error(3, 0b00010)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert device.driver.read().message == "index finger: too hot"
        with pytest.raises(RobotError, match="too hot"):
            device.driver.command(device.near)


@pytest.mark.parametrize("protocol", ["tcp", "serial", "rtu"])
def test_a_faulted_hand_holds_and_opens_as_it_is_told(protocol: str):
    with emulated(protocol, speed=50, answer_timeout=0.2) as device:
        device.driver.connect()
        reach(device, device.near)
        device.driver.command(np.full(6, 0.55))
        assert wait_for(lambda: device.true_positions().max() > 0.42)
        device.emulator.report_error(3, 1 << 3)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        device.driver.stop()
        time.sleep(0.4)
        rest = device.true_positions()
        time.sleep(0.3)
        assert np.abs(device.true_positions() - rest).max() < 0.01
        assert "index finger: motor fault" in device.driver.read().message
        device.driver.stop(StopKind.OPEN)
        assert wait_for(lambda: device.true_positions().max() < 0.01)


@pytest.mark.parametrize("protocol", ["tcp", "serial", "rtu"])
def test_a_hand_that_refuses_its_limits_is_refused(protocol: str):
    with emulated(protocol, force=100, answer_timeout=0.1) as device:
        device.driver.connect()
        device.emulator.inject(Fault.REFUSED)
        with pytest.raises(RobotError, match=r"does not accept: .*force limits"):
            device.driver.command(device.near)
        device.emulator.clear()
        device.driver.connect()
        reach(device, device.near)
        forces = [device.emulator._registers[codec.FORCE_SET + motor] for motor in range(6)]
        assert forces == [100] * 6


@pytest.mark.parametrize("fault", [Fault.REFUSED, Fault.UNHEARD])
def test_limits_that_a_hand_takes_late_are_told_again(fault: Fault):
    with emulated(force=100, answer_timeout=0.05) as device:
        device.driver.connect()
        device.emulator.inject(fault)
        threading.Timer(0.2, device.emulator.clear).start()
        reach(device, device.near)
        assert device.emulator._registers[codec.FORCE_SET] == 100


@pytest.mark.parametrize("protocol", ["tcp", "serial", "rtu"])
def test_a_stop_that_is_not_heard_is_told_again(protocol: str):
    with emulated(protocol, speed=50, answer_timeout=0.05) as device:
        device.driver.connect()
        reach(device, device.near)
        device.driver.command(np.full(6, 1.2))
        assert wait_for(lambda: device.true_positions().max() > 0.45)
        device.emulator.unheard = 3
        device.driver.stop()
        time.sleep(1.0)
        rest = device.true_positions()
        assert rest.max() < 0.7
        time.sleep(0.3)
        assert np.abs(device.true_positions() - rest).max() < 0.01


def test_a_hand_that_takes_no_goals_any_more_is_a_fault():
    with emulated(answer_timeout=0.05) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.REFUSED)
        device.driver.command(device.near + 0.1)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "does not accept: angles" in device.driver.read().message


def test_late_answers_on_a_serial_line_are_not_taken_for_others():
    with emulated("rtu", answer_timeout=0.05) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.late = 0.07
        device.emulator.inject(Fault.LATE)
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            state = device.driver.read()
            assert state.status is DeviceStatus.READY and np.abs(state.positions - device.near).max() < 0.02
            device.driver.command(device.near)
            time.sleep(0.02)
        device.emulator.report_error(3, 1 << 3)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT, 2.0)


def test_a_line_that_was_lost_while_holding_still_opens_the_hand():
    with emulated(stale_after=0.3, answer_timeout=0.1) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.inject(Fault.STALLED)
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.DISCONNECTED)
        device.driver.stop(StopKind.OPEN)
        time.sleep(0.5)
        assert device.true_positions().min() > 0.3
        device.emulator.clear()
        assert wait_for(lambda: device.true_positions().max() < 0.01)
        state = device.driver.read()
        assert state.status is DeviceStatus.FAULT and "it answers again" in state.message


def test_a_hand_whose_process_has_died_is_led_by_another_one():
    plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    with InspireEmulator(plant, port=0) as emulator:
        settings = InspireSettings(emulator.address, emulator.port, stale_after=1.0)
        with LoopDriver(InspireLoop(settings)) as driver:
            device = DeviceUnderTest(driver, emulator, plant, np.full(6, 0.4), 0.01)
            for number, end in enumerate((signal.SIGKILL, signal.SIGSTOP)):
                reach(device, device.near)
                first = driver.process_id
                assert first is not None
                os.kill(first, end)
                assert wait_for(lambda: driver.read().status is not DeviceStatus.READY)
                driver.stop()
                assert wait_for(lambda: "another process controls" in driver.read().message)
                assert wait_for(lambda: driver.read().status is DeviceStatus.FAULT)
                assert np.abs(device.true_positions() - device.near).max() < 0.02
                if number:
                    driver.stop(StopKind.OPEN)
                    assert wait_for(lambda: device.true_positions().max() < 0.01)
                driver.connect()


def test_a_fault_counts_where_the_same_is_read_twice(monkeypatch: pytest.MonkeyPatch):
    loop = InspireLoop(InspireSettings(address="127.0.0.1"))
    hot, broken, stalled = ([bits, 0, 0] for bits in (0b00010, 0b01000, 0b00001))
    answers: list[list[int]] = []

    def read(self, address: int, count: int):
        return answers.pop(0) if address == codec.ERRORS else [500] * count

    monkeypatch.setattr(InspireLoop, "_read", read)
    for said, message in (
        ([hot, broken], ""),
        ([hot, [0, 0, 0]], ""),
        ([stalled], ""),
        ([hot, [a + b for a, b in zip(hot, stalled, strict=True)]], "little finger: too hot"),
    ):
        answers, loop._errors_due = said, 0.0
        assert loop._read_state().message == message and not answers


@pytest.mark.parametrize("protocol", ["tcp", "serial"])
def test_a_hand_that_is_looked_at_keeps_its_settings_and_its_errors(protocol: str):
    with emulated(protocol) as device:
        device.emulator.report_error(0, 1 << 1)
        before = dict(device.emulator._registers)
        device.driver.connect()
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        device.driver.stop()
        time.sleep(0.1)
        device.driver.close()
        written = (codec.CLEAR_ERRORS, codec.ANGLE_SET, codec.SPEED_SET, codec.FORCE_SET, codec.ERRORS)
        for register in written:
            assert device.emulator._registers.get(register) == before.get(register)
