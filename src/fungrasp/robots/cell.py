"""Robot cells: a TOML file with the devices, their poses, and the limits of their motion."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import atomic_path, check_suffix
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.text_files import read_toml
from fungrasp.core.records import record_from_json
from fungrasp.hands.arm import Mount, arm_spec

Vector = tuple[float, ...]
Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""Rotation, wxyz."""

SHIPPED = Path(__file__).parent / "cells"
"""Folder of the built-in cells."""

NEW_CELL = SHIPPED / "new.template"
"""Template of ``write_new_cell``."""

PLANNED = ("palm_speed", "palm_rotation_speed", "arm_speed", "hand_speed")
PLANNED += ("palm_acceleration", "palm_rotation_acceleration")
"""Limits that determine the speed of plans."""

LARGEST = {
    "limits.palm_speed": (0.25, "m/s"),
    "limits.palm_acceleration": (0.3, "m/s^2"),
    "limits.palm_rotation_speed": (1.0, "rad/s"),
    "limits.arm_speed": (3.14, "rad/s"),
    "limits.setpoint_acceleration": (400.0, "rad/s^2"),
    "limits.setpoint_lead": (0.35, "rad"),
    "arm.home": (2 * np.pi, "rad"),
    "arm.pose_world_base tracker.pose_world_camera workspace.lower workspace.upper": (5.0, "m"),
    "mount.pose_flange_hand mount.adapter_length watchdog.pose_jump": (0.5, "m"),
    "mount.adapter_radius": (0.3, "m"),
    "workspace.hand_depth": (0.1, "m"),
    "obstacles.center": (10.0, "m"),
    "obstacles.size": (20.0, "m"),
    "limits.goal_distance": (2.0, "m"),
    "limits.hand_speed": (20.0, "rad/s"),
    "watchdog.arm_silence watchdog.hand_silence watchdog.pose_stale watchdog.overrun": (5.0, "s"),
    "watchdog.pose_turn": (np.pi, "rad"),
}
"""Largest numbers of a cell, and their units. Limits are from the paper and the data sheets, the others are
our estimates. A larger number must be in another unit, in which a limit would have no effect."""

UPRIGHT: Vector = (1.0, 0.0, 0.0, 0.0)

LARGEST_RESIDUAL = 0.005
"""Residual beyond which the calibration of a camera is refused [m]."""

REAL_ARM_OPTIONS = {
    "velocity": (3.14, "rad/s"),
    "acceleration": (10.0, "rad/s^2"),
    "jerk": (200.0, "rad/s^3"),
    "payload": (20.0, "kg"),
}
"""Largest options of a real arm's driver, and their units. The velocity is from the data sheet; acceleration
and jerk are four times the driver's defaults. Emulators may have more."""


@dataclass(frozen=True)
class DeviceSettings:
    """Driver and address of a device."""

    driver: str = "twin"
    """Name of the driver (``fungrasp.robots.assembly``)."""
    address: str = ""
    """Host name, CAN channel or serial port, depending on the driver."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the driver."""


@dataclass(frozen=True)
class ArmSettings(DeviceSettings):
    """The arm."""

    model: str = "ur5e"
    """Name of the arm's model, or an MJCF file, relative to the cell's file."""
    pose_world_base: Vector = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    """Pose of the arm's base, world frame [m], wxyz; the table top is z = 0. The base is ROS's ``base_link``:
    z up, turned by 180 degrees about z from the frame "Base" on a UR's pendant."""
    home: Vector = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
    """Joints of the home posture [rad]."""


@dataclass(frozen=True)
class TrackerSettings(DeviceSettings):
    """The tracker of the object's pose."""

    pose_world_camera: Vector = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    """Pose of the camera, world frame, from calibration."""
    calibration_residual: float = -1.0
    """Residual of the calibration [m]; negative without calibration."""
    calibration: str = ""
    """File of ``fungrasp robots calibrate``, relative to the cell's file, that gives both; "" for none."""


@dataclass(frozen=True)
class Workspace:
    """Box for the palm, and distances from the table."""

    lower: Point = (-0.5, -0.5, 0.0)
    """Lower corner of the box, world frame [m]."""
    upper: Point = (0.5, 0.5, 0.9)
    """Upper corner of the box, world frame [m]."""
    table_clearance: float = 0.005
    """Smallest distance of the arm from the table [m]."""
    hand_depth: float = -0.005
    """Depth to which the hand may reach below the table top [m]; negative to stay above, as in first runs.
    Twins and emulators have 0.012: for thin objects, hands touch the table, and their servos yield."""


@dataclass(frozen=True)
class Obstacle:
    """A box that the robot keeps clear of: a pedestal, a wall, a camera's post."""

    center: Point
    """Center, world frame [m]."""
    size: Point
    """Full edge lengths [m]."""
    rotation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Rotation, world frame, wxyz."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of all commanded motions."""

    palm_speed: float = 0.25
    """Largest speed of the palm [m/s] (section V.A of the paper)."""
    palm_acceleration: float = 0.3
    """Largest acceleration of the palm [m/s^2]."""
    palm_rotation_speed: float = 1.0
    """Largest angular speed of the palm [rad/s]."""
    palm_rotation_acceleration: float = 2.0
    """Largest angular acceleration of the palm [rad/s^2]: wrist joints turn up to 1.3 times as fast, and the
    driver of the arm allows 2.5 rad/s^2."""
    arm_speed: float = 2.0
    """Largest speed of an arm joint [rad/s]."""
    arm_acceleration: float = 2.0
    """Largest acceleration of an arm joint between postures [rad/s^2]."""
    setpoint_acceleration: float = 400.0
    """Acceleration of an arm joint beyond which a setpoint is refused [rad/s^2]. The driver smooths setpoints
    within the arm's own limits."""
    hand_speed: float = 6.0
    """Largest speed of a hand joint's setpoint [rad/s]."""
    hand_torque: float = 3.0
    """Largest measured torque of a hand joint [N m]."""
    goal_distance: float = 0.3
    """Largest distance of a policy's palm goal from the measured palm [m]."""
    setpoint_lead: float = 0.35
    """Largest difference between an arm's setpoint and its measured joints [rad]."""


@dataclass(frozen=True)
class Watchdog:
    """Thresholds at which the robot stops (``fungrasp.robots.safety``). Tracked poses are checked until the
    fingers close."""

    arm_silence: float = 0.04
    """Longest time without a new time stamp from the arm [s]."""
    hand_silence: float = 0.1
    """Longest time without a new time stamp from the hand [s]."""
    pose_stale: float = 0.5
    """Largest age of the tracked pose [s]."""
    pose_jump: float = 0.02
    """Largest displacement of the tracked object since planning [m]."""
    pose_turn: float = 0.52
    """Largest turn of the tracked object since planning [rad]: trackers may flip symmetric objects."""
    pose_score: float = 0.1
    """Smallest confidence of the tracker, 0 to 1."""
    late_tick: float = 0.02
    """Delay beyond which a tick counts as late and is not made up for [s]; the robot does not stop."""
    overrun: float = 0.25
    """Largest delay of a setpoint [s]."""


@dataclass(frozen=True)
class RobotCell:
    """A robot cell. World frame: z up, the table top is z = 0."""

    hand: str
    """Name of the hand, or the path of its TOML file."""
    name: str = "cell"
    """Name for logs and messages."""
    arm: ArmSettings = field(default_factory=ArmSettings)
    """The arm."""
    mount: Mount = field(default_factory=Mount)
    """Mount of the hand on the flange; required for real devices."""
    hand_device: DeviceSettings = field(default_factory=DeviceSettings)
    """The hand's device."""
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    """The tracker."""
    workspace: Workspace = field(default_factory=Workspace)
    """Box for the palm."""
    limits: MotionLimits = field(default_factory=MotionLimits)
    """Limits of motion."""
    watchdog: Watchdog = field(default_factory=Watchdog)
    """Thresholds at which the robot stops."""
    obstacles: tuple[Obstacle, ...] = ()
    """Boxes (``[[obstacles]]``) from which arm and hand keep ``workspace.table_clearance``; the arm's base
    and shoulder may touch them."""
    hand_dynamics: str = ""
    """File with identified dynamics of the hand (``fungrasp identify fit``), relative to the cell's file; ""
    for none."""
    stop_file: str = ""
    """File, relative to the cell's file, that stops the robot as soon as it exists; "" for none."""


def cell_files() -> dict[str, Path]:
    """Return the files of the built-in cells, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


@guarded("cell file")
def load_cell(name: str | Path) -> RobotCell:
    """Read and check a cell. name: a built-in cell, or a TOML file. Raises: FungraspError: no such cell, or
    an invalid one."""
    path = Path(name)
    if path.suffix != ".toml":
        if str(name) not in cell_files():
            raise UnknownNameError("robot cell", str(name), cell_files())
        path = cell_files()[str(name)]
    values = read_toml(path, "cell file")
    if values.get("guard") == "on":
        # Old cells have this entry.
        del values["guard"]
    cell = record_from_json(RobotCell, values, str(path))
    if cell.tracker.calibration:
        file = path.parent / cell.tracker.calibration
        known = {**vars(cell.tracker), **_calibration(file)}
        cell = replace(cell, tracker=record_from_json(TrackerSettings, known, str(file)))
    if cell.arm.model.endswith(".xml"):
        cell = replace(cell, arm=replace(cell.arm, model=str((path.parent / cell.arm.model).absolute())))
    for fault in cell_faults(cell):
        raise FungraspError(f"{path}: {fault}")
    if cell.stop_file:
        # A person makes this file from another terminal, perhaps in another folder.
        cell = replace(cell, stop_file=str((path.parent / cell.stop_file).absolute()))
    if cell.hand_dynamics:
        dynamics = path.parent / cell.hand_dynamics
        if not dynamics.is_file():
            raise FungraspError(f"{path}: there is no file '{dynamics}': run 'fungrasp identify fit'")
        cell = replace(cell, hand_dynamics=str(dynamics))
    return cell


def write_new_cell(path: str | Path, hand: str) -> None:
    """Write a slow cell for a new robot. Values that must be measured are left empty, and are refused until
    they are set. path: TOML file, which must not exist. Raises: FungraspError: the file exists or is no TOML
    file, or the hand has no driver."""
    path = check_suffix(path, "a cell", ".toml")
    # Lines of a hand follow "#: name"; the rest follows "#: end".
    head, *parts = re.split(r"^#: (\w+)\n", NEW_CELL.read_text(encoding="utf-8"), flags=re.MULTILINE)
    devices = dict(zip(parts[::2], parts[1::2], strict=True))
    rest = devices.pop("end")
    if hand not in devices:
        raise UnknownNameError("hand with a driver", hand, devices)
    if path.exists():
        raise FungraspError(f"{path} already exists")
    text = (head + devices[hand] + rest).replace("HAND", hand).replace("NAME", path.stem)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_calibrated(cell: RobotCell) -> None:
    """Raises: FungraspError: the camera of the cell is not calibrated."""
    if cell.tracker.calibration_residual < 0:
        raise FungraspError(
            f"cell '{cell.name}': no calibration of the camera: run 'fungrasp robots calibrate' and name its "
            "file as 'calibration' under [tracker]"
        )


def plan_speed(limits: MotionLimits) -> float:
    """Return the largest speed of plans within a cell's limits, as a share of their own speed, which is that
    of the default limits. Speeds are proportional to this share, accelerations to its square."""
    return min(1.0, *(_planned_share(limits, name) for name in PLANNED))


def slowest_limit(limits: MotionLimits) -> str:
    """Return the limit that determines ``plan_speed``, as a phrase: "limits.palm_speed = 0.05"."""
    lowest = min(PLANNED, key=lambda name: _planned_share(limits, name))
    return f"limits.{lowest} = {getattr(limits, lowest):g}"


def _planned_share(limits: MotionLimits, name: str) -> float:
    share = getattr(limits, name) / getattr(MotionLimits, name)
    return share**0.5 if name.endswith("acceleration") else share


def is_wired(cell: RobotCell) -> bool:
    """Return whether a cell's arm is real: neither a twin nor an emulator, which has a loopback address."""
    return cell.arm.driver != "twin" and not cell.arm.address.startswith("127.")


def cell_faults(cell: RobotCell) -> list[str]:
    """Return the faults of a cell, one phrase each."""
    faults = _limit_faults(cell)
    box, mount, residual = cell.workspace, cell.mount, cell.tracker.calibration_residual
    if not all(a < b for a, b in zip(box.lower, box.upper, strict=True)):
        faults.append("'workspace.lower' must be below 'workspace.upper' along all axes")
    if residual > LARGEST_RESIDUAL:
        faults.append(
            f"'tracker.calibration_residual' is {1e3 * residual:.1f} mm, more than "
            f"{1e3 * LARGEST_RESIDUAL:g} mm: calibrate the camera again"
        )
    if is_wired(cell):
        faults += _wired_faults(cell)
    if min(mount.adapter_radius, mount.adapter_length) < 0 or (
        (mount.adapter_radius > 0) != (mount.adapter_length > 0)
    ):
        faults.append("'mount.adapter_radius' and 'mount.adapter_length' go together, and are positive")
    for name, pose in (
        ("arm.pose_world_base", cell.arm.pose_world_base),
        ("tracker.pose_world_camera", cell.tracker.pose_world_camera),
        ("mount.pose_flange_hand", mount.pose_flange_hand or (0.0, 0.0, 0.0, *UPRIGHT)),
    ):
        if len(pose) != 7 or not _unit(pose[3:]):
            faults.append(f"'{name}' must be 3 meters and a unit quaternion wxyz, not {list(pose)}")
    if len(cell.arm.home) == 0:
        faults.append("'arm.home' is missing: joints where the arm waits [rad]")
    for number, one in enumerate(cell.obstacles, 1):
        if min(one.size) <= 0 or not _unit(one.rotation):
            faults.append(f"obstacle {number} needs a size of positive numbers and a unit quaternion wxyz")
    try:
        arm_spec(cell.arm.model)
    except FungraspError as error:
        faults.append(str(error))
    if cell.watchdog.late_tick >= cell.watchdog.overrun:
        faults.append("'watchdog.overrun' must be greater than 'watchdog.late_tick'")
    return faults


def _limit_faults(cell: RobotCell) -> list[str]:
    faults = []
    for section in (cell.limits, cell.watchdog):
        for f in fields(section):
            value = getattr(section, f.name)
            if not (np.isfinite(value) and value > 0):
                faults.append(f"'{f.name}' must be positive, not {value:g}")
    for names, (most, unit) in LARGEST.items():
        for name in names.split():
            section, _, key = name.partition(".")
            part = getattr(cell, section)
            for one in part if isinstance(part, tuple) else (part,):
                values = np.atleast_1d(np.array(getattr(one, key), dtype=float))
                # Only the position of a pose is limited.
                values = np.abs(values[:3] if key.startswith("pose_") else values)
                faults += _too_large(name, values.max(initial=0.0), most, unit)
    return faults


def _too_large(name: str, value: float, most: float, unit: str) -> list[str]:
    if value <= most:
        return []
    return [f"'{name}' is in {unit} and may be at most {most:.4g}, not {value:g}"]


def _wired_faults(cell: RobotCell) -> list[str]:
    """Return the faults of a cell of real devices."""
    faults = []
    if not cell.arm.address:
        faults.append("'arm.address' is missing: where the arm's controller is")
    for name, (most, unit) in REAL_ARM_OPTIONS.items():
        value = cell.arm.options.get(name, 0.0)
        if isinstance(value, int | float):
            faults += _too_large(f"arm.options.{name}", value, most, unit)
    if not cell.mount.pose_flange_hand:
        faults.append(
            "'mount.pose_flange_hand' is missing: where the hand is on the flange of this arm, 3 meters and "
            "a unit quaternion wxyz"
        )
    return faults


def _unit(quaternion: Vector) -> bool:
    return bool(np.isclose(np.linalg.norm(quaternion), 1.0, atol=1e-3))


def _calibration(path: Path) -> dict[str, Any]:
    """Read pose and residual of a calibration."""
    tree = read_toml(path, "calibration of a camera")
    names = "pose_world_camera", "calibration_residual"
    missing = [name for name in names if name not in tree]
    if missing:
        raise FungraspError(f"{path}: '{missing[0]}' is missing: run 'fungrasp robots calibrate' again")
    return {name: tree[name] for name in names}
