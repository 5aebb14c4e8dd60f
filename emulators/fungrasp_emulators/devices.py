"""Every driver with an emulated device, by name."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.core.errors import UnknownNameError
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.hands.joint_order import hand_joint_limits
from fungrasp_emulators.emulator import Emulator, Plant
from fungrasp_emulators.plants import ServoPlant, TorquePlant

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
    stale_after: float
    """The driver's own limit of silence [s]."""


def emulated_ur(patience: float = 1.0) -> EmulatedDevice:
    """A UR5e; patience: times the driver's usual limit of silence."""
    from fungrasp.robots.arms.ur import URSettings, ur_driver
    from fungrasp_emulators.ur import URControllerEmulator

    address = f"127.{os.getpid() % 200 + 1}.0.2"
    home = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
    plant, settings = ServoPlant(home), _patient(URSettings(address), patience)
    emulator = URControllerEmulator(plant, address, release_time=0.0)
    emulator.start()
    return EmulatedDevice("ur", ur_driver(settings), emulator, plant, home, home + 0.4, settings.stale_after)


def emulated_allegro(generation: int, patience: float = 1.0) -> EmulatedDevice:
    """An Allegro Hand; generation: 4 or 5; patience: times the driver's usual limit of silence."""
    from fungrasp.robots.hands.allegro import AllegroSettings, allegro_driver
    from fungrasp_emulators.allegro import AllegroEmulator

    home, bus = np.full(16, 0.4), "loopback"
    channel = str(20000 + os.getpid() % 10000 + 10000 * (generation - 4))
    plant = torque_controlled_fingers(home)
    settings = _patient(AllegroSettings(bus, channel, generation), patience)
    emulator = AllegroEmulator(plant, bus, channel, generation)
    emulator.start()
    name = f"allegro v{generation}"
    return EmulatedDevice(
        name, allegro_driver(settings), emulator, plant, home, home + 0.3, settings.stale_after
    )


def emulated_inspire(protocol: str = "tcp", patience: float = 1.0) -> EmulatedDevice:
    """An Inspire RH56; protocol: "tcp" or, on a serial line, "rtu" or "serial"; patience: times the driver's
    usual limit of silence."""
    from fungrasp.robots.hands.inspire import InspireSettings, inspire_driver
    from fungrasp_emulators.inspire import InspireEmulator

    home = np.full(6, 0.2)
    plant = ServoPlant(home, velocity=10.0)
    emulator = InspireEmulator(plant, port=0, protocol=protocol)
    # The address is known only when the emulator listens.
    emulator.start()
    settings = InspireSettings(emulator.address, emulator.port, protocol=protocol)
    settings = _patient(settings, patience)
    name = {"tcp": "inspire, TCP", "rtu": "inspire, serial", "serial": "inspire, EB 90"}[protocol]
    return EmulatedDevice(
        name, inspire_driver(settings), emulator, plant, home, home + 0.3, settings.stale_after
    )


def emulated_leap(patience: float = 1.0) -> EmulatedDevice:
    """A LEAP hand; patience: times the driver's usual limit of silence."""
    from fungrasp.hands import load_hand
    from fungrasp.robots.hands.leap import LeapSettings, leap_driver
    from fungrasp_emulators.leap import DynamixelEmulator

    home = np.full(16, 0.1)
    plant = ServoPlant(home, velocity=8.0)
    emulator = DynamixelEmulator(plant, tuple(int(name) for name in load_hand("leap").actuators))
    emulator.start()
    settings = _patient(LeapSettings(emulator.address, build="full"), patience)
    return EmulatedDevice(
        "leap", leap_driver(settings), emulator, plant, home, home + 0.3, settings.stale_after
    )


def torque_controlled_fingers(positions: np.ndarray) -> TorquePlant:
    """Joints of a hand that is controlled by torques. Heavier and more damped than real ones, so that control
    is stable where a busy machine delays it by 10 ms: what is measured is when motion ends, not how a finger
    swings.

    They end at stops, as those of a hand do: one that keeps its torques while its host hears nothing would
    turn on and on.

    Args:
        positions: where they are [rad], shape [16], in the order of the Allegro hand.
    """
    lower, upper = hand_joint_limits("allegro", len(positions))
    return TorquePlant(
        positions,
        inertia=0.01,
        friction=0.01,
        damping=0.2,
        lower=lower - STOPS,
        upper=upper + STOPS,
    )


def _patient(settings: Any, patience: float) -> Any:
    return dataclasses.replace(settings, stale_after=patience * settings.stale_after)


EMULATED: Mapping[str, Callable[[float], EmulatedDevice]] = {
    "ur": emulated_ur,
    "allegro-v4": lambda patience: emulated_allegro(4, patience),
    "allegro-v5": lambda patience: emulated_allegro(5, patience),
    "inspire": lambda patience: emulated_inspire("tcp", patience),
    "inspire-serial": lambda patience: emulated_inspire("rtu", patience),
    "inspire-eb90": lambda patience: emulated_inspire("serial", patience),
    "leap": emulated_leap,
}
"""By name on the command line; the argument: times the driver's usual limit of silence."""


def known_devices(names: tuple[str, ...], more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The names, or all that there are.

    Args:
        names: some devices' names.
        more: names that are allowed besides those of ``EMULATED``.

    Raises:
        UnknownNameError: there is none of that name.
    """
    for name in names:
        if name not in (*EMULATED, *more):
            raise UnknownNameError("device", name, (*EMULATED, *more))
    return names or (*EMULATED, *more)
