"""``python -m benchmarks.viewer``: how soon the interactive page is there, how fast a robot hand follows, and
what is left after browsers have come, clicked and gone.

It needs Chromium (``apt-get install chromium``) and Playwright. Browsers and server share the processors, and
without a GPU the browsers draw on them as well.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import fungrasp
from benchmarks.documents.viewer_pictures import ARGUMENTS
from fungrasp.errors import FungraspError
from fungrasp.viewer.server import Viewer

PATIENCE = 120_000
"""Time for a page to say something [ms]."""


@dataclass(frozen=True)
class ViewerBenchmark:
    """Time to the page, rate of live retargeting, memory after random clicks."""

    pages: tuple[int, ...] = (1, 5)
    """Numbers of pages in which something is dragged at once."""
    seconds: float = 10.0
    """Time of dragging [s]."""
    clicking: float = 60.0
    """Time of random clicks in three browsers [s]; 0 for none."""
    seed: int = 0
    """Of the clicks."""
    json: Path | None = None
    """File for the numbers."""

    def run(self) -> None:
        """Measure, and print."""
        from playwright.sync_api import sync_playwright

        path = shutil.which("chromium")
        if path is None:
            raise FungraspError("no browser: apt-get install chromium")
        numbers: dict[str, Any] = {}
        human = fungrasp.builtin_grasps()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS.split(), headless=True)
            viewer: Any = fungrasp.view(human, port=0, wait=False)
            with viewer:
                numbers["page_s"] = self._page_times(browser, viewer)
                for count in self.pages:
                    numbers[f"follow_hz_{count}"] = self._rates(browser, viewer, count)
                if self.clicking:
                    numbers["clicks"] = self._clicks(browser, viewer)
            browser.close()
        print(json.dumps(numbers, indent=1))
        if self.json is not None:
            self.json.write_text(json.dumps(numbers, indent=1) + "\n")

    def _page_times(self, browser: Any, viewer: Viewer) -> list[tuple[float, float]]:
        """From the request to the page's controls, and to the hand that can be dragged, for several visits
        [s]."""
        times = []
        for _ in range(3):
            page = browser.new_page(viewport={"width": 800, "height": 600})
            start = time.perf_counter()
            page.goto(viewer.url)
            page.wait_for_selector("text=Compare with", timeout=PATIENCE)
            controls = round(time.perf_counter() - start, 2)
            page.wait_for_selector("text=retargeted in", timeout=PATIENCE)
            times.append((controls, round(time.perf_counter() - start, 2)))
            page.close()
        return times

    def _rates(self, browser: Any, viewer: Viewer, count: int) -> list[float]:
        """How often per second each page's robot hand follows, while all objects are dragged at 20 Hz."""
        tabs = [browser.new_page(viewport={"width": 480, "height": 360}) for _ in range(count)]
        for tab in tabs:
            tab.goto(viewer.url)
        for tab in tabs:
            tab.wait_for_selector("text=retargeted in", timeout=PATIENCE)
        pages: Any = viewer.pages
        followed = [0] * len(pages)

        def counted(number: int, follow: Any) -> Any:
            def job() -> None:
                follow()
                followed[number] += 1

            return job

        for number, page in enumerate(pages):
            page._follow = counted(number, page._follow)
        start, step = time.perf_counter(), 0
        while time.perf_counter() - start < self.seconds:
            for page in pages:
                handle = page._object_handle
                handle.position = page._picked.object_pose[:3] + np.array([0, 0.02 * np.sin(0.2 * step), 0])
                page._on_handles()
            step += 1
            time.sleep(max(start + 0.05 * step - time.perf_counter(), 0))
        took = time.perf_counter() - start
        for tab in tabs:
            tab.close()
        return [round(n / took, 1) for n in followed]

    def _clicks(self, browser: Any, viewer: Viewer) -> dict[str, Any]:
        """Random clicks in three browsers, that come anew now and then."""
        rng = np.random.default_rng(self.seed)
        complaints: list[str] = []
        memory, clicks, start = [_memory()], 0, time.perf_counter()
        tabs = [self._open(browser, viewer, complaints) for _ in range(3)]
        while time.perf_counter() - start < self.clicking:
            tab = int(rng.integers(3))
            if rng.random() < 0.05:
                tabs[tab].close()
                tabs[tab] = self._open(browser, viewer, complaints)
            _click(tabs[tab], rng)
            clicks += 1
            if clicks % 20 == 0:
                memory.append(_memory())
        for one in tabs:
            one.close()
        time.sleep(3.0)
        memory.append(_memory())
        left = len(viewer.pages)
        return {"clicks": clicks, "memory_mb": memory, "errors": complaints, "pages_left": left}

    def _open(self, browser: Any, viewer: Viewer, complaints: list[str]) -> Any:
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.on("console", lambda m: m.type == "error" and complaints.append(m.text[:200]))
        page.on("pageerror", lambda error: complaints.append(str(error)[:200]))
        page.goto(viewer.url)
        return page


def _click(page: Any, rng: np.random.Generator) -> None:
    """A click, a drag or a key, anywhere."""
    x, y = rng.uniform(0, 640), rng.uniform(0, 480)
    if rng.random() < 0.6:
        page.mouse.click(x, y)
    elif rng.random() < 0.6:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + rng.uniform(-80, 80), y + rng.uniform(-80, 80), steps=4)
        page.mouse.up()
    else:
        page.keyboard.press(str(rng.choice(["Tab", "Enter", "ArrowUp", "ArrowDown", "Space", "Escape"])))


def _memory() -> int:
    """Of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1_000_000


def main(arguments: Sequence[str] | None = None) -> None:
    """Run it."""
    tyro.cli(ViewerBenchmark, args=arguments).run()


if __name__ == "__main__":
    main()
