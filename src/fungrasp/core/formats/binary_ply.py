"""Binary PLY files, written out as text."""

from __future__ import annotations

import struct
from typing import Any

NAMES = "char uchar short ushort int uint float double int8 uint8 int16 uint16 int32 uint32 float32 float64"
TYPES: dict[str, str] = dict(zip(NAMES.split(), 2 * "bBhHiIfd", strict=True))
"""Codes of ``struct`` for the types of PLY, by both their names."""


def as_text(data: bytes) -> bytes:
    """A binary PLY file in PLY's text format. Source of the format: G. Turk, The PLY Polygon File Format,
    1994.

    Raises:
        ValueError: it ends too early, or its header is not PLY's.
    """
    end = data.index(b"\n", data.index(b"end_header")) + 1
    header = data[:end].decode("ascii").splitlines()
    order = "<" if "format binary_little_endian 1.0" in header else ">"
    elements: list[tuple[int, list[list[str]]]] = []
    for words in (line.split() for line in header):
        if words[:1] == ["element"]:
            elements.append((int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][1].append(words[1:-1])
    lines = [" ".join(line.split()) for line in header]
    lines = ["format ascii 1.0" if line.startswith("format ") else line for line in lines]
    place = end

    def take(kind: str, count: int) -> tuple[Any, ...]:
        nonlocal place
        code = f"{order}{count}{TYPES[kind]}"
        begin, place = place, place + struct.calcsize(code)
        if place > len(data):
            raise ValueError("the PLY file ends too early")
        return struct.unpack_from(code, data, begin)

    for count, properties in elements:
        for _ in range(count):
            row: list[Any] = []
            for kind in properties:
                if kind[0] == "list":
                    (number,) = take(kind[1], 1)
                    row += [number, *take(kind[2], number)]
                else:
                    row += take(kind[0], 1)
            lines.append(" ".join(map(str, row)))
    return "\n".join([*lines, ""]).encode()
