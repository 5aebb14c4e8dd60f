"""Exceptions for users. Messages name the mistake and the valid input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FungraspError(ValueError):
    """Invalid input. The message is one line; the command line prints it and exits with status 2."""


class UnknownNameError(FungraspError):
    """Unknown name."""

    def __init__(self, kind: str, given: str, known: Iterable[str], remedy: str = ""):
        """
        Args:
            kind: kind of name, singular ("hand", "object", ...).
            remedy: sentence at the end of the message.
        """
        names = sorted(known)
        near = difflib.get_close_matches(given.lower(), names, n=1, cutoff=0.5)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        super().__init__(
            f"unknown {kind} '{given}'.{hint} Known: {', '.join(names) or 'none'}. {remedy}".rstrip()
        )
