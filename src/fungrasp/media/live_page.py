"""A page with a running camera's picture and what is missing in it, served to this computer only."""

from __future__ import annotations

import io
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

import numpy as np
from PIL import Image, ImageDraw

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_hand import BONES
from fungrasp.objects import ObjectModel
from fungrasp.perception.camera.live import LiveView
from fungrasp.perception.object_pose.known_object import MeshRays

HOST = "127.0.0.1"
"""Loopback: the camera's picture is for nobody else."""

QUALITY = 80
"""JPEG quality of the pictures."""

READY, MISSING = (60, 214, 125), (255, 90, 60)
"""Color of what is drawn over the picture when all is seen, and when something is missing; sRGB."""

_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>fungrasp: camera</title>
<style>
 body {margin: 0; background: #16181c; color: #eee; font: 1.5rem system-ui, sans-serif; text-align: center}
 img {max-width: 100%; max-height: 82vh; margin-top: 1vh}
 #count {font-size: 4rem; font-weight: bold; position: fixed; top: 2vh; right: 4vw; color: #3cd67d}
 .ready {color: #3cd67d} .missing {color: #ff9d7a}
</style>
<img id="picture" alt="the camera's picture"><div id="count"></div>
<p id="words" class="missing">the camera starts</p>
<script>
const by = (id) => document.getElementById(id);
let shown = -1;
async function look() {
  try {
    const state = await (await fetch("state.json", {cache: "no-store"})).json();
    by("words").textContent = state.words;
    by("words").className = state.ready ? "ready" : "missing";
    by("count").textContent = state.seconds_left === null ? "" : state.seconds_left;
    if (state.number !== shown && state.number > 0) {
      shown = state.number;
      by("picture").src = "picture.jpg?" + shown;
    }
    if (state.done) return;
  } catch (error) { by("words").textContent = "the program has ended"; return; }
  setTimeout(look, 100);
}
look();
</script></html>
"""


class LivePage:
    """Serves the page while it is open: ``with LivePage(model) as page: ... page.show(view)``."""

    def __init__(self, model: ObjectModel, port: int = 0):
        """
        Args:
            model: the object, whose outline is drawn where its pose is known.
            port: to serve at; 0 takes a free one.
        """
        self._rays, self._model, self._port = MeshRays(model.vertices, model.faces), model, port
        self._lock = threading.Lock()
        self._picture = b""
        self._state: dict[str, Any] = {
            "number": 0,
            "words": "the camera starts",
            "ready": False,
            "seconds_left": None,
            "done": False,
        }
        self._server: ThreadingHTTPServer | None = None

    def __enter__(self) -> Self:
        """Begin to serve.

        Raises:
            FungraspError: the port is in use.
        """
        try:
            self._server = ThreadingHTTPServer((HOST, self._port), self._handler())
        except OSError as error:
            raise FungraspError(f"the page can't be served at port {self._port}: {error.strerror}") from error
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop serving."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    @property
    def address(self) -> str:
        """Where the page is."""
        assert self._server is not None
        return f"http://{HOST}:{self._server.server_port}/"

    def show(self, view: LiveView) -> None:
        """Put a frame on the page."""
        data = io.BytesIO()
        Image.fromarray(self.drawn(view)).save(data, "JPEG", quality=QUALITY)
        left = view.seconds_left
        with self._lock:
            self._picture = data.getvalue()
            self._state |= {
                "number": self._state["number"] + 1,
                "words": view.words,
                "ready": not view.readiness.problems,
                "seconds_left": None if left is None else int(np.ceil(left)),
            }

    def say(self, words: str, *, done: bool = False) -> None:
        """Change the words. done: nothing more will come."""
        with self._lock:
            self._state |= {"words": words, "seconds_left": None, "ready": True, "done": done}

    def drawn(self, view: LiveView) -> np.ndarray:
        """The frame with the hand's skeleton and the object's outline on it, sRGB, shape [H, W, 3] uint8."""
        color = MISSING if view.readiness.problems else READY
        picture = view.frame.color.copy()
        if view.pose_camera_object is not None:
            picture[self._outline(view)] = color
        image = Image.fromarray(picture)
        if view.readiness.hand is not None:
            draw = ImageDraw.Draw(image)
            width = max(2, image.width // 240)
            for bone in view.readiness.hand.pixels[np.array(BONES)]:
                draw.line([(float(u), float(v)) for u, v in bone], fill=color, width=width)
        return np.array(image)

    def _outline(self, view: LiveView) -> np.ndarray:
        """Pixels of the object's outline, shape [H, W] bool."""
        lens, pose = view.frame.intrinsics, view.pose_camera_object
        assert pose is not None
        outline = np.zeros((lens.height, lens.width), bool)
        corners = lens.project(transform_points(pose, self._model.vertices))
        if not np.isfinite(corners).all():
            return outline
        size = np.array([lens.width, lens.height])
        low = np.clip(np.floor(corners.min(axis=0)) - 2, 0, size).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0)) + 3, 0, size).astype(int)
        u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        if not u.size:
            return outline
        rays = lens.deproject(np.stack([u, v], axis=-1).reshape(-1, 2), np.ones(u.size))
        hit = np.isfinite(self._rays.cast(pose[None], rays)[0]).reshape(u.shape)
        inner = hit.copy()
        inner[1:-1, 1:-1] &= hit[:-2, 1:-1] & hit[2:, 1:-1] & hit[1:-1, :-2] & hit[1:-1, 2:]
        outline[low[1] : high[1], low[0] : high[0]] = hit & ~inner
        return outline

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                # A page of another origin that has its name point here must not see the camera.
                if self.headers.get("Host", "").split(":")[0] not in (HOST, "localhost"):
                    self.send_error(403)
                    return
                with page._lock:
                    found = {
                        "/": ("text/html; charset=utf-8", _PAGE.encode()),
                        "/state.json": ("application/json", json.dumps(page._state).encode()),
                        "/picture.jpg": ("image/jpeg", page._picture),
                    }.get(self.path.split("?")[0])
                if found is None or not found[1]:
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Type", found[0])
                self.send_header("Content-Length", str(len(found[1])))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(found[1])

            def log_message(self, format: str, *args: Any) -> None:
                """Nothing: requests are no news."""

        return Handler
