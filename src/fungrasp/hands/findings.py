"""What adding and checking a hand report; the finger that a name tells."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One fault or remark of a check."""

    severity: Severity
    """Error: the hand can't be used, or not rightly. Warning: probably a mistake. Note: good to know."""
    message: str
    """A sentence that names the body, joint or entry and the remedy."""


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
    """The finger that a body's name tells ("rh_ffproximal": "index"), or None."""
    match = _PATTERN.search(name.lower())
    return match.lastgroup if match else None
