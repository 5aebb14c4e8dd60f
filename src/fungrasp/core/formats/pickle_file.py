"""Reading pickles that hold nothing but arrays, tensors, numbers, text and containers of them.

A pickle is a program. Here it can call nothing: the names by which NumPy (and joblib, which D-Grasp wrote its
labels with) rebuild arrays stand for the small classes below, every other name is refused. It is run in a
child process with limited time and memory first.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import pickle
import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line, read_bytes
from fungrasp.core.formats.sandbox import run_limited

LARGEST = 1 << 28
"""Bytes of the largest pickle that is read."""

_COMPRESSED: dict[bytes, Callable[[bytes], bytes]] = {
    b"x": zlib.decompress,
    b"\x1f\x8b": gzip.decompress,
    b"BZ": bz2.decompress,
    b"\xfd7zXZ": lzma.decompress,
    b"]\x00": lzma.decompress,
}
"""How joblib's compressed files begin."""


def load_arrays_pickle(path: str | Path) -> Any:
    """Read a pickle written by ``pickle.dump`` or ``joblib.dump``, or an ``.npz`` file with such in it.

    Returns:
        Containers (dict, list, tuple, set), numbers, text, bytes and arrays of numbers, flags or text.

    Raises:
        FungraspError: the file is missing, cut short, no pickle, asks for anything else, or takes too much
            time or memory.
    """
    data = read_bytes(path, "pickle", LARGEST)
    run_limited("pickle", path, "pickle", len(data), f"the pickle {one_line(path)}")
    return unpickled(data)


def unpickled(data: bytes) -> Any:
    """What a pickle's bytes hold.

    Raises:
        Exception: they hold something else, or are no pickle.
    """
    if data.startswith(b"PK\x03\x04"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {n.removesuffix(".npy"): _npy(io.BytesIO(archive.read(n))) for n in archive.namelist()}
    for start, unpacked in _COMPRESSED.items():
        if data.startswith(start):
            data = unpacked(data)
            break
    return _plain(_ArraysUnpickler(io.BytesIO(data)).load())


def _npy(stream: io.BytesIO) -> Any:
    """The array of an ``.npy`` file; what a single object of Python's in it holds."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    if not read(stream)[2].hasobject:
        stream.seek(0)
        return np.lib.format.read_array(stream, allow_pickle=False)
    return _plain(_ArraysUnpickler(stream).load())


class _DType:
    """Stands for ``numpy.dtype``; only what plain numbers, flags and text need."""

    def __init__(self, code: str, *_: Any):
        self.dtype = np.dtype(code)
        if self.dtype.kind not in "biufSUO":
            raise FungraspError(f"it holds an array of {self.dtype}, which is not plain data")

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if state[1] in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(state[1])

    def array(self, data: Any, shape: Any, fortran: Any) -> np.ndarray:
        """The array of these bytes; a view of them, as far as the order of bytes allows."""
        if self.dtype.hasobject:
            raise FungraspError("it holds an array of objects, which is not plain data")
        raw = data.encode("latin1") if isinstance(data, str) else data
        array = np.frombuffer(raw, self.dtype).reshape(shape, order="F" if fortran else "C")
        return array.astype(self.dtype.newbyteorder("="), copy=False)


class _Array:
    """Stands for ``numpy.ndarray``."""

    value: Any = np.zeros(0)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, dtype, fortran, data = state
        if shape == () and isinstance(data, list) and len(data) == 1:
            self.value = _plain(data[0])
            return
        self.value = _typed(dtype).array(data, shape, fortran)


class _Sparse:
    """Stands for SciPy's sparse matrices by columns or rows."""

    by_rows = False

    def __setstate__(self, state: dict[str, Any]) -> None:
        import scipy.sparse

        kind = scipy.sparse.csr_matrix if self.by_rows else scipy.sparse.csc_matrix
        data, indices, ends = (_plain(state[name]) for name in ("data", "indices", "indptr"))
        shape = tuple(int(size) for size in state["_shape"])
        if np.prod(shape, dtype=object) > LARGEST // 8:
            raise FungraspError("it holds a sparse matrix that is too large")
        self.value = kind((data, indices, ends), shape=shape).toarray()


class _SparseByRows(_Sparse):
    by_rows = True


class _Chumpy:
    """Stands for ``chumpy.ch.Ch``, which models of bodies are pickled with: its array."""

    value = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        fields = next((part for part in state if part), {}) if isinstance(state, tuple) else state
        if "x" in fields:
            self.value = _plain(fields["x"])
        elif {"a", "idxs"} <= set(fields):  # chumpy.reordering.Select: some entries of another array.
            found = np.ravel(_plain(fields["a"]))[np.ravel(_plain(fields["idxs"]))]
            self.value = found.reshape(fields.get("preferred_shape", found.shape))


class _Storage(pickle.Unpickler):
    """The numbers of a PyTorch tensor, as pickles of tensors hold them: pickles of a magic number, a version,
    the system, a reference and its key; then the count and the numbers themselves."""

    def find_class(self, module: str, name: str) -> Any:
        if module != "torch" or name not in _STORAGES:
            raise FungraspError(f"it asks for {module}.{name} in a tensor")
        return np.dtype(_STORAGES[name])

    def persistent_load(self, pid: Any) -> Any:
        return pid[1]


_STORAGES = {
    "FloatStorage": "f4",
    "DoubleStorage": "f8",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "BoolStorage": "?",
    "ByteStorage": "u1",
}
"""NumPy's types by PyTorch's."""


def _storage(data: bytes) -> np.ndarray:
    stream = io.BytesIO(data)
    dtype = [_Storage(stream).load() for _ in range(5)][3]
    return np.frombuffer(stream.read()[8:], dtype)


def _tensor(
    storage: np.ndarray, start: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any
) -> Any:
    array = _Array()
    last = start + sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
    if start < 0 or min((*shape, *strides), default=0) < 0 or (last >= len(storage) and 0 not in shape):
        raise FungraspError("it holds a tensor that reaches beyond its numbers")
    if np.prod(shape, dtype=object) > LARGEST // 8:
        raise FungraspError("it holds a tensor that is too large")
    steps = [stride * storage.itemsize for stride in strides]
    array.value = np.lib.stride_tricks.as_strided(storage[start:], shape, steps).copy()
    return array


def _rebuilt(kind: Any, *_: Any) -> Any:
    """How pickles of protocols before 2 make an object without its ``__init__``."""
    return kind() if kind in (_Chumpy, _Sparse, _SparseByRows) else None


def _typed(dtype: Any) -> _DType:
    if not isinstance(dtype, _DType):
        raise FungraspError("it holds an array without a plain type")
    return dtype


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _from_buffer(data: Any, dtype: Any, shape: Any, order: str) -> _Array:
    array = _Array()
    array.value = _typed(dtype).array(bytes(data), shape, order == "F")
    return array


def _scalar(dtype: Any, data: Any) -> Any:
    return _typed(dtype).array(data, (), False)[()]


def _encode(text: str, encoding: str) -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise FungraspError(f"it asks for the encoding '{encoding}'")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """How pickles of protocols before 3 spell empty bytes."""
    return b""


class _ArraysUnpickler(pickle.Unpickler):
    """Knows the names of ``ALLOWED`` alone. joblib writes an array's bytes behind the note that describes it:
    they are read when the note gets its fields, from the stream that the unpickler reads without looking
    ahead."""

    def __init__(self, stream: io.BytesIO):
        super().__init__(stream, encoding="latin1")

        class Note(_Array):
            """Stands for joblib's note that an array's bytes follow in the file."""

            def __setstate__(self, state: Any) -> None:
                if state.get("numpy_array_alignment_bytes") is not None:
                    stream.read(stream.read(1)[0])
                kind, shape = _typed(state["dtype"]), state["shape"]
                count = int(np.prod([int(size) for size in shape], dtype=object))
                data = stream.read(count * kind.dtype.itemsize)
                self.value = kind.array(data, shape, state["order"] == "F")

        self.allowed: dict[tuple[str, str], Any] = {
            ("numpy", "ndarray"): _Array,
            ("numpy", "dtype"): _DType,
            ("_codecs", "encode"): _encode,
            ("joblib.numpy_pickle", "NumpyArrayWrapper"): Note,
            ("collections", "OrderedDict"): OrderedDict,
            ("chumpy.ch", "Ch"): _Chumpy,
            ("chumpy.reordering", "Select"): _Chumpy,
            ("torch.storage", "_load_from_bytes"): _storage,
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("copy_reg", "_reconstructor"): _rebuilt,
            ("copyreg", "_reconstructor"): _rebuilt,
            ("__builtin__", "object"): object,
            ("builtins", "object"): object,
        }
        for builtins in ("builtins", "__builtin__"):
            for name, kind in (("set", set), ("frozenset", frozenset), ("bytes", _no_bytes)):
                self.allowed[builtins, name] = kind
        for matrices in ("csc", "csr"):
            kind = _Sparse if matrices == "csc" else _SparseByRows
            for module in (f"scipy.sparse.{matrices}", f"scipy.sparse._{matrices}"):
                self.allowed[module, f"{matrices}_matrix"] = kind
        for core in ("numpy.core", "numpy._core"):
            self.allowed[f"{core}.multiarray", "_reconstruct"] = _reconstruct
            self.allowed[f"{core}.multiarray", "scalar"] = _scalar
            self.allowed[f"{core}.numeric", "_frombuffer"] = _from_buffer

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self.allowed:
            raise FungraspError(
                f"it asks for {module}.{name}; only arrays, numbers, text and containers are read"
            )
        return self.allowed[module, name]


def _plain(value: Any) -> Any:
    """The same with arrays in the place of their stand-ins."""
    if isinstance(value, _Array | _Sparse | _Chumpy):
        return value.value
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_plain(item) for item in value)
    plain = bool | int | float | complex | str | bytes | bytearray | set | frozenset | np.generic | None
    if isinstance(value, plain):
        return value
    raise FungraspError(f"it holds a {type(value).__name__.strip('_')}, which is not plain data")
