"""Frames of other programs beside ours, recorded: of Dynamixel's SDK, of pymodbus as published Inspire
clients call it, and of ur_rtde's own example of servoj."""

from __future__ import annotations

import itertools
import os
import struct
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from driver_contract import wait_for
from loop_thread import LoopThread

from fungrasp.hands import load_hand
from fungrasp.robots.arms.ur import URLoop, URSettings
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.hands import inspire_link as inspire
from fungrasp.robots.hands import leap as dynamixel
from fungrasp.robots.hands.leap import LeapLoop, LeapSettings
from fungrasp_emulators import leap as wire
from fungrasp_emulators import modbus, rtde
from fungrasp_emulators.leap import DynamixelEmulator
from fungrasp_emulators.plants import ServoPlant
from fungrasp_emulators.ur import URControllerEmulator

HOME = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
ADDRESSES = (f"127.2.{os.getpid() % 200 + 1}.{n}" for n in itertools.count(2))

SDK_FRAMES = {
    # dynamixel-sdk 3.8.4 and 4.1.0 (PyPI), PacketHandler(2.0), GroupSyncRead and GroupSyncWrite: the same.
    "ping 1": "fffffd000103000119 4e",
    "read 4 bytes at 132 of 7": "fffffd0007070002 84000400 0975",
    "torque on 3": "fffffd0003060003 4000 01 f8e4",
    "goal -1 of 3": "fffffd0003090003 7400 ffffffff e3c9",
    "gain of the side joints": "fffffd00fe100083 5400 0200 00c201 04c201 08c201 e20a",
    "goals of 0 and 1": "fffffd00fe110083 7400 0400 0000080000 01fffffdff 7e20",
    "present of all": "fffffd00fe170082 7e00 0a00 000102030405060708090a0b0c0d0e0f e03d",
}
PACKETS = {
    "ping 1": wire.ServoPacket(1, wire.PING, b""),
    "read 4 bytes at 132 of 7": wire.ServoPacket(7, wire.READ, struct.pack("<HH", 132, 4)),
    "torque on 3": wire.ServoPacket(3, wire.WRITE, struct.pack("<HB", 64, 1)),
    "goal -1 of 3": wire.ServoPacket(3, wire.WRITE, struct.pack("<Hi", 116, -1)),
    "gain of the side joints": wire.ServoPacket(
        wire.BROADCAST,
        wire.SYNC_WRITE,
        struct.pack("<HH", 84, 2) + b"".join(struct.pack("<BH", servo, 450) for servo in (0, 4, 8)),
    ),
    "goals of 0 and 1": wire.ServoPacket(
        wire.BROADCAST,
        wire.SYNC_WRITE,
        struct.pack("<HH", 116, 4) + struct.pack("<Bi", 0, 2048) + b"\x01\xff\xff\xfd\xff",
    ),
    "present of all": wire.ServoPacket(
        wire.BROADCAST, wire.SYNC_READ, struct.pack("<HH", 126, 10) + bytes(range(16))
    ),
}


# The SDK for Python makes the stuffed packet and then sends the other one: an FF FF FD within parameters,
# after which the protocol wants another FD, goes out as it is.
UNSTUFFED = {"goals of 0 and 1"}


@pytest.mark.parametrize("name", PACKETS)
def test_servo_packets_are_those_of_the_sdk(name: str):
    frame, packet = bytes.fromhex(SDK_FRAMES[name]), PACKETS[name]
    assert wire.split_servo_packets(frame) == ([packet], b"")
    if name in UNSTUFFED:
        ours = wire.encode_packet(packet)
        assert len(ours) == len(frame) + 1 and b"\xff\xff\xfd\xfd" in ours
    else:
        assert wire.encode_packet(packet) == frame


def test_goals_of_a_leap_hand_never_need_the_byte_that_the_sdk_leaves_out():
    hand = load_hand("leap")
    for bound in hand.independent(hand.joint_limits.T):
        assert all(0 <= count < 4096 for count in dynamixel.position_counts(bound))


LEAP_API = (
    # leap-hand/LEAP_Hand_API, python/main.py, in its order: address, size, value, value of servos 0, 4, 8.
    (dynamixel.OPERATING_MODE, 1, 5, 5),
    (dynamixel.TORQUE_ENABLE, 1, 1, 1),
    (dynamixel.P_GAIN, 2, 600, 450),
    (dynamixel.I_GAIN, 2, 0, 0),
    (dynamixel.D_GAIN, 2, 200, 150),
    (dynamixel.GOAL_CURRENT, 2, 350, 350),
    (dynamixel.GOAL_POSITION, 4, 2048, 2048),
)


def test_a_leap_hand_is_left_with_the_registers_of_the_makers_program():
    sdk = pytest.importorskip("dynamixel_sdk")
    plants = [ServoPlant(np.zeros(16), time_constant=0.02) for _ in range(2)]
    servos = tuple(int(name) for name in load_hand("leap").actuators)
    with DynamixelEmulator(plants[0], servos) as theirs, DynamixelEmulator(plants[1], servos) as ours:
        port = sdk.PortHandler(theirs.address)
        assert port.setBaudRate(4_000_000)
        for address, size, value, side in LEAP_API:
            writer = sdk.GroupSyncWrite(port, sdk.PacketHandler(2.0), address, size)
            for servo in range(16):
                number = side if servo in (0, 4, 8) else value
                writer.addParam(servo, number.to_bytes(size, "little"))
            writer.txPacket()
        assert wait_for(lambda: theirs.register(15, dynamixel.GOAL_POSITION) == 2048)
        port.closePort()
        settings = LeapSettings(ours.address, build="lite", stale_after=2.0)
        with LoopDriver(LeapLoop(settings), LoopThread) as driver:
            driver.command(np.zeros(16))
            assert wait_for(lambda: ours.torque_on)
        for servo, (address, *_) in itertools.product(range(16), LEAP_API):
            assert ours.register(servo, address) == theirs.register(servo, address), (servo, address)


MODBUS_FRAMES = {
    # pymodbus 3.16.1, as published clients call it: inspire_hand_ws (laurent-19 and others) reads and writes
    # six registers at once; CLEAR_ERROR is written by function 6 (one register) or 16.
    "read_holding_registers(1546, count=6)": "0001 0000 0006 01 03 060a 0006",
    "write_registers(1486, [1000] * 6)": "0001 0000 0013 01 10 05ce 0006 0c 03e803e803e803e803e803e8",
    "write_registers(1522, [500] * 6)": "0001 0000 0013 01 10 05f2 0006 0c 01f401f401f401f401f401f4",
    "write_register(1004, 1)": "0001 0000 0006 01 06 03ec 0001",
}
REQUESTS = {
    "read_holding_registers(1546, count=6)": modbus.RegisterRequest(modbus.READ, inspire.ANGLE_ACTUAL, 6),
    "write_registers(1486, [1000] * 6)": modbus.RegisterRequest(
        modbus.WRITE, inspire.ANGLE_SET, 6, (1000,) * 6
    ),
    "write_registers(1522, [500] * 6)": modbus.RegisterRequest(
        modbus.WRITE, inspire.SPEED_SET, 6, (500,) * 6
    ),
    "write_register(1004, 1)": modbus.RegisterRequest(modbus.WRITE_ONE, inspire.CLEAR_ERRORS, 1, (1,)),
}


@pytest.mark.parametrize("call", MODBUS_FRAMES)
def test_modbus_frames_of_published_inspire_clients(call: str):
    frame = bytes.fromhex(MODBUS_FRAMES[call])
    ((transaction, device, content),), rest = modbus.split_tcp_requests(frame)
    assert (transaction, device, rest) == (1, 1, b"")
    assert modbus.decode_request(content) == REQUESTS[call]


UR_SERVOJ, UR_SERVO_STOP, UR_STOP, UR_WATCHDOG = 11, 16, 255, 35
UR_FRAMES = {
    # ur_rtde 1.6.5, the servoj example of its documentation: command, and the package's content.
    "first servoJ": (
        UR_SERVOJ,
        "02 0000000b 0000000000000000 bff8000000000000 3ff8000000000000 bff8000000000000 bff8000000000000"
        "0000000000000000 3fe0000000000000 3fe0000000000000 3f60624dd2f1a9fc 3fb999999999999a"
        "4072c00000000000",
    ),
    "servoStop": (UR_SERVO_STOP, "08 00000010 4024000000000000"),
    "stopScript": (UR_STOP, "04 000000ff"),
}
JOINT_REGISTERS = tuple(f"input_double_register_{i}" for i in range(6))
UR_EXAMPLE = """
import sys
import rtde_control

control = rtde_control.RTDEControlInterface(sys.argv[1], 125.0)
joints = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
for _ in range(40):
    start = control.initPeriod()
    control.servoJ(joints, 0.5, 0.5, 1 / 500, 0.1, 300)
    joints[0] += 0.001
    joints[1] += 0.001
    control.waitPeriod(start)
control.servoStop()
control.stopScript()
"""
"""As the example of ur_rtde's documentation does: setpoints 1 mrad apart on two joints, then both stops."""


class RecordingController(URControllerEmulator):
    """Keeps what it is told."""

    def __init__(self, *arguments: Any, **more: Any):
        super().__init__(*arguments, **more)
        self.inputs: list[bytes] = []
        self.packages: list[tuple[float, bytes, dict[str, Any]]] = []

    def _take_package(self, client: Any, kind: bytes, content: bytes) -> None:
        if kind == rtde.SETUP_INPUTS:
            self.inputs.append(content)
        elif kind == rtde.DATA:
            values = rtde.decode_values(client.inputs[content[0] - 1], content[1:])
            self.packages.append((time.monotonic(), content, values))
        super()._take_package(client, kind, content)

    def commands(self, number: int) -> list[tuple[float, bytes, dict[str, Any]]]:
        """Packages of a command."""
        return [package for package in self.packages if package[2].get("input_int_register_0") == number]


def test_our_driver_writes_the_registers_of_ur_rtdes_example():
    for module in ("rtde_control", "ruckig"):
        pytest.importorskip(module)
    addresses = next(ADDRESSES), next(ADDRESSES)
    plants = [ServoPlant(HOME, time_constant=0.02) for _ in range(2)]
    with RecordingController(plants[0], addresses[0]) as theirs:
        words = [sys.executable, "-c", UR_EXAMPLE, addresses[0]]
        subprocess.run(words, check=True, timeout=60, capture_output=True)
    goal = HOME + np.array([0.04, 0.04, 0.0, 0.0, 0.0, 0.0])
    with RecordingController(plants[1], addresses[1]) as ours:
        # 1 mrad in 2 ms, as the example.
        driver = LoopDriver(URLoop(URSettings(addresses[1], stale_after=2.0, velocity=0.5)))
        with driver:
            driver.command(goal)
            assert wait_for(lambda: np.abs(driver.command(goal) - driver.read().positions).max() < 1e-3)
        assert wait_for(lambda: not ours.program_running)
    # Both set up the same recipes, so that a number stands for the same registers.
    assert ours.inputs == theirs.inputs
    for name, (command, text) in UR_FRAMES.items():
        first, mine = theirs.commands(command)[0], ours.commands(command)[0]
        assert name == "servoStop" or first[1] == bytes.fromhex(text)
        assert mine[1][0] == first[1][0] and len(mine[1]) == len(first[1])
        assert list(mine[2]) == list(first[2])
    # The example has no watchdog, and its first setpoint of motion is at full speed; ours are within limits.
    assert not theirs.commands(UR_WATCHDOG)
    assert ours.commands(UR_WATCHDOG)[0][2]["input_double_register_0"] == 5.0
    streams = [
        np.array([[values[name] for name in JOINT_REGISTERS] for _, _, values in side.commands(UR_SERVOJ)])
        for side in (theirs, ours)
    ]
    assert np.allclose(np.diff(streams[0], axis=0)[:, :2], 0.001)
    speeds = np.diff(streams[1], axis=0, prepend=HOME[None]) / 0.002
    accelerations = np.diff(speeds, axis=0, prepend=0.0) / 0.002
    assert np.abs(speeds).max() <= 0.5 + 1e-6 and np.abs(accelerations).max() <= 2.5 + 1e-6
    assert np.allclose(streams[1][-1], goal, atol=1e-3) and np.allclose(streams[1][:, 2:], HOME[2:])
    last = ours.commands(UR_SERVOJ)[-1][2]
    assert [last[f"input_double_register_{i}"] for i in range(6, 11)] == [0.0, 0.0, 0.002, 0.05, 300.0]
