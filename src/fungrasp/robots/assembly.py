"""A robot from its cell file. Drivers have names: this package's own, and those that other installed packages
bring by entry points."""

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
"""Name of the distribution that this package's own drivers come from."""


@dataclass(frozen=True)
class DriverRegistry:
    """Drivers of one kind of device. A driver is a callable that makes a device from a cell."""

    what: str
    """The device, as in a cell's file: "arm", "hand_device" or "tracker"."""
    group: str
    """Group of the entry points."""
    own: Mapping[str, Callable[[RobotCell], Any]]
    """This package's, by name."""
    twin: str
    """Name that stands for a device of a twin, which nobody else's may have."""
    protocol: type
    """What a driver makes: ``JointDriver`` or ``PoseSource``."""

    def known(self) -> dict[str, str]:
        """Distribution of each driver by name; several, with commas, where their names clash."""
        found = dict.fromkeys((*self.own, self.twin), OWN)
        for entry in entry_points(group=self.group):
            origin = _distribution(entry)
            found[entry.name] = f"{found[entry.name]}, {origin}" if entry.name in found else origin
        return dict(sorted(found.items()))

    def make(self, name: str, cell: RobotCell) -> Any:
        """The device of a cell. Raises: FungraspError: no driver has this name, several have, or it can't be
        loaded or used; the message names the distribution."""
        entries = [entry for entry in entry_points(group=self.group) if entry.name == name]
        if len(entries) + (name in (*self.own, self.twin)) > 1:
            raise FungraspError(
                f"'{self.what}.driver': '{name}' is brought by several packages, {self.known()[name]}: "
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
            # Whatever a module of others does when it is imported.
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


TWIN = "twin"
"""Driver of a device of a twin in the same process."""

CAMERA = "realsense"
"""Driver of a tracker: our own, on the images of a RealSense camera."""


def is_twin(cell: RobotCell) -> bool:
    """Whether a cell is a twin in the same process. Raises: FungraspError: some of its devices are, others
    are not."""
    drivers = {"arm": cell.arm.driver, "hand_device": cell.hand_device.driver, "tracker": cell.tracker.driver}
    twins = [name for name, driver in drivers.items() if driver == TWIN]
    if twins and len(twins) < len(drivers):
        raise FungraspError(
            f"cell '{cell.name}': {', '.join(twins)} can't be a twin while the others are not; "
            "use emulators for the others ('fungrasp robots emulate')"
        )
    return bool(twins)


def arm_driver(cell: RobotCell) -> JointDriver:
    """The driver of a cell's arm, without a guard: to look at. What moves is ``wired_robot``'s. Raises:
    FungraspError: no such driver, or bad options."""
    driver = ARM_DRIVERS.make(cell.arm.driver, cell)
    joints = len(driver.limits.lower)
    if joints != len(cell.arm.home):
        raise FungraspError(
            f"cell '{cell.name}': the driver '{cell.arm.driver}' moves {joints} joints, and 'arm.home' has "
            f"{len(cell.arm.home)}: one of the two is wrong"
        )
    return driver


def hand_driver(cell: RobotCell, hand: Hand) -> JointDriver:
    """The driver of a cell's hand, without a guard: to look at. What moves is ``wired_robot``'s or
    ``guarded_driver``'s. Raises: FungraspError: no such driver, bad options, or a driver of another hand."""
    driver = HAND_DRIVERS.make(cell.hand_device.driver, cell)
    joints = len(driver.limits.lower)
    if joints != len(hand.actuators):
        raise FungraspError(
            f"cell '{cell.name}': hand '{hand.name}' has {len(hand.actuators)} servos, but the driver "
            f"'{cell.hand_device.driver}' moves {joints}: one of the two is wrong"
        )
    return driver


def pose_source(cell: RobotCell) -> PoseSource:
    """The source of a cell's object poses. Raises: FungraspError: no such driver, or bad options."""
    return TRACKERS.make(cell.tracker.driver, cell)


def driver_torque_limits(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Largest torques that a cell's driver asks of its hand's servos [N m], shape [U]; infinite where it
    leaves that to the hand. Nothing is connected. Raises: FungraspError: the cell's driver of the hand, or
    its options, can't be."""
    if cell.hand_device.driver == TWIN:
        return twin_torque_limits(cell, hand)
    return hand_driver(cell, hand).limits.torque


def limited_hand(cell: RobotCell, hand: Hand, dynamics: JointDynamics | None = None) -> Hand:
    """The hand as a planner has to know it: no servo makes more torque than its model says, or the file of
    identified dynamics where that says it, nor more than the cell's driver sends.

    Args:
        dynamics: identified; their torque limits replace the model's, where they have some.

    Raises:
        FungraspError: as ``driver_torque_limits``, or no torque is left to a servo.
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
    """What a cell says of its hand beyond the model: for planner, policy and gravity compensation. file: of
    identified dynamics, in place of the cell's. Returns: the hand for planners, whose servos make no more
    torque than the robot's; and what was identified, None where nothing was. Raises: FungraspError: the file
    can't be read, or the cell's driver of the hand can't be."""
    path = file or cell.hand_dynamics
    if not path:
        return limited_hand(cell, hand), None
    found = load_dynamics(path, hand)
    return limited_hand(cell, hand, found), HandDynamics.of(hand, found)


def wired_robot(cell: RobotCell, hand: Hand, **options: Any) -> Robot:
    """The robot of a cell that is no twin, not connected. options: of ``Robot``. Raises: FungraspError: an
    unknown driver, bad options of a device, or another hand."""
    devices = arm_driver(cell), hand_driver(cell, hand), pose_source(cell)
    return Robot(cell, hand, *devices, WallClock(), **options)


def _own(module: str, name: str, part: str, address: str = "address") -> Callable[..., Any]:
    """A driver of this package, whose module is imported when it is made.

    Args:
        module: of ``fungrasp.robots``, with the classes ``nameSettings`` and ``nameLoop``.
        part: of the cell, which has address and options: "arm" or "hand_device".
        address: what the settings call the address.
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
    """Our own tracker on a RealSense camera."""
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
    """Poses of another process."""
    from fungrasp.robots.pose.stream import PoseStream

    asked: _StreamOptions = _options(_StreamOptions, cell.tracker)
    camera = None
    if asked.frame == "camera":
        check_calibrated(cell)
        camera = np.array(cell.tracker.pose_world_camera)
    return PoseStream(cell.tracker.address, **vars(asked), pose_world_camera=camera)


def _options(kind: type, device: DeviceSettings, given: Mapping[str, Any] | None = None) -> Any:
    """Settings of a driver from the options of a cell.

    Args:
        kind: a dataclass.
        given: what the cell says elsewhere, unless it is empty; options may say another one.
    """
    known = {name: value for name, value in (given or {}).items() if value != ""}
    return record_from_json(kind, {**known, **device.options}, f"options of the driver {device.driver}")


ARM_DRIVERS = DriverRegistry(
    "arm",
    "fungrasp.arm_drivers",
    {"ur-rtde": _own("arms.ur", "UR", "arm")},
    TWIN,
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
    TWIN,
    JointDriver,
)
"""Drivers of hands."""

TRACKERS = DriverRegistry(
    "tracker", "fungrasp.pose_sources", {"pose-stream": _stream, CAMERA: _camera}, TWIN, PoseSource
)
"""Sources of object poses."""
