"""A robot cell on the loopback: the emulators of its wires, with one twin behind them."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any, Self

from fungrasp.core.errors import FungraspError
from fungrasp.robots.cell import ArmSettings, DeviceSettings, RobotCell
from fungrasp.robots.pose.stream import PosePublisher
from fungrasp.robots.twin.devices import RealTimeTwin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp_emulators.allegro import AllegroEmulator
from fungrasp_emulators.emulator import Emulator, PlantCommand, PlantState
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.leap import DynamixelEmulator
from fungrasp_emulators.ur import URControllerEmulator

POLL = 0.005
"""Time between two looks for a new frame of the tracker [s]."""


class CellEmulation:
    """Starts what a cell's drivers look for; a context manager."""

    def __init__(self, cell: RobotCell, world: TwinWorld, object_name: str):
        """
        Args:
            cell: whose drivers and addresses are emulated, all of them on this machine.
            object_name: what the tracker says it follows.

        Raises:
            FungraspError: a driver that can't be emulated.
        """
        self._cell, self._world, self._object = cell, world, object_name
        self.arm: Emulator = _arm(cell.arm, world)
        """Emulator of the arm, for faults."""
        self.hand: Emulator = _hand(cell.hand_device, world)
        """Emulator of the hand, for faults."""
        if cell.tracker.driver != "pose-stream":
            raise FungraspError(f"a tracker with the driver '{cell.tracker.driver}' can't be emulated")
        self._end = threading.Event()
        self._stack = ExitStack()
        self.twin = RealTimeTwin(world)
        """What advances the twin."""

    def __enter__(self) -> Self:
        stack = self._stack
        stack.enter_context(self.twin)
        publisher = PosePublisher(self._cell.tracker.address, self._object)
        stack.callback(publisher.close)
        thread = threading.Thread(target=self._publish, args=(publisher,), daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(self._end.set)
        stack.enter_context(self.arm)
        stack.enter_context(self.hand)
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def _publish(self, publisher: PosePublisher) -> None:
        """Every frame that the tracker delivers, once."""
        last: Any = None
        while not self._end.wait(POLL):
            frame = self._world.tracked()
            if frame is not None and frame is not last:
                publisher.publish(frame.pose_world_object, frame.captured, frame.score, frame.status)
                last = frame


def _arm(device: ArmSettings, world: TwinWorld) -> Emulator:
    if device.driver != "ur-rtde":
        raise FungraspError(f"an arm with the driver '{device.driver}' can't be emulated")
    version = (3, 15, 0) if device.model == "ur5" else (5, 11, 0)
    return URControllerEmulator(TwinArmPlant(world), _loopback(device), version)


def _hand(device: DeviceSettings, world: TwinWorld) -> Emulator:
    plant, options = TwinHandPlant(world), device.options
    if device.driver == "allegro-can":
        if options.get("interface") not in ("loopback", "virtual"):
            raise FungraspError(
                'an emulated Allegro hand needs the option interface = "loopback": there is no CAN bus'
            )
        return AllegroEmulator(
            plant,
            options["interface"],
            device.address,
            options.get("generation", 4),
            options.get("side", "right"),
        )
    if device.driver == "inspire":
        return InspireEmulator(plant, _loopback(device), options.get("port", 6000))
    if device.driver == "leap-dynamixel":
        if not device.address.startswith("/tmp/"):
            raise FungraspError(
                f"an emulated LEAP hand is at a link that is made in /tmp, and not '{device.address}'"
            )
        servos = tuple(int(name) for name in world.hand.actuators)
        return DynamixelEmulator(plant, servos, path=device.address, build=options.get("build", "full"))
    raise FungraspError(f"a hand with the driver '{device.driver}' can't be emulated")


def _loopback(device: DeviceSettings) -> str:
    """The address, if it is one of this machine's loopback: emulators never listen on a network."""
    if not device.address.startswith("127."):
        raise FungraspError(
            f"emulators listen on the loopback only, and '{device.address}' is not on it: copy the cell's "
            "file and give addresses such as 127.0.0.2"
        )
    return device.address


class TwinArmPlant:
    """The arm's joints."""

    def __init__(self, world: TwinWorld):
        self._world = world

    def apply(self, command: PlantCommand, now: float) -> None:
        """See ``Plant.apply``. Without positions the arm keeps its last target: brakes."""
        if command.positions is not None:
            self._world.command_arm(command.positions)

    def state(self, now: float) -> PlantState:
        return PlantState(*self._world.arm_state())


class TwinHandPlant:
    """The hand's independent joints."""

    def __init__(self, world: TwinWorld):
        self._world = world

    def apply(self, command: PlantCommand, now: float) -> None:
        self._world.powered = command.positions is not None or command.torques is not None
        if command.torques is not None:
            self._world.command_torques(command.torques)
        elif command.positions is not None:
            self._world.command_hand(command.positions)

    def state(self, now: float) -> PlantState:
        return PlantState(*self._world.hand_state())
