"""Findings from adding and checking a hand; fingers by the names of bodies."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """A fault or remark of a check."""

    severity: Severity
    """"error": the hand cannot be used correctly; "warning": probably a mistake; "note": information."""
    message: str
    """Message with the body, joint or entry and the remedy."""


def error(message: str) -> Finding:
    """Return a finding of severity "error"."""
    return Finding("error", message)


def warning(message: str) -> Finding:
    """Return a finding of severity "warning"."""
    return Finding("warning", message)


def note(message: str) -> Finding:
    """Return a finding of severity "note"."""
    return Finding("note", message)


def listed(names: list[str], limit: int = 6) -> str:
    """Return names for a message, as in "'a', 'b' and 3 more"."""
    shown = ", ".join(f"'{name}'" for name in names[:limit])
    return shown if len(names) <= limit else f"{shown} and {len(names) - limit} more"


_WORDS = {
    "index": ("index", "ff", "fore"),
    "middle": ("middle", "mf"),
    "ring": ("ring", "rf"),
    "pinky": ("pinky", "pinkie", "little", "lf"),
    "thumb": ("thumb", "th"),
}
_PART = r"[^a-z]|base|hub|meta|knuckle|prox|mid|med|dist|tip|link|finger|j\d|$"
_PATTERN = re.compile(
    "|".join(rf"(?P<{name}>(?<![a-z])(?:{'|'.join(words)})(?={_PART}))" for name, words in _WORDS.items())
)


def finger_of(name: str) -> str | None:
    """Return the finger that a body is named after ("rh_ffproximal": "index"), or None."""
    match = _PATTERN.search(name.lower())
    return match.lastgroup if match else None
