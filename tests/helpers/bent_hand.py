"""A human hand made for the tests."""

from __future__ import annotations

import numpy as np

SPREAD = {"index": 0.025, "middle": 0.005, "ring": -0.015, "pinky": -0.033}
LENGTHS = {
    "index": (0.088, 0.038, 0.022, 0.021),
    "middle": (0.090, 0.042, 0.025, 0.022),
    "ring": (0.082, 0.038, 0.025, 0.022),
    "pinky": (0.075, 0.031, 0.018, 0.020),
}


def bent_hand(bends: tuple[float, float, float] = (0.3, 0.5, 0.3)) -> np.ndarray:
    """A right hand, wrist at the origin, fingers along x, thumb on the side of +y, palm down.
    bends: MCP, PIP, DIP [rad]. Returns [m], shape [21, 3]."""
    joints = [np.zeros(3)]
    for finger, side in SPREAD.items():
        metacarpal, *links = LENGTHS[finger]
        point = np.array([np.sqrt(metacarpal**2 - side**2), side, 0.0])
        joints.append(point)
        before = point / np.linalg.norm(point)
        angle = 0.0
        for bend, link in zip(bends, links, strict=True):
            angle += bend
            point = point + link * (np.cos(angle) * before + np.sin(angle) * np.array([0.0, 0.0, -1.0]))
            joints.append(point)
    thumb = np.array(
        [[0.025, 0.025, -0.012], [0.055, 0.05, -0.022], [0.08, 0.06, -0.035], [0.1, 0.062, -0.055]]
    )
    return np.concatenate([np.array(joints), thumb])
