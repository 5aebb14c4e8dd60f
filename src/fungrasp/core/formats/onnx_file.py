"""The bytes of an ONNX file, read without the package ``onnx`` and without running anything.

An ONNX file is one protocol-buffers message. Only what safety and the policy card need is decoded: where a
metadata entry lies, which operators there are, and whether a tensor points to another file. The numbers of
the fields are those of the public schema, onnx.proto.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from typing import NamedTuple

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import one_line
from fungrasp.core.formats.sandbox import run_limited

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
GRAPH, METADATA, FUNCTION = 7, 14, 25
DEFAULT_DOMAINS = ("", "ai.onnx")

LARGEST = 200_000_000
"""Bytes of the largest model that is run."""

MOST_MESSAGES = 20_000
"""Most nodes, attributes and tensors of a model together."""

OPERATORS = frozenset(
    """
    Abs Add And ArgMax ArgMin Cast Ceil Clip Concat Constant ConstantOfShape Cos Div Elu Equal Erf Exp Expand
    Flatten Floor GRU Gather Gelu Gemm Greater GreaterOrEqual HardSigmoid HardSwish Identity LSTM
    LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max Mean Min Mish Mul Neg Not Or Pow
    RNN Reciprocal ReduceMax ReduceMean ReduceMin ReduceSum Relu Reshape Round Selu Shape Sigmoid Sign Sin
    Slice Softmax Softplus Softsign Split Sqrt Squeeze Sub Sum Swish Tan Tanh Transpose Unsqueeze Where
    """.split()  # noqa: SIM905
)
"""What a network that is run may be made of: no loops, no branches, no random numbers."""

_tried: set[bytes] = set()
"""Digests of the models that ``try_network`` has run."""

CHILDREN: dict[str, dict[int, str]] = {
    "model": {GRAPH: "graph"},
    "graph": {1: "node", 5: "tensor", 15: "sparse tensor"},
    "node": {5: "attribute"},
    "attribute": {
        5: "tensor",
        6: "graph",
        10: "tensor",
        11: "graph",
        22: "sparse tensor",
        23: "sparse tensor",
    },
    "sparse tensor": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
"""Messages that can lie inside a message, by field number."""
OPERATOR, DOMAIN = 4, 7
"""Of a node."""
EXTERNAL_DATA, DATA_LOCATION = 13, 14
"""Of a tensor."""


class Field(NamedTuple):
    """One field of a message."""

    number: int
    """Number of the field in the schema."""
    kind: int
    """``VARINT``, ``FIXED64``, ``BYTES`` or ``FIXED32``."""
    first: int
    """Offset of the field with its tag."""
    start: int
    """Offset of its content."""
    end: int
    """Offset after its content."""


def message_fields(data: bytes, start: int = 0, end: int | None = None) -> Iterator[Field]:
    """The fields of the message at ``data[start:end]``.

    Raises:
        FungraspError: these bytes are no message.
    """
    end = len(data) if end is None else end
    position = start
    while position < end:
        first = position
        tag, position = _varint(data, position, end)
        number, kind = tag >> 3, tag & 7
        if kind == VARINT:
            _, stop = _varint(data, position, end)
        elif kind == BYTES:
            size, position = _varint(data, position, end)
            stop = position + size
        elif kind in (FIXED32, FIXED64):
            stop = position + (4 if kind == FIXED32 else 8)
        else:
            raise _broken(first)
        if number == 0 or stop > end:
            raise _broken(first)
        yield Field(number, kind, first, position, stop)
        position = stop


def check_harmless(data: bytes) -> None:
    """Refuse a model that is more than a network: the operators must be of ``OPERATORS``, so it has no loops.

    Raises:
        FungraspError: these bytes are no ONNX model, it has functions, other operators, operators outside the
            default ONNX domain, too many of them, or tensors that lie in another file or declare other sizes
            than they have; the message names the first.
    """
    if len(data) > LARGEST:
        raise FungraspError(f"it has {len(data) / 1e6:,.0f} MB; at most {LARGEST / 1e6:,.0f} are run")
    waiting = [("model", 0, len(data))]
    graphs = messages = 0
    while waiting:
        message, start, end = waiting.pop()
        messages += 1
        if messages > MOST_MESSAGES:
            raise FungraspError(f"the model has more than {MOST_MESSAGES} nodes, attributes and tensors")
        fields = list(message_fields(data, start, end))
        if message == "node":
            _check_node(data, fields)
        elif message == "tensor":
            _check_tensor(data, fields)
        elif message == "model" and any(field.number == FUNCTION for field in fields):
            raise FungraspError("the model defines functions of its own; export it with them inlined")
        graphs += message == "graph"
        children = CHILDREN[message]
        waiting += [
            (children[field.number], field.start, field.end)
            for field in fields
            if field.number in children and field.kind == BYTES
        ]
    if not graphs:
        raise FungraspError("not an ONNX file: it has no graph")
    if graphs > 1:
        raise FungraspError("the model has graphs inside its graph: loops or branches, which are not run")


def metadata(data: bytes) -> dict[str, str]:
    """The metadata entries of an ONNX model.

    Raises:
        FungraspError: these bytes are no ONNX model, or an entry is no text.
    """
    found = {}
    for field in message_fields(data):
        if field.number == METADATA and field.kind == BYTES:
            entry = {part.number: part for part in message_fields(data, field.start, field.end)}
            key, value = (data[entry[i].start : entry[i].end] if i in entry else b"" for i in (1, 2))
            try:
                found[key.decode()] = value.decode()
            except UnicodeDecodeError as error:
                raise FungraspError(f"its metadata is no text in UTF-8: {error.reason}") from error
    return found


def try_network(data: bytes) -> None:
    """Run a model once, in a child process with limits, for two worlds: what it computes between its weights
    and its outputs may be large, however small the file.

    Raises:
        FungraspError: it can't be run in the time and memory there is.
    """
    name = hashlib.sha256(data).digest()
    if name in _tried:
        return
    with tempfile.NamedTemporaryFile(suffix=".onnx") as file:
        file.write(data)
        file.flush()
        run_limited("network", file.name, "network", len(data))
    _tried.add(name)


def _check_node(data: bytes, fields: list[Field]) -> None:
    for field in fields:
        domain = _text(data, field) if field.number == DOMAIN else ""
        if domain not in DEFAULT_DOMAINS:
            operator = next((_text(data, other) for other in fields if other.number == OPERATOR), "")
            raise FungraspError(
                f"the operator '{operator}' is of the domain '{domain}'; only standard ONNX operators are run"
            )
        if field.number == OPERATOR and _text(data, field) not in OPERATORS:
            operator = one_line(_text(data, field), 40)
            raise FungraspError(
                f"the operator '{operator}' is none of the arithmetic, layers and cells that are run"
            )


def _check_tensor(data: bytes, fields: list[Field]) -> None:
    for field in fields:
        located = field.number == DATA_LOCATION and _varint(data, field.start, field.end)[0] != 0
        if located or field.number == EXTERNAL_DATA:
            raise FungraspError("the weights lie in another file; export them into the ONNX file itself")


def _text(data: bytes, field: Field) -> str:
    return data[field.start : field.end].decode(errors="replace")


def _varint(data: bytes, position: int, end: int) -> tuple[int, int]:
    """The integer at ``position``, seven bits a byte, low ones first, and the offset after it."""
    value = 0
    for shift in range(0, 70, 7):
        if position + shift // 7 >= end:
            break
        byte = data[position + shift // 7]
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position + shift // 7 + 1
    raise _broken(position)


def _broken(position: int) -> FungraspError:
    return FungraspError(f"not an ONNX file, or damaged or cut off (at byte {position})")
