"""NumPy's files: ``.npy`` and ``.npz``, whose headers are checked before memory is taken for the arrays."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import cannot_read, check_file, one_line

LARGEST = 1 << 28
"""Bytes that all arrays of a file may take together, eight for each number of fewer."""

MOST_ARRAYS = 1000
MOST_AXES = 8
LONGEST_HEADER = 10_000
"""Of an array [bytes]."""

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}

_FIRST = LONGEST_HEADER + 12
"""Bytes within which an array's header ends."""


def read_npy(path: str | Path, what: str) -> np.ndarray:
    """The array in an ``.npy`` file: numbers, flags or text.

    Args:
        path: the file.
        what: it should be, for messages: "depth image".

    Raises:
        FungraspError: it can't be read, is no such file, or too large.
    """
    where = f"the {what} {one_line(path)}"
    path = check_file(path, what, LARGEST + _FIRST)
    try:
        with path.open("rb") as stream:
            return _array(stream, path.stat().st_size, LARGEST, where)
    except OSError as error:
        raise cannot_read(path, error) from error


def read_npz(
    path: str | Path,
    what: str,
    wanted: Callable[[str], bool] = lambda name: True,
    most: int = MOST_ARRAYS,
    largest: int = LARGEST,
) -> dict[str, np.ndarray]:
    """The arrays in an ``.npz`` file by name: numbers, flags or text.

    Args:
        path: the file.
        what: it should be, for messages: "grasp file".
        wanted: which names are read; of others not even the headers are.
        most: arrays that the file may hold.
        largest: bytes that they may take together, eight for each number of fewer.

    Raises:
        FungraspError: it can't be read, is no such file, or what it declares is too large.
    """
    where = f"the {what} {one_line(path)}"
    path = check_file(path, what, largest + most * _FIRST)
    room = largest
    arrays: dict[str, np.ndarray] = {}
    try:
        with path.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            for name, member in _members(archive, where, most).items():
                if not wanted(name):
                    continue
                with archive.open(member) as content:
                    arrays[name] = _array(content, member.file_size, room, _field(where, name))
                room -= arrays[name].size * max(arrays[name].itemsize, 8)
    except FungraspError:
        raise
    except OSError as error:
        raise cannot_read(path, error) from error
    except zipfile.BadZipFile as error:
        raise FungraspError(f"{where} can't be read: not an .npz file, or one that is cut short") from error
    except Exception as error:
        # A damaged archive makes zipfile and zlib raise almost any exception.
        raise FungraspError(f"{where} can't be read: {one_line(error)}") from error
    return arrays


def npz_names(path: str | Path, what: str) -> list[str]:
    """The names of all arrays in an ``.npz`` file that ``read_npz`` can read."""
    with check_file(path, what, LARGEST * 2).open("rb") as stream, zipfile.ZipFile(stream) as archive:
        return [one_line(name, 60) for name in _members(archive, str(path), MOST_ARRAYS)]


def _members(archive: zipfile.ZipFile, where: str, most: int) -> dict[str, zipfile.ZipInfo]:
    members = archive.infolist()
    if len(members) > most:
        raise FungraspError(f"{where} holds {len(members)} files; at most {most} are read")
    found: dict[str, zipfile.ZipInfo] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if name == member.filename:
            raise FungraspError(f"{_field(where, name)} is no array")
        if name in found:
            raise FungraspError(f"{_field(where, name)} is there twice")
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FungraspError(f"{_field(where, name)} is encrypted or packed in an unusual way")
        found[name] = member
    return found


def _field(where: str, name: str) -> str:
    return f"{where}: field '{one_line(name, 60)}'"


def _array(stream: IO[bytes], length: int, room: int, where: str) -> np.ndarray:
    """The array of an ``.npy`` file of ``length`` bytes, if it takes at most ``room`` bytes."""
    head = io.BytesIO(stream.read(_FIRST))
    shape, fortran, dtype = _header(head, where)
    count = math.prod(shape)
    if count * max(dtype.itemsize, 8) > room:
        raise FungraspError(
            f"{where} declares {dtype} of shape {shape}, which is more than fits into {room >> 20} MB"
        )
    size = count * dtype.itemsize
    if length - head.tell() < size:
        raise FungraspError(f"{where} declares {size} bytes of numbers and has {length - head.tell()}")
    data = bytearray(head.read(size))
    data += stream.read(size - len(data))
    if len(data) < size:
        raise FungraspError(f"{where} is cut short")
    try:
        array = np.frombuffer(data, dtype, count).reshape(shape, order="F" if fortran else "C")
        array = array.astype(dtype.newbyteorder("="), copy=False)
    except ValueError as error:
        raise FungraspError(f"{where} can't be read: {one_line(error)}") from error
    if dtype.kind == "U" and not _is_text(array):
        raise FungraspError(f"{where} holds text with numbers that are no characters")
    return array


def _is_text(array: np.ndarray) -> bool:
    """Whether all code points of an array of text are characters: Python fails on others only when it uses
    them."""
    points = np.ascontiguousarray(array).reshape(-1).view(np.uint32)
    return not ((points > 0x10FFFF) | ((points >= 0xD800) & (points < 0xE000))).any()


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether in Fortran's order, and type."""
    try:
        version = np.lib.format.read_magic(stream)
        read = _HEADERS[version]
        shape, fortran, dtype = read(stream, max_header_size=LONGEST_HEADER)
    except Exception as error:
        # Python's own parser reads the header, which can raise almost any exception.
        raise FungraspError(f"{where} can't be read: no array of NumPy, or a damaged one") from error
    if dtype.kind not in "biufSU" or dtype.subdtype is not None:
        raise FungraspError(f"{where} holds {one_line(dtype, 60)}; only numbers, flags and text are read")
    if len(shape) > MOST_AXES or any(type(size) is not int or not 0 <= size < 2**40 for size in shape):
        raise FungraspError(f"{where} has an impossible shape, {one_line(shape, 60)}")
    return shape, fortran, dtype
