"""Warnings of commands: one line on stderr for each kind."""

from __future__ import annotations

import logging
import sys

NAMED = 6
"""Maximum number of files or objects named in one line."""


class WarningLines(logging.Handler):
    """Prints warnings as ``fungrasp: warning: ...``, each only once. If several files or objects share a
    warning ("%s: no thickness"), one more line at the end lists the others."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._subjects: dict[str, list[str]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Print a new kind of warning; collect the subjects of known kinds."""
        message, subject = record.getMessage(), ""
        if isinstance(record.args, tuple) and record.args and record.msg.startswith("%s: "):
            subject = str(record.args[0])
        subjects = self._subjects.setdefault(message.removeprefix(f"{subject}: "), [])
        if not subjects:
            sys.stderr.write(f"fungrasp: warning: {message}\n")
        if subject not in subjects:
            subjects.append(subject)

    def __enter__(self) -> WarningLines:
        logging.getLogger("fungrasp").addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        logging.getLogger("fungrasp").removeHandler(self)
        for words, subjects in self._subjects.items():
            others = subjects[1:]
            if others:
                more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
                sys.stderr.write(f"fungrasp: warning: also {', '.join(others[:NAMED])}{more}: {words}\n")
