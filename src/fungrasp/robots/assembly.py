"""Robots from cell files. Drivers have names; other packages can add drivers by entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.records import record_from_json
from fungrasp.hands import Hand
from fungrasp.robots.cell import DeviceSettings, RobotCell, check_calibrated
from fungrasp.robots.control_loop.loop_driver import LoopDriver
from fungrasp.robots.device import JointDriver, PoseSource, WallClock
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.parameters import twin_torque_limits
from fungrasp.sim2real.joint_dynamics import HandDynamics, JointDynamics, load_dynamics

OWN = "fungrasp"
"""Distribution of the built-in drivers."""

TWIN = "twin"
"""Driver of a twin's device, in the same process; reserved."""


@dataclass(frozen=True)
class DriverRegistry:
    """Drivers of one kind of device. A driver is a callable that makes a device from a cell."""

    what: str
    """Kind of device, as in cell files: "arm", "hand_device" or "tracker"."""
    group: str
    """Group of the entry points."""
    own: Mapping[str, Callable[[RobotCell], Any]]
    """Built-in drivers by name."""
    protocol: type
    """Interface of the devices: ``JointDriver`` or ``PoseSource``."""

    def known(self) -> dict[str, str]:
        """Return the distribution of each driver by name; several, with commas, if names clash."""
        found = dict.fromkeys((*self.own, TWIN), OWN)
        for entry in entry_points(group=self.group):
            origin = _distribution(entry)
            found[entry.name] = f"{found[entry.name]}, {origin}" if entry.name in found else origin
        return dict(sorted(found.items()))

    def make(self, name: str, cell: RobotCell) -> Any:
        """Make the device of a cell. Raises: FungraspError: no driver or several drivers of this name, or one
        that can't be loaded or used; the message names the distribution."""
        entries = [entry for entry in entry_points(group=self.group) if entry.name == name]
        if len(entries) + (name in (*self.own, TWIN)) > 1:
            raise FungraspError(
                f"'{self.what}.driver': '{name}' is provided by several packages, {self.known()[name]}: "
                "uninstall all but one"
            )
        if name not in self.own and not entries:
            error = UnknownNameError("driver", name, self.known())
            raise FungraspError(f"'{self.what}.driver': {error}")
        try:
            return self.own[name](cell) if name in self.own else self._make_of_others(entries[0], cell)
        except FungraspError as error:
            raise FungraspError(f"[{self.what}] {error}") from error

    def _make_of_others(self, entry: EntryPoint, cell: RobotCell) -> Any:
        origin = f"the driver '{entry.name}' of the package {_distribution(entry)}"
        try:
            driver = entry.load()
        except Exception as error:
            # The import of a third-party module may raise anything.
            raise FungraspError(f"{origin} can't be loaded: {_line(error)}") from error
        try:
            device = driver(cell)
        except FungraspError:
            raise
        except Exception as error:
            raise FungraspError(f"{origin} can't be made from cell '{cell.name}': {_line(error)}") from error
        missing = [name for name in _members(self.protocol) if not hasattr(device, name)]
        if missing:
            raise FungraspError(f"{origin} is no {self.protocol.__name__}: it has no '{missing[0]}'")
        return device


def _members(protocol: type) -> list[str]:
    names = [name for name in vars(protocol) if not name.startswith("_")]
    return [*protocol.__annotations__, *names]


def _distribution(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else entry.value


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


CAMERA = "realsense"
"""Driver of the built-in tracker with a RealSense camera."""


def is_twin(cell: RobotCell) -> bool:
    """Return whether a cell is a twin. Raises: FungraspError: only some of its devices are."""
    drivers = {"arm": cell.arm.driver, "hand_device": cell.hand_device.driver, "tracker": cell.tracker.driver}
    twins = [name for name, driver in drivers.items() if driver == TWIN]
    if twins and len(twins) < len(drivers):
        raise FungraspError(
            f"cell '{cell.name}': {', '.join(twins)} can't be a twin while the others are not; "
            "use emulators for the others ('fungrasp robots emulate')"
        )
    return bool(twins)


def arm_driver(cell: RobotCell) -> JointDriver:
    """Make the driver of a cell's arm without a safety filter, for reading only. Raises: FungraspError: no
    such driver, bad options, or a wrong number of joints."""
    driver = ARM_DRIVERS.make(cell.arm.driver, cell)
    joints = len(driver.limits.lower)
    if joints != len(cell.arm.home):
        raise FungraspError(
            f"cell '{cell.name}': the driver '{cell.arm.driver}' moves {joints} joints, and 'arm.home' has "
            f"{len(cell.arm.home)}: one of the two is wrong"
        )
    return driver


def hand_driver(cell: RobotCell, hand: Hand) -> JointDriver:
    """Make the driver of a cell's hand without a safety filter, for reading only. Raises: FungraspError: no
    such driver, bad options, or a driver of another hand."""
    driver = HAND_DRIVERS.make(cell.hand_device.driver, cell)
    joints = len(driver.limits.lower)
    if joints != len(hand.actuators):
        raise FungraspError(
            f"cell '{cell.name}': hand '{hand.name}' has {len(hand.actuators)} servos, but the driver "
            f"'{cell.hand_device.driver}' moves {joints}: one of the two is wrong"
        )
    return driver


def pose_source(cell: RobotCell) -> PoseSource:
    """Make the source of a cell's object poses. Raises: FungraspError: no such driver, or bad options."""
    return TRACKERS.make(cell.tracker.driver, cell)


def driver_torque_limits(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Return the largest torques that a cell's driver requests from the hand's servos [N m], shape [U];
    infinite if only the hand limits them. Nothing is connected. Raises what ``hand_driver`` raises."""
    if cell.hand_device.driver == TWIN:
        return twin_torque_limits(cell, hand)
    return hand_driver(cell, hand).limits.torque


def limited_hand(cell: RobotCell, hand: Hand, dynamics: JointDynamics | None = None) -> Hand:
    """Return the hand for planners, with the torque limits of the model or of the identified dynamics, and at
    most those of the cell's driver.

    Args:
        dynamics: identified dynamics, whose torque limits replace the model's where they are known.

    Raises:
        FungraspError: as ``driver_torque_limits``, or a servo has no torque left.
    """
    limits = driver_torque_limits(cell, hand)
    servos = {}
    for i, (name, servo) in enumerate(hand.actuators.items()):
        own = servo.force_limit
        if dynamics is not None and dynamics.torque_limit is not None and name in dynamics.joints:
            own = float(dynamics.torque_limit[dynamics.joints.index(name)])
        largest = min(own, float(limits[i]))
        if not largest > 0:
            raise FungraspError(
                f"cell '{cell.name}': no torque is left to '{name}': look at the options of the hand's "
                "driver and at the file of its dynamics"
            )
        servos[name] = replace(servo, force_limit=largest)
    return replace(hand, actuators=servos)


def identified_dynamics(
    cell: RobotCell, hand: Hand, file: str | Path = ""
) -> tuple[Hand, HandDynamics | None]:
    """Return the hand of a cell for planners (``limited_hand``), and its identified dynamics, None without.
    file: file of identified dynamics instead of the cell's. Raises: FungraspError: the file can't be read, or
    as ``limited_hand``."""
    path = file or cell.hand_dynamics
    if not path:
        return limited_hand(cell, hand), None
    found = load_dynamics(path, hand)
    return limited_hand(cell, hand, found), HandDynamics.of(hand, found)


def wired_robot(cell: RobotCell, hand: Hand, **options: Any) -> Robot:
    """Make the robot of a cell that is no twin, not connected. options: of ``Robot``. Raises: FungraspError:
    an unknown driver, bad options of a device, or another hand."""
    devices = arm_driver(cell), hand_driver(cell, hand), pose_source(cell)
    return Robot(cell, hand, *devices, WallClock(), **options)


def _own(module: str, name: str, part: str, address: str = "address") -> Callable[..., Any]:
    """Return a function that makes a built-in driver, and imports its module only then.

    Args:
        module: module in ``fungrasp.robots`` with the classes ``<name>Settings`` and ``<name>Loop``.
        part: part of the cell with address and options: "arm" or "hand_device".
        address: name of the address in the settings.
    """

    def make(cell: RobotCell) -> LoopDriver:
        found, device = import_module(f"fungrasp.robots.{module}"), getattr(cell, part)
        model = {"arm": cell.arm.model} if part == "arm" else {"hand": cell.hand}
        settings = _options(getattr(found, f"{name}Settings"), device, {address: device.address, **model})
        return LoopDriver(getattr(found, f"{name}Loop")(settings))

    return make


@dataclass(frozen=True)
class _CameraOptions:
    object: str = ""
    mass: float | None = None
    folder: str | None = None
    width: int = 640
    height: int = 480
    rate: int = 30


def _camera(cell: RobotCell) -> PoseSource:
    """Make the built-in tracker with a RealSense camera."""
    from fungrasp.objects import load_object
    from fungrasp.perception.io.realsense import RealSenseCamera, StreamSettings
    from fungrasp.robots.pose.camera import CameraTracker

    check_calibrated(cell)
    asked: _CameraOptions = _options(_CameraOptions, cell.tracker)
    if not asked.object:
        raise FungraspError(f"cell '{cell.name}': the driver {CAMERA} needs the option 'object', a name")
    obj = load_object(asked.object, asked.mass, asked.folder)
    stream = StreamSettings(asked.width, asked.height, asked.rate)
    camera = RealSenseCamera(serial=cell.tracker.address, stream=stream)
    return CameraTracker(camera, obj, np.array(cell.tracker.pose_world_camera))


@dataclass(frozen=True)
class _StreamOptions:
    object_name: str = ""
    frame: str = "world"
    timeout: float = 2.0


def _stream(cell: RobotCell) -> PoseSource:
    """Make a stream of poses from another process."""
    from fungrasp.robots.pose.stream import PoseStream

    asked: _StreamOptions = _options(_StreamOptions, cell.tracker)
    camera = None
    if asked.frame == "camera":
        check_calibrated(cell)
        camera = np.array(cell.tracker.pose_world_camera)
    return PoseStream(cell.tracker.address, **vars(asked), pose_world_camera=camera)


def _options(kind: type, device: DeviceSettings, given: Mapping[str, Any] | None = None) -> Any:
    """Make the settings of a driver from the options of a cell.

    Args:
        kind: dataclass of the settings.
        given: values from elsewhere in the cell; empty ones are left out, and options override them.
    """
    known = {name: value for name, value in (given or {}).items() if value != ""}
    return record_from_json(kind, {**known, **device.options}, f"options of the driver {device.driver}")


ARM_DRIVERS = DriverRegistry(
    "arm",
    "fungrasp.arm_drivers",
    {"ur-rtde": _own("arms.ur", "UR", "arm")},
    JointDriver,
)
"""Drivers of arms."""

HAND_DRIVERS = DriverRegistry(
    "hand_device",
    "fungrasp.hand_drivers",
    {
        "allegro-can": _own("hands.allegro", "Allegro", "hand_device", "channel"),
        "inspire": _own("hands.inspire", "Inspire", "hand_device"),
        "leap-dynamixel": _own("hands.leap", "Leap", "hand_device", "port"),
    },
    JointDriver,
)
"""Drivers of hands."""

TRACKERS = DriverRegistry(
    "tracker", "fungrasp.pose_sources", {"pose-stream": _stream, CAMERA: _camera}, PoseSource
)
"""Sources of object poses."""
