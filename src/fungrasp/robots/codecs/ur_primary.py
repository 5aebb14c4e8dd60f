"""The part of a UR controller's primary interface that says how the arm was made: its kinematics.

A message is its length (int32, itself included), a type (uint8; 16 is the robot's state) and, for a state,
parts of the same form; part 5 holds six checksums (uint32), then theta, a, d and alpha of six joints
(doubles), and a status (uint32). Numbers are big endian. The parameters are those of the one arm, with what
the maker has calibrated. Facts from Universal Robots' client interface documentation and ROS driver.
"""

from __future__ import annotations

import struct

import numpy as np

from fungrasp.robots.kinematics.dh_parameters import DHParameters

HEADER = struct.Struct(">iB")
ROBOT_STATE, KINEMATICS = 16, 5
LONGEST_MESSAGE = 1 << 16
"""A message that claims more bytes is none."""
_KINEMATICS = struct.Struct(">6I24dI")


def encode_kinematics(parameters: DHParameters) -> bytes:
    """A robot's state that holds its kinematics alone. parameters: of six joints."""
    p = parameters
    content = _KINEMATICS.pack(*[0] * 6, *p.theta, *p.a, *p.d, *p.alpha, 0)
    part = HEADER.pack(HEADER.size + len(content), KINEMATICS) + content
    return HEADER.pack(HEADER.size + len(part), ROBOT_STATE) + part


def decode_kinematics(stream: bytes) -> tuple[DHParameters | None, bytes]:
    """The kinematics in what a controller has sent so far, if they are there, and what is not whole yet.

    Raises:
        ValueError: this is no such stream.
    """
    while len(stream) >= HEADER.size:
        length, kind = HEADER.unpack_from(stream)
        if not HEADER.size <= length <= LONGEST_MESSAGE:
            raise ValueError("no messages of a primary interface")
        if len(stream) < length:
            break
        message, stream = stream[HEADER.size : length], stream[length:]
        while kind == ROBOT_STATE and len(message) >= HEADER.size:
            size, part = HEADER.unpack_from(message)
            if not HEADER.size <= size <= len(message):
                raise ValueError("a state of the robot that breaks off")
            if part == KINEMATICS and size >= HEADER.size + _KINEMATICS.size:
                values = np.array(_KINEMATICS.unpack_from(message, HEADER.size)[6:-1], dtype=float)
                return DHParameters(*values.reshape(4, 6)), stream
            message = message[size:]
    return None, stream
