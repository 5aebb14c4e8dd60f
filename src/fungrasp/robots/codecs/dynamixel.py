"""Registers that the LEAP hand's servos (Dynamixel XC330, XL330) use, and their units. Facts from the maker's
e-Manual.
"""

from __future__ import annotations

import struct

import numpy as np

MODEL_NUMBER, OPERATING_MODE, CURRENT_LIMIT, TORQUE_ENABLE, HARDWARE_ERROR = 0, 11, 38, 64, 70
D_GAIN, I_GAIN, P_GAIN, GOAL_CURRENT, GOAL_POSITION = 80, 82, 84, 102, 116
PRESENT_CURRENT, PRESENT_VELOCITY, PRESENT_POSITION = 126, 128, 132
PRESENT = struct.Struct("<hii")
"""Current, velocity and position lie in a row."""
CURRENT_BASED_POSITION = 5
"""Operating mode: position control with a limit of current."""

RADIANS_PER_COUNT = 2 * np.pi / 4096
CENTER = 2048
"""Count of a servo's middle; zero of the LEAP hand's joints."""
SPEED_PER_COUNT = 0.229 * 2 * np.pi / 60
"""[rad/s]."""
AMPERES_PER_COUNT = 0.001
TORQUES_PER_AMPERE = {"full": 0.52, "lite": 0.35}
"""By build of the hand, from the data sheets' stall points at 5 V [N m/A]: XC330-M288, 0.93 N m at 1.8 A;
XL330-M288, 0.52 N m at 1.47 A."""

HARDWARE_ERRORS = {0: "input voltage", 2: "too hot", 3: "encoder", 4: "electrical shock", 5: "overload"}
"""Bits of the register HARDWARE_ERROR; a servo with one has switched its torque off until it is rebooted."""


def position_counts(positions: np.ndarray) -> list[int]:
    """Counts of joint positions [rad], shape [U]."""
    return [int(c) for c in np.rint(positions / RADIANS_PER_COUNT) + CENTER]


def joint_positions_of(counts: np.ndarray) -> np.ndarray:
    """Joint positions [rad], shape [U], of counts."""
    return (np.asarray(counts) - CENTER) * RADIANS_PER_COUNT
