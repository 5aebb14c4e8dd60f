"""Registers and units of the Inspire RH56 hand.

Six motors in the order little, ring, middle, index finger, thumb bend, thumb rotation. Angles are 0 (closed)
to 1000 (open), forces grams, speeds 0 to 1000. Register addresses count bytes, yet six motors are six
registers in a row. Facts from the maker's examples (inspire_demos) and from a published characterization of
the hand (correlllab, rh56_controller); how angles relate to radians between the two ends is not published:
linear here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MOTORS = 6
HAND_ID, CLEAR_ERRORS = 1000, 1004
ANGLE_SET, FORCE_SET, SPEED_SET = 1486, 1498, 1522
ANGLE_ACTUAL, FORCE_ACTUAL, CURRENT = 1546, 1582, 1594
ERRORS, STATUS, TEMPERATURES = 1606, 1612, 1618
"""Of these three the six values are bytes, two to a register, the first in the low byte."""

SINGLE_BYTES = frozenset({HAND_ID, CLEAR_ERRORS})
"""Registers of one byte. Over Modbus each is a register of its own; on a serial line a second byte would be
written to the next one, which after CLEAR_ERRORS is SAVE."""

OPEN_ANGLE = 1000
LEAVE = 65535
"""Written to a motor's angle: leave as it is."""
MODEL_ORDER = np.array([3, 2, 1, 0, 5, 4])
"""Motor of each joint of the hand's model: index, middle, ring, pinky, thumb yaw, pitch. Its own inverse."""

SPEED_SETTINGS = np.array([0.0, 25, 50, 100, 250, 500, 750, 1000])
CLOSING_SPEEDS = np.array([0.0, 70, 141, 286, 706, 1449, 2049, 2342])
"""Measured speed at each setting [1/s], medians over 100 to 200 closings of a real hand."""

FAULTS = {1: "too hot", 3: "motor fault", 4: "communication fault"}
"""Bits of an error that end operation; 0 (stalled) and 2 (overcurrent) belong to grasping."""


def closing_speed(setting: np.ndarray | float) -> np.ndarray:
    """Speed of a motor [1/s] at a setting of 0 to 1000."""
    return np.asarray(np.interp(setting, SPEED_SETTINGS, CLOSING_SPEEDS))


def encode_angles(positions: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[int]:
    """Angles 0 to 1000 of the motors.

    Args:
        positions: joints of the model [rad], shape [6].
        lower: open [rad], shape [6].
        upper: closed [rad], shape [6].
    """
    angles = OPEN_ANGLE * (upper - positions) / (upper - lower)
    return [int(a) for a in np.clip(np.rint(angles), 0, OPEN_ANGLE)[MODEL_ORDER]]


def decode_angles(registers: Sequence[int], lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Joints of the model [rad], shape [6]; registers: six, of the motors; else as ``encode_angles``."""
    angles = signed(registers)[MODEL_ORDER]
    return upper - angles / OPEN_ANGLE * (upper - lower)


def signed(registers: Sequence[int]) -> np.ndarray:
    """Registers as signed numbers, shape [N]."""
    return np.array(registers, dtype=np.uint16).astype(np.int16).astype(float)


def unpack_bytes(registers: Sequence[int]) -> list[int]:
    """Six bytes of three registers."""
    return [byte for register in registers for byte in (register & 0xFF, register >> 8)]
