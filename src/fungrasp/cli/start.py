"""Entry point. Ctrl-C ends the program without a traceback, even during imports."""

from __future__ import annotations

import sys

from fungrasp.cli import INTERRUPTED


def start() -> int:
    """Run the command line of this process.

    Returns:
        Exit status, see ``fungrasp.cli.main.main``.

    Raises:
        SystemExit: see ``main``.
    """
    try:
        # Imports take a tenth of a second or more.
        from fungrasp.cli.main import main

        return main()
    except KeyboardInterrupt:
        print("fungrasp: interrupted", file=sys.stderr)
        return INTERRUPTED
