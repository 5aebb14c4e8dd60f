"""``view``: anything that a verb returns or a command writes, in a browser or as a page on disk."""

from __future__ import annotations

import sys
import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from fungrasp.viewer.server import LOOPBACK, Viewer

if TYPE_CHECKING:
    from fungrasp.evaluation import LiftTestResult, Trajectory
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.perceived import Perceived

Viewable: TypeAlias = (
    "HumanGraspSet | RobotGraspSet | LiftTestResult | Trajectory | Perceived | Hand | str | Path"
)
"""What can be looked at; a path is that of a file of grasps, a result, a recorded episode, a deployment's
log, a capture or a hand."""


def view(
    what: Viewable | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
    *,
    out: str | Path | None = None,
    hand: str | Hand = "allegro",
    host: str = LOOPBACK,
    port: int | None = None,
    browser: bool = False,
    wait: bool | None = None,
) -> Viewer | Path:
    """Look at something in a browser, where it can be dragged, played and compared; or write a page.

    Args:
        what: grasps, a result, a recorded episode, what ``perceive`` returned, a hand, or the path of one of
            their files, of a deployment's log or of a capture; the built-in grasps if None.
        objects: those of grasps, by name; built-in objects if None. A result has its own.
        out: HTML file to write in place of it, which needs no other file and no server; of grasps, a result
            or what was perceived.
        hand: that imitates human grasps at first.
        host: address to listen at; by default only this machine reaches the page.
        port: 0 for any that is free; the first free one from 8080 on if None.
        browser: whether to open a browser.
        wait: whether to go on only when Ctrl-C is pressed; if None, where this is a script at a terminal.

    Returns:
        The running server, which is closed with ``close``; or the path of the page that was written.

    Raises:
        FungraspError: something that can't be viewed, an object that is missing, a port in use, a file that
            can't be read or written, or the extra ``viewer`` is not installed.
    """
    if out is not None:
        from fungrasp.media.grasp_pages import write_view

        path = write_view(what, objects, out)
        if browser:
            webbrowser.open(path.absolute().as_uri())
        return path
    from fungrasp.viewer.choose_page import choose_page

    page = choose_page(what, objects, hand)
    viewer = Viewer(page.make, page.title, host, port)
    if page.prepare is not None:
        # Python can't end in the middle of a compilation: it waits for this thread.
        threading.Thread(target=page.prepare, name="fungrasp prepares").start()
    if browser:
        webbrowser.open(viewer.url)
    if wait is None:
        wait = not hasattr(sys, "ps1") and "ipykernel" not in sys.modules and sys.stdin.isatty()
    if wait:
        sys.stderr.write(f"{page.title}: {viewer.words}; Ctrl-C ends it\n")
        viewer.wait()
    return viewer
