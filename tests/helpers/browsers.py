"""A real browser for tests of pages: Debian's Chromium, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
"""Of Chromium: no network of its own, and WebGL on the processor."""


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser without a window; the test is skipped where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="no Playwright to drive a browser with")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("no browser: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS, headless=True)
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A page in the browser, and what it complained about."""

    def __init__(self, browser: Any, url: str, width: int = 1280, height: int = 800):
        self.complaints: list[str] = []
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.on("console", lambda m: m.type == "error" and self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)

    def sees(self, words: str, seconds: float = 60.0) -> str:
        """Wait until there is a text; gives it."""
        element = self.page.wait_for_selector(f"text={words}", timeout=1000 * seconds)
        return element.inner_text()

    def click(self, selector: str) -> None:
        """Click something."""
        self.page.click(selector, timeout=20_000)

    def close(self) -> None:
        """The browser's tab is closed."""
        self.page.close()
