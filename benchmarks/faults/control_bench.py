"""A robot cell of emulated devices, for measuring what they do when their computer fails."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.preparation import GraspPreparer, PreparedGrasp
from fungrasp.deployment.twin_deployment import reachable_placement
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.robots.assembly import arm_driver, hand_driver
from fungrasp.robots.cell import DeviceSettings, RobotCell
from fungrasp.robots.device import JointDriver
from fungrasp_emulators.allegro import AllegroEmulator
from fungrasp_emulators.devices import torque_controlled_fingers
from fungrasp_emulators.emulator import Emulator, Plant, PlantCommand
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.plants import ServoPlant, TorquePlant
from fungrasp_emulators.tracker import TrackerEmulator, TrackerErrors
from fungrasp_emulators.ur import URControllerEmulator

CONTROL = {
    "control-allegro": ("ur5e-allegro-emulated", "wine_glass"),
    "control-inspire": ("ur5e-inspire-emulated", "bowl"),
}
"""Robot cells whose computer may fail, by name, and a built-in object that each of them reaches."""


class ControlBench:
    """A cell's devices as emulators in this process, and a plan for them; a context manager."""

    def __init__(self, cell: RobotCell, grasp: RobotGraspSet, thing: ObjectModel, patience: float):
        """
        Args:
            cell: of a UR arm with an Allegro or an Inspire hand; its addresses are replaced.
            grasp: one.
            thing: its object.
            patience: times the usual limits of silence.

        Raises:
            FungraspError: the grasp can't be reached, or the cell can't be emulated.
        """
        hand = load_hand(cell.hand)
        placement = reachable_placement(cell, hand, thing, grasp)
        prepared = GraspPreparer(cell, hand, thing, MotionPlanner(hand, {thing.name: thing})).prepare(
            grasp, placement, np.asarray(cell.arm.home)
        )
        self.grasp = grasp
        self.prepared: PreparedGrasp = replace(prepared, corners=(prepared.reach.start,))
        self.cell = private_cell(cell, patience)
        self.arm_plant = ServoPlant(prepared.reach.start)
        fingers = prepared.start_fingers
        torque = cell.hand_device.driver == "allegro-can"
        self.hand_plant: ServoPlant | TorquePlant = (
            torque_controlled_fingers(fingers) if torque else ServoPlant(fingers, velocity=10.0)
        )
        arm: JointDriver = arm_driver(self.cell)
        fingers_driver: JointDriver = hand_driver(self.cell, hand)
        self.limits = {"arm": arm.limits.velocity, "hand": fingers_driver.limits.velocity}
        self.tracker = TrackerEmulator(
            lambda now: placement, self.cell.tracker.address, thing.name, TrackerErrors(delay=0.0)
        )
        self.arm, self.hand = _emulators(self.cell, self.arm_plant, self.hand_plant)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        for emulator in (self.arm, self.hand, self.tracker):
            self._stack.enter_context(emulator)
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def put_back(self) -> None:
        """Arm and hand where the plan starts, as a person would put them: a hand that kept its last torques
        is anywhere."""
        starts = self.prepared.reach.start, self.prepared.start_fingers
        for plant, start in zip((self.arm_plant, self.hand_plant), starts, strict=True):
            plant.apply(PlantCommand(), time.monotonic())
            plant.positions = start.copy()

    def hand_follows(self) -> bool:
        """Whether the hand's servos are on; an Inspire hand's always are."""
        return not isinstance(self.hand, AllegroEmulator) or self.hand.servos_on


def private_cell(cell: RobotCell, patience: float) -> RobotCell:
    """The cell with addresses that no other process has.

    Args:
        cell: of a UR arm with an Allegro or an Inspire hand.
        patience: times the usual limits of silence.

    Raises:
        FungraspError: the cell can't be emulated.
    """
    number = os.getpid()

    def patient(device: DeviceSettings, address: str) -> Any:
        options = dict(device.options)
        if "stale_after" in options:
            options["stale_after"] *= patience
        return replace(device, address=address, options=options)

    hands = {
        "allegro-can": str(20000 + number % 20000),
        "inspire": f"127.{number % 200 + 1}.0.5",
    }
    if cell.arm.driver != "ur-rtde" or cell.hand_device.driver not in hands:
        raise FungraspError(f"the devices of cell '{cell.name}' can't be emulated for this")
    dog = cell.watchdog
    return replace(
        cell,
        arm=patient(cell.arm, f"127.{number % 200 + 1}.0.4"),
        hand_device=patient(cell.hand_device, hands[cell.hand_device.driver]),
        tracker=replace(cell.tracker, address=f"ipc:///tmp/fungrasp-control-{number}"),
        watchdog=replace(
            dog,
            arm_silence=patience * dog.arm_silence,
            hand_silence=patience * dog.hand_silence,
            overrun=patience * dog.overrun,
        ),
    )


def _emulators(cell: RobotCell, arm: Plant, hand: Plant) -> tuple[URControllerEmulator, Emulator]:
    device, options = cell.hand_device, cell.hand_device.options
    controller = URControllerEmulator(arm, cell.arm.address)
    if device.driver == "inspire":
        return controller, InspireEmulator(hand, device.address, options.get("port", 6000))
    return controller, AllegroEmulator(
        hand, options["interface"], device.address, options.get("generation", 4), options.get("side", "right")
    )
