"""The file of a camera's calibration, which a cell names as ``tracker.calibration``."""

from __future__ import annotations

from pathlib import Path

from fungrasp.core.files import atomic_path
from fungrasp.robots.calibration.hand_eye import CameraCalibration


def save_calibration(path: str | Path, found: CameraCalibration, source: str) -> None:
    """Write a calibration as TOML.

    Args:
        path: the file.
        found: where the camera is.
        source: how it was found, for people.
    """
    pose = ", ".join(f"{value:.7g}" for value in found.pose_world_camera)
    lines = [
        f"# Camera of a cell, from {source}. Name this file as 'calibration' under [tracker] of the cell.",
        f"pose_world_camera = [{pose}] # [m], wxyz",
        f"calibration_residual = {found.residual:.6g} # [m]",
        f"position_deviation = {found.position_deviation:.6g} # [m]",
        f"rotation_deviation = {found.rotation_deviation:.6g} # [rad]",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
