"""Where the program begins: Ctrl-C while it still imports ends it as later, without a traceback."""

from __future__ import annotations

import sys

from fungrasp.cli import INTERRUPTED


def start() -> int:
    """Run the command line of this process.

    Returns:
        Exit status, as of ``fungrasp.cli.main.main``.

    Raises:
        SystemExit: as ``main``.
    """
    try:
        # Imports take a tenth of a second and more: inside, as all that follows.
        from fungrasp.cli.main import main

        return main()
    except KeyboardInterrupt:
        print("fungrasp: interrupted", file=sys.stderr)
        return INTERRUPTED
