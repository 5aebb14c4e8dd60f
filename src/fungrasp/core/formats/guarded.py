"""The last safeguard of a function that reads a foreign file."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import one_line

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
"""What values of a wrong type or size raise in code that computes with them."""


def guarded(what: str) -> Callable[[Reader], Reader]:
    """Decorator of a reader whose first argument is a path: what its content raises beyond ``FungraspError``
    becomes one, of one line and with the cause attached.

    Args:
        what: the reader reads, for messages: "hand file".
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
