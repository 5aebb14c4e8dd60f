"""Damage to files: of bytes, of text, of plain data, of arrays."""

from __future__ import annotations

import hashlib
import io
import json
import random
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

PIECES = (
    *(b"", b"\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"nan", b"-1", b"1e999", b"/dev/zero"),
    *(b"[" * 300, b"9" * 5000, b"Loop", b"If"),
)
WORDS = (
    "nan",
    "inf",
    "-1",
    "0",
    "1e300",
    "99999999999",
    "",
    "true",
    "../../x",
    "'",
    '"',
    "<",
    "[",
    "{",
    "9" * 5000,
)
VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 2**40, 10**400, 1e308, float("nan"), float("inf")),
    *("", "x", "\0", "../../x", "x" * 5000),
    *([], [[]], [None], [1, 2, 3], ["a"], {}, {"a": 1}, [[0.0] * 3] * 3),
)  # fmt: skip
TYPES = ("<f8", "<f4", "<i8", "|b1", "<U3", "|S1", "<c16", "<M8[s]", "|O", "<U1000000000")
SHAPES = ("(-1,)", "(1000000000000,)", "(99999999999999999999,)", "(True,)", "()", "(0, 3)", "(1.5,)")


def damaged(chance: random.Random, name: str, good: bytes) -> bytes:
    """A good file's bytes, damaged in a way that its format invites.

    Args:
        chance: of the damage.
        name: of the file; its suffix is the format.
        good: its bytes.
    """
    suffix = Path(name).suffix
    try:
        if suffix == ".npz" and chance.random() < 0.6:
            return _damaged_archive(chance, good)
        if suffix == ".npy" and chance.random() < 0.5:
            return _damaged_array(chance, good)
        if suffix == ".json" and chance.random() < 0.6:
            return json.dumps(_damaged_tree(chance, json.loads(good))).encode()
        if suffix in (".json", ".toml", ".xml", ".urdf", ".obj", ".csv", ".yml") and chance.random() < 0.6:
            return _damaged_text(chance, good.decode()).encode(errors="surrogatepass")
        if suffix == ".png" and chance.random() < 0.5:
            return _with_sums(_damaged_bytes(chance, good))
        if suffix == ".onnx" and chance.random() < 0.9:
            return _signed(_damaged_bytes(chance, good))
    except (ValueError, IndexError):
        pass
    return _damaged_bytes(chance, good)


def _damaged_bytes(chance: random.Random, good: bytes) -> bytes:
    data = bytearray(good)
    for _ in range(chance.choice((1, 1, 1, 2, 5))):
        at = chance.randrange(len(data) + 1)
        size = chance.choice((1, 2, 4, 30, 1000))
        action = chance.randrange(5)
        if action == 0:
            del data[at:]
        elif action == 1 and data:
            data[at : at + 1] = bytes([data[min(at, len(data) - 1)] ^ 1 << chance.randrange(8)])
        elif action == 2:
            data[at : at + size] = chance.randbytes(size)
        elif action == 3:
            data[at : at + size] = data[:size] * chance.choice((0, 2, 50))
        else:
            data[at : at + chance.choice((0, size))] = chance.choice(PIECES)
    return bytes(data)


def _damaged_text(chance: random.Random, text: str) -> str:
    for _ in range(chance.choice((1, 1, 3))):
        found = list(re.finditer(r"-?\d+\.?\d*" if chance.random() < 0.5 else r"[\w./-]+", text))
        if found and chance.random() < 0.7:
            token = chance.choice(found)
            new = chance.choice(WORDS) if chance.random() < 0.8 else chance.choice(found)[0]
            text = text[: token.start()] + new + text[token.end() :]
        else:
            lines = text.split("\n")
            at = chance.randrange(len(lines))
            lines[at : at + chance.choice((0, 1))] = [chance.choice(lines)] * chance.choice((0, 1, 3))
            text = "\n".join(lines)
    return text


def _damaged_tree(chance: random.Random, tree: Any) -> Any:
    for _ in range(chance.choice((1, 1, 2))):
        places: list[tuple[Any, Any]] = []
        waiting = [tree]
        while waiting:
            node = waiting.pop()
            if isinstance(node, dict | list):
                keys = list(node) if isinstance(node, dict) else range(len(node))
                places += [(node, key) for key in keys]
                waiting += [node[key] for key in keys]
        if not places or chance.random() < 0.02:
            return chance.choice(VALUES)
        node, key = chance.choice(places)
        action = chance.randrange(4)
        if action == 0:
            del node[key]
        elif action == 1:
            node[key] = [node[key]] * chance.choice((0, 1, 2, 20))
        else:
            node[key] = chance.choice(VALUES)
    return tree


def _damaged_archive(chance: random.Random, good: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(sorted(members))
    action = chance.randrange(8)
    if action == 0:
        del members[name]
    elif action == 1:
        members[chance.choice(("extra.npy", "../../x.npy", "hand.npy", ".npy", "readme.txt"))] = members[name]
    else:
        members[name] = _damaged_array(chance, members[name])
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _damaged_array(chance: random.Random, good: bytes) -> bytes:
    if chance.random() < 0.3:
        # A header that lies.
        text = good.decode("latin1")
        if chance.random() < 0.5:
            text = re.sub(r"'shape': \([^)]*\)", lambda _: f"'shape': {chance.choice(SHAPES)}", text, count=1)
        else:
            text = re.sub(r"'descr': '[^']*'", lambda _: f"'descr': '{chance.choice(TYPES)}'", text, count=1)
        return text.encode("latin1")
    array = np.load(io.BytesIO(good), allow_pickle=False)
    action = chance.randrange(9)
    if action == 0:
        array = array[..., None]
    elif action == 1:
        array = array.reshape(-1)
    elif action == 2 and array.ndim:
        array = array[: chance.randrange(len(array) + 1)]
    elif action == 3 and array.dtype.kind == "f" and array.size:
        array = array.copy()
        array.flat[chance.randrange(array.size)] = chance.choice((np.nan, np.inf, 1e300, -1e300, 0.0))
    elif action == 4 and array.dtype.kind == "f":
        array = array * chance.choice((0.0, -1.0, 1e3, 1e200))
    elif action == 5:
        array = np.zeros((0, *array.shape[1:]), array.dtype)
    elif action == 6:
        array = np.array(chance.choice((0, 1.5, "x", True)))
    elif action == 7 and array.dtype.kind in "fiub":
        array = array.astype(chance.choice(("f2", "i1", "u8", "?", "U3")))
    else:
        array = np.array([chance.choice(("", "../x", "x" * 3000, "a\nb", "\0"))] * max(array.size, 1))
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def _signed(data: bytes) -> bytes:
    """A policy whose digest is that of its bytes, as an attacker would write it."""
    head = b'{"sha256": "'
    at = data.find(head) + len(head)
    if at < len(head):
        return data
    digest = hashlib.sha256(data[:at] + b"0" * 64 + data[at + 64 :]).hexdigest()
    return data[:at] + digest.encode() + data[at + 64 :]


def _with_sums(data: bytes) -> bytes:
    """A PNG file whose chunks have the sums of what they hold."""
    result, at = data[:8], 8
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        body = data[at + 4 : at + 8 + size]
        result += data[at : at + 4] + body + zlib.crc32(body).to_bytes(4, "big")
        at += 12 + size
    return result
