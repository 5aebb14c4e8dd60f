"""Every driver with an emulated device, by name: for tests, and to measure what a driver costs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.core.errors import UnknownNameError
from fungrasp.hands import load_hand
from fungrasp.robots.arms.ur import URSettings, ur_driver
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.hands.allegro import AllegroSettings, allegro_driver
from fungrasp.robots.hands.inspire import InspireSettings, inspire_driver
from fungrasp.robots.hands.joint_order import hand_joint_limits
from fungrasp.robots.hands.leap import LeapSettings, leap_driver
from fungrasp_emulators.allegro import AllegroEmulator
from fungrasp_emulators.emulator import Emulator, Plant
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.leap import DynamixelEmulator
from fungrasp_emulators.plants import ServoPlant, TorquePlant
from fungrasp_emulators.ur import URControllerEmulator

STOPS = 0.1
"""How far the stops of emulated fingers lie beyond the limits of their joints [rad]."""


@dataclass
class EmulatedDevice:
    """A driver, not connected, and the device that it will talk to, started."""

    name: str
    """Of the driver."""
    driver: LoopDriver
    """Driver in a process of its own, as on a robot."""
    emulator: Emulator
    """The device; it lives in the calling process."""
    plant: Plant
    """Its joints."""
    home: np.ndarray
    """Where the joints are [rad], shape [U]."""
    away: np.ndarray
    """Another place [rad], shape [U]."""


def emulated_device(name: str, patience: float = 1.0) -> EmulatedDevice:
    """A device and its driver.

    Args:
        name: one of ``EMULATED``.
        patience: times the driver's usual limit of silence.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in EMULATED:
        raise UnknownNameError("device", name, EMULATED)
    make, emulator, settings, plant, home = EMULATED[name]()
    emulator.start()
    if isinstance(emulator, InspireEmulator):
        # Address and port are known only when it listens.
        settings = replace(settings, address=emulator.address, port=emulator.port)
    if isinstance(emulator, DynamixelEmulator):
        settings = replace(settings, port=emulator.address)
    driver = make(replace(settings, stale_after=patience * settings.stale_after))
    return EmulatedDevice(name, driver, emulator, plant, home, home + 0.3)


_Parts = tuple[Callable[[Any], LoopDriver], Emulator, Any, Plant, np.ndarray]


def _ur() -> _Parts:
    address, home = f"127.{os.getpid() % 200 + 1}.0.2", np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
    plant = ServoPlant(home)
    return ur_driver, URControllerEmulator(plant, address, release_time=0.0), URSettings(address), plant, home


def _allegro(generation: int) -> _Parts:
    home, channel = np.full(16, 0.4), str(20000 + os.getpid() % 10000 + 10000 * (generation - 4))
    plant, settings = torque_controlled_fingers(home), AllegroSettings("loopback", channel, generation)
    return allegro_driver, AllegroEmulator(plant, "loopback", channel, generation), settings, plant, home


def _inspire(protocol: str) -> _Parts:
    home = np.full(6, 0.2)
    plant = ServoPlant(home, velocity=10.0)
    emulator = InspireEmulator(plant, port=0, protocol=protocol)
    address = "127.0.0.1" if protocol == "tcp" else "/dev/tty"
    return inspire_driver, emulator, InspireSettings(address, protocol=protocol), plant, home


def _leap() -> _Parts:
    home = np.full(16, 0.1)
    plant = ServoPlant(home, velocity=8.0)
    servos = tuple(int(name) for name in load_hand("leap").actuators)
    return leap_driver, DynamixelEmulator(plant, servos), LeapSettings(build="full"), plant, home


EMULATED: Mapping[str, Callable[[], _Parts]] = {
    "ur": _ur,
    "allegro-v4": lambda: _allegro(4),
    "allegro-v5": lambda: _allegro(5),
    "inspire": lambda: _inspire("tcp"),
    "inspire-serial": lambda: _inspire("rtu"),
    "inspire-eb90": lambda: _inspire("serial"),
    "leap": _leap,
}
"""By name on the command line."""


def torque_controlled_fingers(positions: np.ndarray) -> TorquePlant:
    """Joints of a hand that is controlled by torques. Heavier and more damped than real ones, so that control
    is stable where a busy machine delays it by 10 ms: what is measured is when motion ends, not how a finger
    swings. They end at stops, as those of a hand do: one that keeps its torques while its host hears nothing
    would turn on and on.

    Args:
        positions: where they are [rad], shape [16], in the order of the Allegro hand.
    """
    lower, upper = hand_joint_limits("allegro", len(positions))
    joints = TorquePlant(positions, inertia=0.01, friction=0.01, damping=0.2)
    joints.lower, joints.upper = lower - STOPS, upper + STOPS
    return joints
