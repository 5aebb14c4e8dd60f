"""Packages of Universal Robots' Real-Time Data Exchange, protocol version 2, as the controller sends and
takes them.

A package is its length (uint16, the three bytes of the header included), a letter, and data; numbers are
big endian. A client names the variables it wants (``O``) and those it will write (``I``), each list a recipe;
data packages (``U``) carry the number of their recipe and its values. Facts from the RTDE guide of Universal
Robots.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

PROTOCOL_VERSION, CONTROLLER_VERSION, TEXT_MESSAGE = b"V", b"v", b"M"
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE, DATA = b"O", b"I", b"S", b"P", b"U"

HEADER = struct.Struct(">Hc")
_FORMATS = {"DOUBLE": "d", "UINT32": "I", "INT32": "i", "UINT64": "Q", "UINT8": "B", "BOOL": "?"}
_FORMATS |= {"VECTOR6D": "6d", "VECTOR3D": "3d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}

_VARIABLES = {
    "timestamp": "DOUBLE",
    "payload": "DOUBLE",
    "payload_cog": "VECTOR3D",
    "target_q": "VECTOR6D",
    "target_qd": "VECTOR6D",
    "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D",
    "actual_current": "VECTOR6D",
    "target_moment": "VECTOR6D",
    "actual_TCP_pose": "VECTOR6D",
    "actual_TCP_speed": "VECTOR6D",
    "actual_TCP_force": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "runtime_state": "UINT32",
    "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32",
    "speed_scaling": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
}
_REGISTER = re.compile(r"(?:input|output)_(int|double|bit)_register_\d+")
_REGISTER_TYPES = {"int": "INT32", "double": "DOUBLE", "bit": "BOOL"}


@dataclass(frozen=True)
class Recipe:
    """Variables that go together, and their types; an unknown variable has the type "NOT_FOUND"."""

    names: tuple[str, ...]
    """Names of the variables."""
    types: tuple[str, ...]
    """Types of the variables."""

    @property
    def valid(self) -> bool:
        """Whether every variable is known."""
        return "NOT_FOUND" not in self.types

    @property
    def layout(self) -> struct.Struct:
        """Of the values; for valid recipes only."""
        return struct.Struct(">" + "".join(_FORMATS[kind] for kind in self.types))


def make_recipe(names: str) -> Recipe:
    """Recipe of a list of variables, "timestamp,actual_q"."""
    listed = tuple(name for name in names.split(",") if name)
    return Recipe(listed, tuple(_type_of(name) for name in listed))


def package(kind: bytes, data: bytes = b"") -> bytes:
    """A package; kind: one letter."""
    return HEADER.pack(HEADER.size + len(data), kind) + data


def split_packages(stream: bytes) -> tuple[list[tuple[bytes, bytes]], bytes]:
    """Whole packages at the start of a stream, as letters with data, and the bytes that are left."""
    packages = []
    while len(stream) >= HEADER.size:
        size, kind = HEADER.unpack_from(stream)
        if size < HEADER.size or len(stream) < size:
            break
        packages.append((kind, stream[HEADER.size : size]))
        stream = stream[size:]
    return packages, stream


def encode_values(recipe: Recipe, number: int, values: Mapping[str, Any]) -> bytes:
    """Data package of a recipe; variables that have no value are zero.

    Args:
        recipe: names and types.
        number: of the recipe.
        values: by name: numbers, or arrays for vectors.
    """
    flat: list[Any] = []
    for name, kind in zip(recipe.names, recipe.types, strict=True):
        count = struct.Struct(">" + _FORMATS[kind]).size // struct.calcsize(">" + _FORMATS[kind][-1])
        value = values.get(name, 0)
        flat += np.broadcast_to(value, count).tolist()
    return package(DATA, bytes([number]) + recipe.layout.pack(*flat))


def decode_values(recipe: Recipe, data: bytes) -> dict[str, Any]:
    """Values by name of a data package's content after the number of the recipe; vectors are tuples."""
    flat: Sequence[Any] = recipe.layout.unpack(data)
    values, at = {}, 0
    for name, kind in zip(recipe.names, recipe.types, strict=True):
        count = int(_FORMATS[kind][:-1] or 1)
        values[name] = flat[at] if count == 1 else tuple(flat[at : at + count])
        at += count
    return values


def _type_of(name: str) -> str:
    register = _REGISTER.fullmatch(name)
    return _REGISTER_TYPES[register[1]] if register else _VARIABLES.get(name, "NOT_FOUND")
