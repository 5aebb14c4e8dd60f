"""Small robots over the wire: an emulated UR controller and an emulated Inspire hand, for what goes wrong."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, Self

import numpy as np

from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.assembly import arm_driver, hand_driver
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.device import TrackedPose, TrackingStatus, WallClock
from fungrasp.robots.robot import Robot
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.plants import ServoPlant
from fungrasp_emulators.ur import URControllerEmulator

ADDRESSES = (f"127.1.{os.getpid() % 200 + 1}.{n}" for n in itertools.count(2))


class StillTracker:
    """Sees an object that stands still."""

    name = "tracker of a test"

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def read(self) -> TrackedPose:
        pose = np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0])
        return TrackedPose(pose, time.monotonic(), 1.0, TrackingStatus.TRACKING)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...


@dataclass
class EmulatedRobot:
    """A connected robot with what stands behind its wires."""

    robot: Robot
    arm: URControllerEmulator
    hand: InspireEmulator
    arm_plant: ServoPlant
    hand_plant: ServoPlant

    def postures(self) -> tuple[np.ndarray, np.ndarray]:
        """Where arm and hand really are [rad]."""
        now = time.monotonic()
        return self.arm_plant.state(now).positions, self.hand_plant.state(now).positions


@contextlib.contextmanager
def emulated_robot(**changes: Any) -> Iterator[EmulatedRobot]:
    """changes: of the cell."""
    cell = replace(emulated_cell(), **changes)
    hand = load_hand(cell.hand)
    arm_plant = ServoPlant(np.array(cell.arm.home), time_constant=0.02)
    hand_plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    with (
        URControllerEmulator(arm_plant, cell.arm.address, release_time=0.0) as arm,
        InspireEmulator(hand_plant, port=0) as fingers,
    ):
        options = {"port": fingers.port, "stale_after": 2.0, "answer_timeout": 0.5}
        device = replace(cell.hand_device, address=fingers.address, options=options)
        cell = replace(cell, hand_device=device)
        drivers = arm_driver(cell), hand_driver(cell, hand)
        robot = Robot(cell, hand, *drivers, StillTracker(), WallClock())
        with robot:
            yield EmulatedRobot(robot, arm, fingers, arm_plant, hand_plant)


def emulated_cell() -> RobotCell:
    """Patient with a busy computer."""
    cell = load_cell("ur5e-inspire-emulated")
    arm = replace(cell.arm, address=next(ADDRESSES), options={**cell.arm.options, "stale_after": 2.0})
    dog = replace(cell.watchdog, arm_silence=1.0, hand_silence=1.0, overrun=1.0)
    return replace(cell, arm=arm, watchdog=dog)


class MeanwhilePreparer:
    """A ``Preparer`` that has its plan already; while it plans, something happens."""

    objects: Mapping[str, ObjectModel] = {}

    def __init__(self, meanwhile: Callable[[], None]):
        self._meanwhile = meanwhile

    def prepare(self, grasp: Any, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0) -> Any:
        self._meanwhile()
        return SimpleNamespace(plan=None, start_fingers=np.full(6, 0.2), corners=(arm + 0.05,), behind=())


GRASP: Any = SimpleNamespace(object_name=np.array(["box"]))
"""In the place of a grasp."""
