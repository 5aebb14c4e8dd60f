"""``python -m benchmarks.documents.viewer_pictures``: pictures of the interactive pages, into docs/images.

It needs Chromium (``apt-get install chromium``) and Playwright, which drives it.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import fungrasp
from fungrasp.cli.main import main as main_program
from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE, builtin_truth
from fungrasp.viewer.choose_page import perceived_capture
from fungrasp.viewer.server import Viewer

ARGUMENTS = (
    "--no-sandbox --disable-gpu --disable-background-networking --disable-component-update --disable-sync "
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
)
"""Of Chromium: no network of its own, and WebGL on the processor."""

QUALITY = 82
"""Of the JPEG files, 0 to 100."""

PATIENCE = 180_000
"""Time for a page to say something [ms]."""


@dataclass(frozen=True)
class Picture:
    """A page, and what is done in it before the picture is taken."""

    name: str
    """Of the file, without its suffix."""
    view: Callable[[Path], Viewer]
    """Serves the page; takes a folder for files."""
    act: Callable[[Any, Viewer], None]
    """Clicks in the browser's page."""
    width: int = 1280
    """[pixels]"""
    height: int = 760
    """[pixels]"""


def take(picture: Picture, browser: Any, out: Path) -> Path:
    """One picture.

    Args:
        picture: which.
        browser: Playwright's.
        out: folder.
    """
    from PIL import Image

    with TemporaryDirectory() as folder, picture.view(Path(folder)) as viewer:
        page = browser.new_page(viewport={"width": picture.width, "height": picture.height})
        page.set_default_timeout(PATIENCE)
        page.goto(viewer.url)
        page.wait_for_selector("text=Software WebGL")
        page.click(".mantine-Notification-closeButton")
        picture.act(page, viewer)
        time.sleep(3.0)
        shot = page.screenshot()
        page.close()
    path = out / f"{picture.name}.jpg"
    Image.open(BytesIO(shot)).convert("RGB").save(path, quality=QUALITY, optimize=True)
    return path


def _grasps(hand: str = "allegro", row: int = 0) -> Viewer:
    human = fungrasp.builtin_grasps()
    order = [row, *(i for i in range(len(human)) if i != row)]
    return fungrasp.view(human[order], hand=hand, port=0, wait=False)  # type: ignore[return-value]


def _result(folder: Path) -> Viewer:
    human = fungrasp.builtin_grasps()[np.arange(0, 120, 10)]
    objects = fungrasp.load_objects(human)
    robot = fungrasp.retarget(human, objects, "shadow")
    result = fungrasp.evaluate(robot, objects, "reference", "reality")
    return fungrasp.view(result, port=0, wait=False)  # type: ignore[return-value]


def _play(page: Any, viewer: Viewer) -> None:
    page.wait_for_selector("text=retargeted in")
    page.click("text=Lift")
    page.click("button:has-text('Play')")
    page.wait_for_selector("text=/lifted and held|failed/")


def _replay(page: Any, viewer: Viewer) -> None:
    page.click("button:has-text('failed')")
    page.wait_for_selector("text=/failed: /", state="attached")
    while not any(each._player.status.content.startswith("**") for each in viewer.pages):  # type: ignore[attr-defined]
        time.sleep(0.2)


def _compare(page: Any, viewer: Viewer) -> None:
    page.wait_for_selector("text=retargeted in")
    grasps: Any = viewer.pages[0]
    grasps._other.value = "shadow"
    grasps._on_hand()
    while len(grasps._robots) < 2 or grasps.worker.busy:
        time.sleep(0.2)
    page.wait_for_selector("text=retargeted in")


def _wait(words: str) -> Callable[[Any, Viewer], None]:
    return lambda page, viewer: page.wait_for_selector(f"text={words}")


def _capture(folder: Path) -> Viewer:
    return fungrasp.view(
        perceived_capture(str(BUILTIN_CAPTURE), builtin_truth().object_name), port=0, wait=False
    )  # type: ignore


def _log(folder: Path) -> Viewer:
    main_program(
        [
            "deploy",
            "--robot",
            "ur5e-allegro",
            "--policy",
            "plan",
            "--fast",
            "--log",
            str(folder / "lift.mcap"),
        ]
    )
    return fungrasp.view(folder / "lift.mcap", port=0, wait=False)  # type: ignore[return-value]


PICTURES = (
    Picture("view-grasp", lambda folder: _grasps(), _wait("retargeted in")),
    Picture("view-compare", lambda folder: _grasps(), _compare),
    Picture("view-episode", lambda folder: _grasps(row=5), _play),
    Picture("view-result", _result, _replay),
    Picture("view-capture", _capture, _wait("/✓|nothing was found/")),
    Picture("view-log", _log, _wait("/no fault|fault: /")),
    Picture("view-hand", lambda folder: fungrasp.view("leap", port=0, wait=False), _wait("driven joints")),  # type: ignore
    Picture("view-phone", lambda folder: _grasps(), _wait("retargeted in"), 390, 780),
)
"""All of them."""


def main(names: Sequence[str]) -> None:
    """Take some, or all.

    Args:
        names: of pictures; all if empty.

    Raises:
        FungraspError: there is no browser, or no such picture.
    """
    known = {picture.name: picture for picture in PICTURES}
    wrong = set(names) - set(known)
    path = shutil.which("chromium")
    if wrong or path is None:
        raise FungraspError(f"no picture {wrong}" if wrong else "no browser: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS.split(), headless=True)
        for name in names or known:
            print(take(known[name], browser, Path("docs/images")))
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
