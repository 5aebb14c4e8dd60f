"""The function ``view``: results of functions and commands in a browser or as a static page."""

from __future__ import annotations

import contextlib
import gc
import io
import logging
import socket
import sys
import threading
import time
import warnings
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeAlias

from fungrasp.core.errors import FungraspError
from fungrasp.viewer.page import BrowserPage

if TYPE_CHECKING:
    from viser import ClientHandle, SceneApi

    from fungrasp.evaluation import LiftTestResult, Trajectory
    from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects
    from fungrasp.hands import Hand
    from fungrasp.perception.perceived import Perceived
    from fungrasp.task import GraspPlan

_log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
"""Loopback address."""

PORTS = range(8080, 8100)
"""Default ports; the first free one is used."""

WIDE = 700
"""Minimum window width for controls beside the scene [pixels]."""

_SHEET = 'div[style*="position: fixed"][style*="max-height: 60%"]'
NARROW = f"""<style>@media (max-width: 36em) {{
  {_SHEET} {{ width: 100% !important; max-height: 46% !important; }}
  {_SHEET} div[style*="width: 20em"] {{ width: 100% !important; }}
}}</style>"""
"""Style for phones, where viser's controls would cover most of the scene: a sheet as wide as the screen,
below the scene, that folds with a tap on its title."""

MISSING = 'the interactive page needs packages that are not installed: pip install ".[viewer]" in the clone'


class Viewer:
    """A running server. Call ``close``, or use it as a context manager."""

    def __init__(
        self,
        make_page: Callable[[ClientHandle], BrowserPage],
        title: str = "fungrasp",
        host: str = LOOPBACK,
        port: int | None = None,
    ):
        """
        Args:
            make_page: creates the page of a browser when it connects.
            title: title of the browser's tab and of the panel.
            host: address to listen on. Default: reachable from this machine only.
            port: 0 for any free port; the first free one of ``PORTS`` if None.

        Raises:
            FungraspError: the extra is not installed, or the port can't be used.
        """
        try:
            import viser
        except ImportError as error:
            raise FungraspError(f"{MISSING} ({error})") from error
        port = _first_free_port(host) if port is None else _free_port(host, port)
        logging.getLogger("websockets").setLevel(logging.ERROR)
        # A browser may disconnect while its page is still drawing.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        self._server.gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, brand_color=(32, 96, 150)
        )
        _light(self._server.scene)
        self._host, self._make_page, self._pages = host, make_page, dict[int, BrowserPage]()
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._server.on_client_connect(self._open)
        self._server.on_client_disconnect(self._leave)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = "localhost" if self._host in (LOOPBACK, "0.0.0.0") else self._host
        return f"http://{host}:{self._server.get_port()}"

    @property
    def summary(self) -> str:
        """Address of the page and who can access it, in a sentence."""
        who = (
            "only this machine reaches it" if self._host == LOOPBACK else "everyone in the network reaches it"
        )
        return f"{self.url} ({who})"

    @property
    def pages(self) -> list[BrowserPage]:
        """Pages of the connected browsers."""
        with self._lock:
            return list(self._pages.values())

    def wait(self) -> None:
        """Wait until the viewer is closed or Ctrl-C is pressed."""
        try:
            while not self._closed.wait(0.5):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the server and close all pages."""
        self._closed.set()
        for page in self.pages:
            page.close()
        with self._lock:
            self._pages.clear()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="600" style="border:0"></iframe>'

    def _open(self, client: ClientHandle) -> None:
        start = time.perf_counter()
        client.gui.add_html(NARROW)
        if client.camera.image_width >= WIDE:
            client.gui.main_panel.dock_right()
        try:
            page = self._make_page(client)
        except FungraspError as error:
            client.add_notification("Not possible", str(error), color="red", auto_close_seconds=None)
            return
        with self._lock:
            gone = client.client_id not in self._server.get_clients()
            if not gone:
                self._pages[client.client_id] = page
        if gone:
            page.close()
        _log.info("page %d made in %.2f s", client.client_id, time.perf_counter() - start)

    def _leave(self, client: ClientHandle) -> None:
        with self._lock:
            page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.close()
            # Handles and their callbacks are reference cycles.
            del page
            gc.collect()


def _light(scene: SceneApi) -> None:
    """Add sky light and lamps at both sides. viser's default environment map and shadows take seconds in
    browsers without a GPU."""
    scene.configure_environment_map(None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(150, 150, 160), intensity=2.2)
    for side, color, intensity in ((1.0, (255, 246, 235), 1.6), (-1.0, (225, 235, 255), 0.8)):
        lamp = "warm" if side > 0 else "cold"
        scene.add_light_directional(f"/{lamp}", color=color, intensity=intensity, position=(side, -0.8, 1.5))


def _first_free_port(host: str) -> int:
    for port in PORTS:
        try:
            return _free_port(host, port)
        except FungraspError:
            continue
    return _free_port(host, 0)


def _free_port(host: str, port: int) -> int:
    """Return a port that is free.

    Raises:
        FungraspError: the port is in use, or the address is not of this machine.
    """
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        words = getattr(error, "strerror", None) or error
        raise FungraspError(
            f"the page can't be served at {host}:{port}: {words}; choose another port"
        ) from error


Viewable: TypeAlias = "AnyGrasps | GraspPlan | LiftTestResult | Trajectory | Perceived | Hand | str | Path"
"""Types that can be viewed. A path may be that of grasps, plans, a result, a recorded episode, a deployment
log, a capture or a hand."""


def view(
    what: Viewable | None = None,
    objects: Objects = None,
    *,
    out: str | Path | None = None,
    hand: str | Hand = "allegro",
    host: str = LOOPBACK,
    port: int | None = None,
    browser: bool = False,
    wait: bool | None = None,
) -> Viewer | Path:
    """View grasps, plans, results, episodes, captures or hands in a browser, or write a page.

    Args:
        what: grasps (a set or a single one), plans, a result, a recorded episode, the result of ``perceive``,
            a hand, or the path of one of their files, a deployment log or a capture. None: the built-in
            grasps.
        objects: objects of grasps or plans, as for ``retarget``. A result has its own.
        out: self-contained HTML file to write instead, for grasps and their files, results and perceived
            grasps.
        hand: initial robot hand for human grasps.
        host: address to listen on. Default: reachable from this machine only.
        port: 0 for any free port; the first free one from 8080 if None.
        browser: open a browser.
        wait: block until Ctrl-C. None: only in scripts in a terminal.

    Returns:
        The running server (call ``close``), or the path of the written page.

    Raises:
        FungraspError: wrong type or suffix, a missing object, a port in use, a file can't be read or written,
            or the extra ``viewer`` is missing.
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
        # Not a daemon thread: Python can't exit during a compilation.
        threading.Thread(target=page.prepare, name="fungrasp prepares").start()
    if browser:
        webbrowser.open(viewer.url)
    if wait is None:
        wait = not hasattr(sys, "ps1") and "ipykernel" not in sys.modules and sys.stdin.isatty()
    if wait:
        sys.stderr.write(f"{page.title}: {viewer.summary}; Ctrl-C ends it\n")
        viewer.wait()
    return viewer
