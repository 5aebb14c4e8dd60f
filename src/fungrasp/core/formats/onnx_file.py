"""The operators of an ONNX file, read without the package ``onnx``, and a trial run in a child process.

An ONNX file is one protocol-buffers message. ONNX Runtime itself refuses unknown operators and weights in
other files. A limited child process tests that a network terminates and takes little memory. This module
checks that it consists of plain arithmetic, so that one trial run is valid for all inputs. Field numbers are
those of the public schema, onnx.proto.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from typing import NamedTuple

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.core.formats.sandbox import run_limited

GRAPH, FUNCTION = 7, 25
"""Field numbers of a model."""
NODE = 1
"""Field number of a graph."""
OPERATOR, DOMAIN = 4, 7
"""Field numbers of a node."""

LARGEST = 200_000_000
"""Maximum size of a model [bytes]."""

OPERATORS = frozenset(
    """
    Abs Add And ArgMax ArgMin Cast Ceil Clip Concat Constant ConstantOfShape Cos Div Elu Equal Erf Exp Expand
    Flatten Floor GRU Gather Gelu Gemm Greater GreaterOrEqual HardSigmoid HardSwish Identity LSTM
    LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max Mean Min Mish Mul Neg Not Or Pow
    RNN Reciprocal ReduceMax ReduceMean ReduceMin ReduceSum Relu Reshape Round Selu Shape Sigmoid Sign Sin
    Slice Softmax Softplus Softsign Split Sqrt Squeeze Sub Sum Swish Tan Tanh Transpose Unsqueeze Where
    """.split()  # noqa: SIM905
)
"""Allowed operators: no loops, branches or random numbers."""

_FIXED = {1: 8, 5: 4}
"""Sizes of fixed-size protocol-buffers values by wire type [bytes]."""

_tried: set[bytes] = set()
"""Digests of the models that ``try_network`` has run."""


class Field(NamedTuple):
    """One field of a message."""

    number: int
    """Number of the field in the schema."""
    start: int
    """Offset of its content."""
    end: int
    """Offset after its content."""


def message_fields(data: bytes, start: int, end: int) -> Iterator[Field]:
    """Yield the fields of the message at ``data[start:end]``.

    Raises:
        FungraspError: the bytes are not a message.
    """
    while start < end:
        tag, start = _varint(data, start, end)
        if tag & 7 == 0:
            stop = _varint(data, start, end)[1]
        elif tag & 7 == 2:
            size, start = _varint(data, start, end)
            stop = start + size
        else:
            stop = start + _FIXED.get(tag & 7, end)
        if stop > end:
            raise _broken(start)
        yield Field(tag >> 3, start, stop)
        start = stop


def check_operators(data: bytes) -> None:
    """Check that a model consists of ``OPERATORS``.

    Raises:
        FungraspError: the bytes are not an ONNX model, or it has functions, other operators or operators
            outside the default ONNX domain; the message names the first.
    """
    parts = list(message_fields(data, 0, len(data)))
    if any(part.number == FUNCTION for part in parts):
        raise FungraspError("the model defines functions of its own; export it with them inlined")
    graphs = [part for part in parts if part.number == GRAPH]
    if not graphs:
        raise FungraspError("not an ONNX file: it has no graph")
    for graph in graphs:
        for node in message_fields(data, graph.start, graph.end):
            if node.number == NODE:
                _check_node(data, node)


def _check_node(data: bytes, node: Field) -> None:
    for field in message_fields(data, node.start, node.end):
        text = one_line(data[field.start : field.end].decode(errors="replace"), 40)
        if field.number == DOMAIN and field.start < field.end and text != "ai.onnx":
            raise FungraspError(f"an operator is of the domain '{text}'; only standard ONNX ones are run")
        if field.number == OPERATOR and text not in OPERATORS:
            raise FungraspError(
                f"the operator '{text}' is none of the arithmetic, layers and cells that are run"
            )


def try_network(data: bytes) -> None:
    """Run a model once for two worlds in a limited child process, because intermediate results of a small
    file may be large.

    Raises:
        FungraspError: the model can't be run within the limits.
    """
    name = hashlib.sha256(data).digest()
    if name in _tried:
        return
    with tempfile.NamedTemporaryFile(suffix=".onnx") as file:
        file.write(data)
        file.flush()
        run_limited("network", file.name, "network", len(data))
    _tried.add(name)


def _varint(data: bytes, position: int, end: int) -> tuple[int, int]:
    """Return the base-128 varint at ``position``, low bits first, and the offset after it."""
    value = 0
    for shift, byte in enumerate(data[position : min(position + 10, end)]):
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, position + shift + 1
    raise _broken(position)


def _broken(position: int) -> FungraspError:
    return FungraspError(f"not an ONNX file, or damaged or cut off (at byte {position})")
