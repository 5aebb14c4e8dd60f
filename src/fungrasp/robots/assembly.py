"""A robot from its cell file. Drivers have names: this package's own, and those that other installed packages
bring by entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_origin, get_type_hints

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands import Hand
from fungrasp.robots.cell import DeviceSettings, RobotCell, check_calibrated
from fungrasp.robots.device import JointDriver, PoseSource, WallClock
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.parameters import twin_torque_limits
from fungrasp.sim2real.joint_dynamics import JointDynamics

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
        """The device of a cell.

        Raises:
            FungraspError: no driver has this name, several have, or it can't be loaded or used; the message
                names the distribution.
        """
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
    """Whether a cell is a twin in the same process.

    Raises:
        FungraspError: some of its devices are, others are not.
    """
    drivers = {"arm": cell.arm.driver, "hand_device": cell.hand_device.driver, "tracker": cell.tracker.driver}
    twins = [name for name, driver in drivers.items() if driver == TWIN]
    if twins and len(twins) < len(drivers):
        raise FungraspError(
            f"cell '{cell.name}': {', '.join(twins)} can't be a twin while the others are not; "
            "use emulators for the others ('fungrasp robots emulate')"
        )
    return bool(twins)


def arm_driver(cell: RobotCell) -> JointDriver:
    """The driver of a cell's arm, without a guard: to look at. What moves is ``wired_robot``'s.

    Raises:
        FungraspError: no such driver, or bad options.
    """
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
    ``guarded_driver``'s.

    Raises:
        FungraspError: no such driver, bad options, or a driver of another hand.
    """
    driver = HAND_DRIVERS.make(cell.hand_device.driver, cell)
    joints = len(driver.limits.lower)
    if joints != len(hand.actuators):
        raise FungraspError(
            f"cell '{cell.name}': hand '{hand.name}' has {len(hand.actuators)} servos, but the driver "
            f"'{cell.hand_device.driver}' moves {joints}: one of the two is wrong"
        )
    return driver


def pose_source(cell: RobotCell) -> PoseSource:
    """The source of a cell's object poses.

    Raises:
        FungraspError: no such driver, or bad options.
    """
    return TRACKERS.make(cell.tracker.driver, cell)


def driver_torque_limits(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Largest torques that a cell's driver asks of its hand's servos [N m], shape [U]; infinite where it
    leaves that to the hand. Nothing is connected.

    Raises:
        FungraspError: the cell's driver of the hand, or its options, can't be.
    """
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


def wired_robot(
    cell: RobotCell,
    hand: Hand,
    *,
    stiffness: np.ndarray | None = None,
    compensate: bool = True,
    dry_run: bool = False,
    switch: StopSwitch | None = None,
) -> Robot:
    """The robot of a cell, not connected.

    Args:
        cell: the robot; no twin.
        stiffness: identified stiffness of the hand's servos [N m/rad], shape [U]; the model's if None.
        compensate: whether the hand's own weight is carried.
        switch: stops the robot; that of the cell's stop file if None.

    Raises:
        FungraspError: an unknown driver, bad options, or another hand.
    """
    return Robot(
        cell,
        hand,
        arm_driver(cell),
        hand_driver(cell, hand),
        pose_source(cell),
        WallClock(),
        stiffness=stiffness,
        compensate=compensate,
        dry_run=dry_run,
        switch=switch,
    )


def _ur(cell: RobotCell) -> JointDriver:
    from fungrasp.robots.arms.ur import URSettings, ur_driver

    return ur_driver(_settings(URSettings, cell.arm, arm=cell.arm.model))


def _allegro(cell: RobotCell) -> JointDriver:
    from fungrasp.robots.hands.allegro import AllegroSettings, allegro_driver

    return allegro_driver(_settings(AllegroSettings, cell.hand_device, "channel", hand=cell.hand))


def _inspire(cell: RobotCell) -> JointDriver:
    from fungrasp.robots.hands.inspire import InspireSettings, inspire_driver

    return inspire_driver(_settings(InspireSettings, cell.hand_device, hand=cell.hand))


def _leap(cell: RobotCell) -> JointDriver:
    from fungrasp.robots.hands.leap import LeapSettings, leap_driver

    return leap_driver(_settings(LeapSettings, cell.hand_device, "port", hand=cell.hand))


def _camera(cell: RobotCell) -> PoseSource:
    """Our own tracker on a RealSense camera: options ``object`` and, for a mesh, ``mass`` and ``folder``."""
    from fungrasp.objects import load_object
    from fungrasp.robots.pose.camera import CameraTracker, RealSenseFrames

    check_calibrated(cell)
    options = dict(cell.tracker.options)
    known = ("object", "mass", "folder", "width", "height", "rate")
    for name in options:
        if name not in known:
            raise UnknownNameError(f"option of the driver {CAMERA}", name, known)
    if not isinstance(options.get("object"), str):
        raise FungraspError(f"cell '{cell.name}': the driver {CAMERA} needs the option 'object', a name")
    obj = load_object(options.pop("object"), options.pop("mass", None), options.pop("folder", None))
    frames = RealSenseFrames(cell.tracker.address, **options)
    return CameraTracker(frames, obj, np.array(cell.tracker.pose_world_camera))


def _stream(cell: RobotCell) -> PoseSource:
    """Poses of another process: options ``object_name``, ``frame`` and ``timeout``."""
    from fungrasp.robots.pose.stream import PoseStream

    options = dict(cell.tracker.options)
    known = ("object_name", "frame", "timeout")
    for name in options:
        if name not in known:
            raise UnknownNameError("option of the driver pose-stream", name, known)
    camera = None
    if options.get("frame") == "camera":
        check_calibrated(cell)
        camera = np.array(cell.tracker.pose_world_camera)
    return PoseStream(cell.tracker.address, **options, pose_world_camera=camera)


OPTION_TYPES: dict[type, tuple[tuple[type, ...], str]] = {
    float: ((int, float), "a number"),
    int: ((int,), "a whole number"),
    str: ((str,), "a text"),
    tuple: ((list, tuple), "a list of numbers"),
}
"""What a cell's file says for a field of a driver's settings, by the field's type."""


def _settings(kind: type, device: DeviceSettings, address: str = "address", **more: str) -> Any:
    """Settings of a driver from the address and the options of a cell.

    Args:
        more: values that the cell says elsewhere; options may say another one.
    """
    given: dict[str, Any] = {address: device.address, **more, **device.options}
    given = {name: value for name, value in given.items() if value != ""}
    known = [f.name for f in fields(kind)]
    hints = get_type_hints(kind)
    for name, value in given.items():
        if name not in known:
            raise UnknownNameError(f"option of the driver {device.driver}", name, known)
        allowed, words = OPTION_TYPES[get_origin(hints[name]) or hints[name]]
        numbers = value if isinstance(value, list | tuple) else ()
        fits = isinstance(value, allowed) and all(isinstance(v, int | float) for v in numbers)
        if not fits or isinstance(value, bool):
            raise FungraspError(f"the option '{name}' must be {words}, not {value!r}")
    return kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in given.items()})


ARM_DRIVERS = DriverRegistry("arm", "fungrasp.arm_drivers", {"ur-rtde": _ur}, TWIN, JointDriver)
"""Drivers of arms."""

HAND_DRIVERS = DriverRegistry(
    "hand_device",
    "fungrasp.hand_drivers",
    {"allegro-can": _allegro, "inspire": _inspire, "leap-dynamixel": _leap},
    TWIN,
    JointDriver,
)
"""Drivers of hands."""

TRACKERS = DriverRegistry(
    "tracker", "fungrasp.pose_sources", {"pose-stream": _stream, CAMERA: _camera}, TWIN, PoseSource
)
"""Sources of object poses."""
