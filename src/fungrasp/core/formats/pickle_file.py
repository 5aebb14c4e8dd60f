"""Reading pickles that hold nothing but arrays, numbers, text and containers of them.

A pickle is a program. Here it can call nothing: the names by which NumPy (and joblib, which D-Grasp wrote its
labels with) rebuild arrays stand for the small classes below, every other name is refused before anything is
called.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import pickle
import zlib
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import one_line, read_bytes

LARGEST = 1 << 28
"""Bytes of the largest pickle that is read, unpacked; and of all its arrays together."""

MOST_STEPS = 2_000_000
"""Most steps of the program that a pickle is."""

_COMPRESSED: dict[bytes, Callable[[io.BytesIO], Any]] = {
    b"\x1f\x8b": lambda stream: gzip.GzipFile(fileobj=stream),
    b"BZ": bz2.BZ2File,
    b"\xfd7zXZ": lzma.LZMAFile,
    b"]\x00": lzma.LZMAFile,
}
"""How joblib's compressed files begin, but those of zlib."""


def load_arrays_pickle(path: str | Path) -> Any:
    """Read a pickle written by ``pickle.dump`` or ``joblib.dump``.

    Returns:
        Containers (dict, list, tuple, set), numbers, text, bytes and arrays of numbers, flags or text.

    Raises:
        FungraspError: the file is missing, cut short, no pickle, or asks for anything else.
    """
    data = read_bytes(path, "pickle", LARGEST)
    try:
        if data.startswith(b"x"):
            data = zlib.decompressobj().decompress(data, LARGEST + 1)
        for start, unpacked in _COMPRESSED.items():
            if data.startswith(start):
                data = unpacked(io.BytesIO(data)).read(LARGEST + 1)
                break
        if len(data) > LARGEST:
            raise _RefusedError(f"unpacked it has more than {LARGEST >> 20} MB")
        return _Finished().value(_ArraysUnpickler(io.BytesIO(data)).load())
    except _RefusedError as error:
        raise FungraspError(f"{path} was not read: {error}") from error
    except Exception as error:
        # Bytes that are no pickle make the unpickler raise any exception.
        raise FungraspError(f"{path} is not a readable pickle of arrays: {one_line(error)}") from error


class _RefusedError(Exception):
    pass


class _DType:
    """Stands for ``numpy.dtype``; only what plain numbers, flags and text need."""

    def __init__(self, code: str, *_: Any):
        self.code = code
        self.order: Literal["<", ">", "="] = "="

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = state[1] if state[1] in ("<", ">") else "="

    def dtype(self) -> np.dtype:
        dtype = np.dtype(self.code)
        if dtype.kind not in "biufSU":
            raise _RefusedError(f"it holds an array of {dtype}, which is no plain data")
        return dtype.newbyteorder(self.order)


class _Array:
    """Stands for ``numpy.ndarray``."""

    def __init__(self) -> None:
        self.value = np.zeros(0)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, dtype, fortran, data = state
        self.value = _array(data, dtype, shape, "F" if fortran else "C")


class _JoblibArray:
    """Stands for joblib's note that an array's bytes follow in the file."""

    shape: tuple[int, ...]
    order: str
    dtype: _DType

    def read(self, stream: io.BytesIO) -> _Array:
        dtype = self.dtype.dtype()
        if getattr(self, "numpy_array_alignment_bytes", None) is not None:
            stream.read(stream.read(1)[0])
        array = _Array()
        count = int(np.prod([int(size) for size in self.shape], dtype=object))
        array.value = _array(stream.read(count * dtype.itemsize), self.dtype, self.shape, self.order)
        return array


def _array(data: bytes | str, dtype: _DType, shape: tuple[int, ...], order: Any) -> np.ndarray:
    if not isinstance(dtype, _DType):
        raise _RefusedError("it holds an array without a plain type")
    plain = dtype.dtype()
    if not isinstance(data, bytes | bytearray | str):
        raise _RefusedError(f"it holds an array of {type(data).__name__}, which is no plain data")
    raw = data.encode("latin1") if isinstance(data, str) else data
    # Views, as long as the order of bytes allows: a program may name the same bytes many times.
    array = np.frombuffer(raw, dtype=plain).reshape(tuple(shape), order="F" if order == "F" else "C")
    return array.astype(plain.newbyteorder("="), copy=False)


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _from_buffer(data: Any, dtype: _DType, shape: tuple[int, ...], order: str) -> _Array:
    array = _Array()
    array.value = _array(bytes(data), dtype, shape, order)
    return array


def _scalar(dtype: _DType, data: bytes | str) -> Any:
    return _array(data, dtype, (), "C")[()]


def _encode(text: str, encoding: str) -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise _RefusedError(f"it asks for the encoding '{encoding}'")
    return text.encode("latin1")


_PythonUnpickler: Any = pickle._Unpickler  # pyright: ignore[reportAttributeAccessIssue]


def _no_bytes() -> bytes:
    """How pickles of protocols before 3 spell empty bytes."""
    return b""


def _counted(step: Callable[[Any], None]) -> Callable[[Any], None]:
    """One kind of step of the unpickler, refused after ``MOST_STEPS`` of all kinds."""

    def run(unpickler: Any) -> None:
        unpickler.steps += 1
        if unpickler.steps > MOST_STEPS:
            raise _RefusedError(f"it takes more than {MOST_STEPS} steps")
        step(unpickler)

    return run


class _ArraysUnpickler(_PythonUnpickler):
    """The unpickler written in Python: the one in C can't stop to let joblib's array bytes be read."""

    ALLOWED: ClassVar[dict[tuple[str, str], Any]] = {
        ("numpy", "ndarray"): _Array,
        ("numpy", "dtype"): _DType,
        ("_codecs", "encode"): _encode,
        ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
        ("collections", "OrderedDict"): OrderedDict,
        **{
            (builtins, name): stand_in
            for builtins in ("builtins", "__builtin__")
            for name, stand_in in (("set", set), ("frozenset", frozenset), ("bytes", _no_bytes))
        },
        **{
            (f"numpy.{core}.{module}", name): stand_in
            for core in ("core", "_core")
            for module, name, stand_in in (
                ("multiarray", "_reconstruct", _reconstruct),
                ("multiarray", "scalar", _scalar),
                ("numeric", "_frombuffer", _from_buffer),
            )
        },
    }

    def __init__(self, stream: io.BytesIO):
        super().__init__(stream, encoding="latin1")
        self._stream = stream
        self.steps = 0

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self.ALLOWED:
            raise _RefusedError(
                f"it asks for {module}.{name}; only arrays, numbers, text and containers are read"
            )
        return self.ALLOWED[module, name]

    def persistent_load(self, pid: Any) -> Any:
        raise _RefusedError("it refers to objects outside the file")

    def load_build(self) -> None:
        super().load_build()
        stack: list[Any] = self.stack
        if isinstance(stack[-1], _JoblibArray):
            stack[-1] = stack[-1].read(self._stream)

    dispatch: ClassVar[dict[int, Any]] = {
        code: _counted(step)
        for code, step in (_PythonUnpickler.dispatch | {pickle.BUILD[0]: load_build}).items()
    }


class _Finished:
    """Puts arrays in the place of their stand-ins."""

    def __init__(self) -> None:
        self._size = 0

    def value(self, value: Any) -> Any:
        """The same, of plain data."""
        self._size += max(value.value.size * 8, value.value.nbytes) if isinstance(value, _Array) else 64
        if self._size > LARGEST:
            raise _RefusedError(f"its values take more than {LARGEST >> 20} MB")
        if isinstance(value, _Array):
            return value.value
        if isinstance(value, dict):
            return {key: self.value(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self.value(item) for item in value)
        if value is None or isinstance(
            value, bool | int | float | complex | str | bytes | bytearray | set | frozenset | np.generic
        ):
            return value
        raise _RefusedError(f"it holds a {type(value).__name__.strip('_')}, which is no plain data")
