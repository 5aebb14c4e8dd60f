"""Numbers of a cell that are in another unit, or that can't be where they are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.geometry.poses import invert, transform_points

if TYPE_CHECKING:
    from fungrasp.robots.cell import RobotCell

METERS, SECONDS = ("meters", "m", "mm", 1e-3), ("seconds", "s", "ms", 1e-3)
RADIANS, RADIANS_PER_SECOND = (
    ("radians", "rad", "degrees", np.pi / 180),
    ("rad/s", "rad/s", "degrees/s", np.pi / 180),
)
LARGEST = {
    "arm.pose_world_base": (5.0, METERS),
    "tracker.pose_world_camera": (5.0, METERS),
    "mount.pose_flange_hand": (0.5, METERS),
    "mount.adapter_radius": (0.3, METERS),
    "mount.adapter_length": (0.5, METERS),
    "workspace.lower": (5.0, METERS),
    "workspace.upper": (5.0, METERS),
    "workspace.hand_depth": (0.1, METERS),
    "obstacles.center": (10.0, METERS),
    "obstacles.size": (20.0, METERS),
    "limits.goal_distance": (2.0, METERS),
    "limits.hand_speed": (20.0, RADIANS_PER_SECOND),
    "watchdog.arm_silence": (5.0, SECONDS),
    "watchdog.hand_silence": (5.0, SECONDS),
    "watchdog.pose_stale": (5.0, SECONDS),
    "watchdog.overrun": (5.0, SECONDS),
    "watchdog.pose_jump": (0.5, METERS),
    "watchdog.pose_turn": (np.pi, RADIANS),
}
"""Numbers beyond these are in another unit, by our judgment, as a UR5 reaches 0.95 m; and a limit in another
unit would be none. With the unit's name, its sign, the other unit that is likely, and how large that is."""
BASE_AXIS = np.array([[0.0, 0.0, z] for z in (0.02, 0.08, 0.14)])
"""Points within an arm's base and shoulder, on its first axis [m]; the pedestal below ends at zero."""


def unit_faults(cell: RobotCell) -> list[str]:
    """What must be a mistake of units or of frames in a cell, one phrase each."""
    faults = []
    for name, values in _numbers(cell):
        largest = float(np.abs(values).max(initial=0.0))
        most, (unit, sign, other, size) = LARGEST[name]
        if largest > most:
            faults.append(
                f"'{name}' is in {unit}, and {largest:g} {sign} can't be: is it {largest:g} {other}, "
                f"{largest * size:.4g} {sign}?"
            )
    turned = max((abs(q) for q in cell.arm.home), default=0.0)
    if turned > 2 * np.pi:
        faults.append(
            f"'arm.home' is in radians, and {turned:g} is beyond a whole turn: is it {turned:g} degrees, "
            f"{np.deg2rad(turned):.4f} rad?"
        )
    payload = cell.arm.options.get("payload", 0.0)
    if isinstance(payload, int | float) and payload > 20.0:
        faults.append(
            f"'arm.options.payload' is in kilograms, and {payload:g} kg can't be: is it {payload:g} g?"
        )
    return faults


def obstacle_faults(cell: RobotCell) -> list[str]:
    """Obstacles that go through the arm's own base, one phrase each."""
    base = np.array(cell.arm.pose_world_base)
    faults = []
    for number, box in enumerate(cell.obstacles, 1):
        frame = np.array([*box.center, *box.rotation])
        points = transform_points(invert(frame), transform_points(base, BASE_AXIS))
        if (np.abs(points) < np.array(box.size) / 2).all(axis=1).any():
            faults.append(
                f"obstacle {number} goes through the arm's base: 'center' is the middle of the box in the "
                "world, and a pedestal ends at the height of 'arm.pose_world_base'"
            )
    return faults


def _numbers(cell: RobotCell) -> Iterator[tuple[str, np.ndarray]]:
    """What ``LARGEST`` is about, by name, each of shape [M]; of poses the position."""
    for name in LARGEST:
        section, _, key = name.partition(".")
        part = getattr(cell, section)
        for one in part if isinstance(part, tuple) else (part,):
            values = np.atleast_1d(np.array(getattr(one, key), dtype=float))
            yield name, values[:3] if key.startswith("pose_") else values
