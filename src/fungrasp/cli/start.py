"""Entry point. Ctrl-C during imports ends the program without a traceback, as it does later."""

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
        # Importing takes a tenth of a second or more, so it happens inside the try.
        from fungrasp.cli.main import main

        return main()
    except KeyboardInterrupt:
        print("fungrasp: interrupted", file=sys.stderr)
        return INTERRUPTED
