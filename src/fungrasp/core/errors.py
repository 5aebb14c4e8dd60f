"""The one exception users meet: a sentence that names the thing and says what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class FungraspError(ValueError):
    """A mistake in what was given. The message is one line; the command line prints it and exits with 2."""


class UnknownNameError(FungraspError):
    """A name that is not in a registry."""

    def __init__(self, kind: str, given: str, known: Iterable[str]):
        """
        Args:
            kind: what was looked up, singular ("hand", "object", ...).
        """
        names = sorted(known)
        near = difflib.get_close_matches(given.lower(), names, n=1, cutoff=0.5)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        super().__init__(f"unknown {kind} '{given}'.{hint} Known: {', '.join(names)}.")
