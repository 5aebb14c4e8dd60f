"""A page for one browser connection."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from viser import ClientHandle, GuiApi

    from fungrasp.hands import Hand

_log = logging.getLogger(__name__)

FIELD_OF_VIEW = float(np.radians(42.0))
"""Vertical field of view of a page's camera [rad]."""

WIDE = 1.15
"""Aspect ratio (width / height) below which the camera moves back."""

UPRIGHT = 0.8
"""Aspect ratio below which a screen counts as an upright phone."""

SHEET = 0.46
"""Share of a phone's screen that controls cover."""


class Worker:
    """A worker thread of a page. Of waiting jobs of one kind, only the last one runs."""

    def __init__(self, fail: Callable[[str], None]):
        """
        Args:
            fail: called with a message when a job fails.
        """
        self._fail = fail
        self._waiting: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self.closed = False
        """Whether the worker is closed; long jobs poll this."""
        self._thread = threading.Thread(target=self._run, name="fungrasp page", daemon=True)
        self._thread.start()

    def ask(self, kind: str, job: Callable[[], None]) -> None:
        """Queue a job. It replaces a waiting job of the same kind."""
        with self._changed:
            self._waiting[kind] = job
            self._changed.notify()

    def waits(self, kind: str) -> bool:
        """Return whether a job of a kind is waiting."""
        return kind in self._waiting

    @property
    def busy(self) -> bool:
        """Whether a job is waiting; long jobs may then stop."""
        return bool(self._waiting)

    def close(self) -> None:
        """Accept no more jobs."""
        with self._changed:
            self.closed = True
            self._waiting.clear()
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self.closed or self._waiting)
                if self.closed:
                    return
                job = self._waiting.pop(next(iter(self._waiting)))
            try:
                job()
            except FungraspError as error:
                self._fail(str(error))
            except Exception as error:
                # The browser may have disconnected during the job.
                if not self.closed:
                    _log.exception("a job of a page failed")
                    self._fail(f"internal error: {type(error).__name__}: {error}")


class BrowserPage:
    """Base class of pages: the browser's handle, a worker and notifications."""

    def __init__(self, client: ClientHandle):
        self.client = client
        self.worker = Worker(self.fail)

    def fail(self, words: str) -> None:
        """Show an error message."""
        if not self.worker.closed:
            self.client.add_notification(
                "Not possible", " ".join(words.split()), color="red", auto_close_seconds=12.0
            )

    def note(self, words: str) -> None:
        """Show a short notification."""
        if not self.worker.closed:
            self.client.add_notification("fungrasp", words, auto_close_seconds=5.0)

    def close(self) -> None:
        """Release all resources after the browser disconnected."""
        self.worker.close()


def look_at(
    client: ClientHandle, target: tuple[float, float, float], distance: float, aside: np.ndarray | None = None
) -> None:
    """Place a page's camera in front of a point, slightly above it.

    Args:
        target: point in the middle of the view [m].
        distance: distance of the camera from the target [m].
        aside: horizontal unit vector that points right in the view, shape [3]; x if None.
    """
    # An upright phone has a narrow horizontal view.
    distance /= float(np.clip(client.camera.aspect / WIDE, 0.35, 1.0))
    right = np.array([1.0, 0.0, 0.0]) if aside is None else aside
    back = np.array([right[1], -right[0], 0.0])
    away = 0.92 * back + np.array([0.0, 0.0, 0.38])
    middle = np.array(target, dtype=float)
    if client.camera.aspect < UPRIGHT:
        # Controls cover the lower part of the screen, so the target is moved above them.
        up = np.array([0.0, 0.0, 1.0]) - 0.38 * away
        middle -= SHEET * np.tan(FIELD_OF_VIEW / 2) * distance * up / np.linalg.norm(up)
    client.camera.up_direction = (0.0, 0.0, 1.0)
    client.camera.position = middle + distance * away
    client.camera.look_at = middle
    client.camera.near = 0.005
    client.camera.fov = FIELD_OF_VIEW


def add_table(client: ClientHandle, size: float = 1.6) -> None:
    """Add the table top, the plane z = 0, with squares of 5 cm."""
    client.scene.add_grid(
        "/table",
        width=size,
        height=size,
        cell_size=0.05,
        section_size=0.25,
        cell_color=(205, 210, 215),
        section_color=(180, 186, 194),
        plane="xy",
        position=(0.0, 0.0, -0.0005),
    )


def values_table(rows: Sequence[tuple[str, ...]], heads: tuple[str, ...] = ("", "")) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


class JointSliders:
    """A slider for each joint, within its limits; coupled joints follow."""

    def __init__(self, gui: GuiApi, folder: Any, hand: Hand, moved: Callable[[], None]):
        """
        Args:
            moved: called when a user has moved a slider.
        """
        self._hand, self._syncing, self._sliders = hand, False, []
        with folder:
            for name, (low, high) in zip(hand.joint_names, hand.joint_limits.tolist(), strict=True):
                low, high = max(low, -np.pi), min(high, np.pi)
                slider = gui.add_slider(name, low, high, 0.01, float(np.clip(0.0, low, high)))
                slider.on_update(lambda _: None if self._syncing else moved())
                self._sliders.append(slider)

    @property
    def joints(self) -> np.ndarray:
        """Positions of all joints [rad], shape [M]."""
        values = np.array([slider.value for slider in self._sliders])
        return self._hand.all_joints(self._hand.independent(values))

    def show(self, joints: np.ndarray) -> None:
        """Set the sliders without calling ``moved``. joints: [rad], shape [M]."""
        self._syncing = True
        for slider, value in zip(self._sliders, joints, strict=True):
            slider.value = float(np.clip(value, slider.min, slider.max))
        self._syncing = False

    def remove(self) -> None:
        """Remove the sliders."""
        for slider in self._sliders:
            slider.remove()
