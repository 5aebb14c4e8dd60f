"""Reading pickles of arrays, tensors, numbers, text and containers of them.

A pickle is a program. Here it can't call foreign code: the names with which NumPy (and joblib, which D-Grasp
used for its labels) rebuild arrays refer to the stand-in classes below, and every other name is refused. The
pickle is first tested in a child process with limited time and memory.
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
"""Maximum size of a pickle [bytes]."""

_COMPRESSED: dict[bytes, Callable[[bytes], bytes]] = {
    b"x": zlib.decompress,
    b"\x1f\x8b": gzip.decompress,
    b"BZ": bz2.decompress,
    b"\xfd7zXZ": lzma.decompress,
    b"]\x00": lzma.decompress,
}
"""Decompressors by the first bytes of joblib's compressed files."""


def load_arrays_pickle(path: str | Path) -> Any:
    """Read a pickle written by ``pickle.dump`` or ``joblib.dump``, or an ``.npz`` file that contains pickles.

    Returns:
        containers (dict, list, tuple, set), numbers, text, bytes and arrays of numbers, booleans or text.

    Raises:
        FungraspError: the file is missing, truncated, not a pickle, requests other types, or takes too much
            time or memory.
    """
    data = read_bytes(path, "pickle", LARGEST)
    run_limited("pickle", path, "pickle", len(data), f"the pickle {one_line(path)}")
    return unpickled(data)


def unpickled(data: bytes) -> Any:
    """Return the content of a pickle.

    Raises:
        Exception: the bytes are not a pickle or have other content.
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
    """Read the array of an ``.npy`` file, or the content of a single Python object in it."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    if not read(stream)[2].hasobject:
        stream.seek(0)
        return np.lib.format.read_array(stream, allow_pickle=False)
    return _plain(_ArraysUnpickler(stream).load())


class _DType:
    """Stand-in for ``numpy.dtype``, for plain numbers, booleans and text."""

    def __init__(self, code: str, *_: Any):
        self.dtype = np.dtype(code)
        if self.dtype.kind not in "biufSUO":
            raise FungraspError(f"it holds an array of {self.dtype}, which is not plain data")

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if state[1] in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(state[1])

    def array(self, data: Any, shape: Any, fortran: Any) -> np.ndarray:
        """Return the array of these bytes, a view if they are in native byte order."""
        if self.dtype.hasobject:
            raise FungraspError("it holds an array of objects, which is not plain data")
        raw = data.encode("latin1") if isinstance(data, str) else data
        array = np.frombuffer(raw, self.dtype).reshape(shape, order="F" if fortran else "C")
        return array.astype(self.dtype.newbyteorder("="), copy=False)


class _Array:
    """Stand-in for ``numpy.ndarray``."""

    value: Any = np.zeros(0)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, dtype, fortran, data = state
        if shape == () and isinstance(data, list) and len(data) == 1:
            self.value = _plain(data[0])
            return
        self.value = _typed(dtype).array(data, shape, fortran)


class _Sparse:
    """Stand-in for SciPy's sparse matrices in column or row format."""

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
    """Stand-in for ``chumpy.ch.Ch`` in pickles of body models: its array."""

    value = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        fields = next((part for part in state if part), {}) if isinstance(state, tuple) else state
        if "x" in fields:
            self.value = _plain(fields["x"])
        elif {"a", "idxs"} <= set(fields):  # chumpy.reordering.Select: some entries of another array.
            found = np.ravel(_plain(fields["a"]))[np.ravel(_plain(fields["idxs"]))]
            self.value = found.reshape(fields.get("preferred_shape", found.shape))


class _Storage(pickle.Unpickler):
    """Reads the storage of a pickled PyTorch tensor: pickles of a magic number, a version, the system, a
    reference and its key, then the count and the numbers."""

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
"""NumPy types by PyTorch storage type."""


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
    """Create an object without ``__init__``, as in pickle protocols before 2."""
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
    """Return empty bytes, as written in pickle protocols before 3."""
    return b""


class _ArraysUnpickler(pickle.Unpickler):
    """Unpickler of the names in ``allowed``. joblib writes an array's bytes after the record that describes
    it. They are read when the record gets its fields, because the unpickler does not read ahead."""

    def __init__(self, stream: io.BytesIO):
        super().__init__(stream, encoding="latin1")

        class Note(_Array):
            """Stand-in for joblib's record of an array whose bytes follow in the file."""

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
    """Replace stand-ins by their arrays."""
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
