"""Options that may be given with a value or without one."""

from __future__ import annotations

from typing import Any

import tyro


def optional_value(metavar: str, default: str, what: str) -> Any:
    """How tyro reads an option that stands for a default where no value follows; for ``Annotated[str | None,
    ...]``.

    Args:
        metavar: of the value, in the help.
        default: where none follows.
        what: may be given only once, "folder".
    """

    def one(words: list[str]) -> str:
        if len(words) > 1:
            raise ValueError(f"give one {what}")
        return words[0] if words else default

    return tyro.constructors.PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=one,
        is_instance=lambda value: value is None or isinstance(value, str),
        str_from_instance=lambda value: [str(value)],
    )
