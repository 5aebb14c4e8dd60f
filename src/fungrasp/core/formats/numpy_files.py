"""NumPy files, ``.npy`` and ``.npz``, of limited size and without objects."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import cannot_read, check_file, one_line

LARGEST = 1 << 28
"""Maximum total size of the arrays in a file, counting at least 8 bytes per number [bytes]."""

MOST_ARRAYS = 1000
MOST_AXES = 8
LONGEST_HEADER = 10_000
"""Maximum size of an array's header [bytes]."""


def read_npy(path: str | Path, what: str) -> np.ndarray:
    """Read the array in an ``.npy`` file: numbers, booleans or text.

    Raises:
        FungraspError: the file can't be read, is not an ``.npy`` file, or is too large.
    """
    where = f"the {what} {one_line(path)}"
    path = check_file(path, what, LARGEST + LONGEST_HEADER)
    try:
        with path.open("rb") as stream:
            return _array(stream, LARGEST, where)
    except OSError as error:
        raise cannot_read(path, error) from error


def read_npz(
    path: str | Path,
    what: str,
    wanted: Callable[[str], bool] = lambda name: True,
    most: int = MOST_ARRAYS,
    largest: int = LARGEST,
) -> dict[str, np.ndarray]:
    """Read the arrays in an ``.npz`` file by name: numbers, booleans or text.

    Args:
        wanted: returns whether to read a name; other arrays are skipped.
        most: maximum number of arrays.
        largest: maximum total size of the arrays, counting at least 8 bytes per number [bytes].

    Raises:
        FungraspError: the file can't be read, is not an ``.npz`` file, or is too large.
    """
    where = f"the {what} {one_line(path)}"
    path = check_file(path, what, largest + most * LONGEST_HEADER)
    room = largest
    arrays: dict[str, np.ndarray] = {}
    try:
        with path.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            for name, member in _members(archive, where, most).items():
                if not wanted(name):
                    continue
                if member.file_size > room + LONGEST_HEADER:
                    raise FungraspError(f"{_field(where, name)} takes more than {room >> 20} MB")
                with archive.open(member) as content:
                    arrays[name] = _array(content, room, _field(where, name))
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
    """Return the names of all arrays in an ``.npz`` file."""
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
            raise FungraspError(f"{_field(where, name)} is not an array")
        if name in found:
            raise FungraspError(f"{_field(where, name)} is there twice")
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FungraspError(f"{_field(where, name)} is encrypted or packed in an unusual way")
        found[name] = member
    return found


def _field(where: str, name: str) -> str:
    return f"{where}: field '{one_line(name, 60)}'"


def _array(stream: IO[bytes], room: int, where: str) -> np.ndarray:
    """Read the array of an ``.npy`` file in native byte order, if it takes at most ``room`` bytes."""
    try:
        with warnings.catch_warnings(action="ignore"):
            array = np.lib.format.read_array(stream, allow_pickle=False, max_header_size=LONGEST_HEADER)
    except Exception as error:
        if "allow_pickle" in str(error):
            raise FungraspError(
                f"{where} holds Python objects; only numbers, flags and text are read"
            ) from None
        # NumPy reads the header with Python's parser, which can raise almost any exception.
        raise FungraspError(f"{where} can't be read: not a NumPy array, or damaged") from error
    if array.dtype.kind not in "biufSU":
        raise FungraspError(
            f"{where} holds {one_line(array.dtype, 60)}; only numbers, flags and text are read"
        )
    if array.ndim > MOST_AXES:
        raise FungraspError(f"{where} has {array.ndim} axes; at most {MOST_AXES} are read")
    if array.size * max(array.itemsize, 8) > room:
        raise FungraspError(f"{where} takes more than {room >> 20} MB")
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    if array.dtype.kind == "U":
        # Python fails on invalid code points only when it uses them.
        points = np.ascontiguousarray(array).reshape(-1).view(np.uint32)
        if ((points > 0x10FFFF) | ((points >= 0xD800) & (points < 0xE000))).any():
            raise FungraspError(f"{where} holds text with numbers that are no characters")
    return array
