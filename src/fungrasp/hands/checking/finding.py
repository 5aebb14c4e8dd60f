"""What a check reports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One fault or remark of a check."""

    severity: Severity
    """Error: the hand can't be used, or not rightly. Warning: probably a mistake. Note: good to know."""
    message: str
    """A sentence that names the body, joint or entry and the remedy."""


@dataclass(frozen=True)
class HandParts:
    """The bodies and sites of palm, fingers and tips, as far as they are known and exist in the model."""

    palm: str | None = None
    """Name of the palm body."""
    fingers: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Bodies from base to tip by finger name."""
    joints: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Site or body at the near end of each link, by finger name: only where they are not the links
    themselves."""
    tips: dict[str, str] = field(default_factory=dict)
    """Tip site or body by finger name."""


def error(message: str) -> Finding:
    """A finding that stops the hand from being used."""
    return Finding("error", message)


def warning(message: str) -> Finding:
    """A finding that probably is a mistake."""
    return Finding("warning", message)


def note(message: str) -> Finding:
    """A finding that is no fault."""
    return Finding("note", message)


def listed(names: list[str], limit: int = 6) -> str:
    """Names for a message: 'a', 'b' and 3 more."""
    shown = ", ".join(f"'{name}'" for name in names[:limit])
    return shown if len(names) <= limit else f"{shown} and {len(names) - limit} more"
