"""Checks of files from unknown sources (size, kind, nesting), and a decorator that converts other errors."""

from __future__ import annotations

import functools
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from fungrasp.core.errors import FungraspError

DEEPEST = 32
"""Maximum nesting depth in JSON, TOML and YAML."""

MOST_NODES = 2_000_000
"""Maximum number of values in JSON, TOML and YAML; a value that is referenced twice counts twice."""

LARGEST_INTEGER = 2**63 - 1


def check_file(path: str | Path, what: str, largest: int) -> Path:
    """Return the path after checking that it is a file of at most ``largest`` bytes.

    Raises:
        FungraspError: the file does not exist, is not a regular file or is larger.
    """
    path = Path(path)
    try:
        status = path.stat()
    except FileNotFoundError as error:
        raise FungraspError(f"the {what} {one_line(path)} does not exist") from error
    except (OSError, ValueError) as error:
        raise cannot_read(path, error) from error
    if stat.S_ISDIR(status.st_mode):
        raise FungraspError(f"the {what} {one_line(path)} is a folder: give a file in it")
    if not stat.S_ISREG(status.st_mode):
        raise FungraspError(f"the {what} {one_line(path)} is not a regular file")
    if status.st_size > largest:
        raise FungraspError(
            f"the {what} {one_line(path)} has {status.st_size / 1e6:,.0f} MB; at most {largest / 1e6:,.0f} "
            "are read"
        )
    return path


def read_bytes(path: str | Path, what: str, largest: int) -> bytes:
    """Read all bytes of a file.

    Raises:
        FungraspError: see ``check_file``; or the file can't be read.
    """
    path = check_file(path, what, largest)
    try:
        with path.open("rb") as stream:
            return stream.read(largest)
    except OSError as error:
        raise cannot_read(path, error) from error


def read_text(path: str | Path, what: str, largest: int = 4_000_000) -> str:
    """Read a UTF-8 text file, with or without a byte-order mark.

    Raises:
        FungraspError: see ``read_bytes``; or the file is not UTF-8 text.
    """
    try:
        return read_bytes(path, what, largest).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise FungraspError(f"the {what} {one_line(path)} is not UTF-8 text: {error.reason}") from error


def check_tree(tree: Any, where: str) -> None:
    """Check plain data for values that other code may not handle.

    Raises:
        FungraspError: containers are nested too deeply, there are too many values, an integer exceeds 64
            bits, or text has an unpaired surrogate.
    """
    waiting = [(tree, 0)]
    nodes = 0
    while waiting:
        node, depth = waiting.pop()
        nodes += 1
        if nodes > MOST_NODES:
            raise FungraspError(f"{where} holds more than {MOST_NODES:,} values")
        if isinstance(node, dict | list):
            if depth == DEEPEST:
                raise FungraspError(f"{where} is nested more than {DEEPEST} levels deep")
            children = [*node.values(), *node] if isinstance(node, dict) else node
            if nodes + len(waiting) + len(children) > MOST_NODES:
                raise FungraspError(f"{where} holds more than {MOST_NODES:,} values")
            waiting += [(child, depth + 1) for child in children]
        elif isinstance(node, int) and abs(node) > LARGEST_INTEGER:
            raise FungraspError(f"{where} holds an integer of more than 64 bits")
        elif isinstance(node, str) and not _whole(node):
            raise FungraspError(f"{where} holds text with half a character (an unpaired surrogate)")


def one_line(obj: Any, longest: int = 300) -> str:
    """Return the text of an exception, path or other object as one line of limited length, never empty."""
    text = " ".join(str(obj).split()) or type(obj).__name__
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= longest else f"{text[:longest]} ..."


def is_plain_name(text: str) -> bool:
    """Return whether a text can be a name: not empty, not a path, printable, no spaces at its ends."""
    plain = text.isprintable() and text == text.strip() and not {"/", "\\"} & set(text)
    return plain and text not in ("", ".", "..")


def cannot_read(path: str | Path, error: Exception) -> FungraspError:
    """Return the error for a file that the system can't read."""
    return FungraspError(
        f"cannot read {one_line(path)}: {one_line(getattr(error, 'strerror', None) or error)}"
    )


def _whole(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


Reader = TypeVar("Reader", bound=Callable[..., Any])

_SENSELESS = (
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    AttributeError,
    RuntimeError,
    MemoryError,
)
"""Exceptions that invalid values raise in code that computes with them."""


def guarded(what: str) -> Callable[[Reader], Reader]:
    """Decorate a reader whose first argument is a path, so that exceptions due to file content become
    one-line ``FungraspError`` exceptions with the cause attached.

    Args:
        what: kind of file, for messages: "hand file".
    """

    def decorate(reader: Reader) -> Reader:
        @functools.wraps(reader)
        def read(path: Any, *args: Any, **options: Any) -> Any:
            try:
                return reader(path, *args, **options)
            except FungraspError as error:
                if "\n" in str(error):
                    raise FungraspError(one_line(error, 1000)) from error
                raise
            except OSError as error:
                raise FungraspError(f"cannot read the {what} {one_line(path)}: {one_line(error)}") from error
            except _SENSELESS as error:
                where = f"the {what} {one_line(path)}"
                raise FungraspError(f"{where} makes no sense: {one_line(error)}") from error

        return read  # pyright: ignore[reportReturnType]

    return decorate
