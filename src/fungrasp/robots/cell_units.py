"""Numbers of a cell that are in another unit, or that can't be where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fungrasp.geometry.poses import invert, transform_points

if TYPE_CHECKING:
    from fungrasp.robots.cell import RobotCell

FARTHEST = {
    "arm.pose_world_base": 5.0,
    "tracker.pose_world_camera": 5.0,
    "mount.pose_flange_hand": 0.5,
    "mount.adapter_radius": 0.3,
    "mount.adapter_length": 0.5,
    "workspace.lower": 5.0,
    "workspace.upper": 5.0,
    "obstacles.center": 10.0,
    "obstacles.size": 20.0,
}
"""Lengths beyond these [m] are millimeters or centimeters, by our judgment: a UR5 reaches 0.95 m."""
LARGEST = {
    "watchdog.arm_silence": (5.0, "s", "ms", 1e-3),
    "watchdog.hand_silence": (5.0, "s", "ms", 1e-3),
    "watchdog.pose_stale": (5.0, "s", "ms", 1e-3),
    "watchdog.overrun": (5.0, "s", "ms", 1e-3),
    "watchdog.pose_jump": (0.5, "m", "mm", 1e-3),
    "watchdog.pose_turn": (np.pi, "rad", "degrees", np.pi / 180),
    "limits.goal_distance": (2.0, "m", "mm", 1e-3),
    "limits.hand_speed": (20.0, "rad/s", "degrees/s", np.pi / 180),
    "workspace.hand_depth": (0.1, "m", "mm", 1e-3),
}
"""Most that each can be, its unit, the one it must be in beyond that, and its size, by our judgment: a limit
in another unit would be no limit."""
BASE_AXIS = np.array([[0.0, 0.0, z] for z in (0.02, 0.08, 0.14)])
"""Points within an arm's base and shoulder, on its first axis [m]; the pedestal below ends at zero."""


def unit_faults(cell: RobotCell) -> list[str]:
    """What must be a mistake of units or of frames in a cell, one phrase each."""
    faults = []
    for name, values in _lengths(cell):
        largest = max((abs(v) for v in values), default=0.0)
        if largest > FARTHEST[name]:
            faults.append(
                f"'{name}' is in meters, and {largest:g} m can't be: is it {largest:g} mm, "
                f"{largest / 1e3:g} m?"
            )
    for name, (most, unit, other, size) in LARGEST.items():
        section, _, key = name.partition(".")
        value = getattr(getattr(cell, section), key)
        if value > most:
            faults.append(
                f"'{name}' is in {unit}, and {value:g} {unit} can't be: is it {value:g} {other}, "
                f"{value * size:.4g} {unit}?"
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


def _lengths(cell: RobotCell) -> list[tuple[str, tuple[float, ...]]]:
    return [
        ("arm.pose_world_base", cell.arm.pose_world_base[:3]),
        ("tracker.pose_world_camera", cell.tracker.pose_world_camera[:3]),
        ("mount.pose_flange_hand", cell.mount.pose_flange_hand[:3]),
        ("mount.adapter_radius", (cell.mount.adapter_radius,)),
        ("mount.adapter_length", (cell.mount.adapter_length,)),
        ("workspace.lower", cell.workspace.lower),
        ("workspace.upper", cell.workspace.upper),
        *(("obstacles.center", box.center) for box in cell.obstacles),
        *(("obstacles.size", box.size) for box in cell.obstacles),
    ]
