"""A page for one browser, from its connection to its end."""

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
"""Of a page's camera, vertical [rad]."""

WIDE = 1.15
"""Width over height of a picture below which the camera steps back."""

UPRIGHT = 0.8
"""Width over height of a phone's picture."""

SHEET = 0.46
"""Share of a phone's screen that its controls cover."""


class Worker:
    """A worker thread of a page. Of waiting jobs of one kind, only the last one runs."""

    def __init__(self, fail: Callable[[str], None]):
        """
        Args:
            fail: called with a sentence when a job can't be done.
        """
        self._fail = fail
        self._waiting: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self.closed = False
        """Whether it takes no more jobs; a long one looks at it from time to time."""
        self._thread = threading.Thread(target=self._run, name="fungrasp page", daemon=True)
        self._thread.start()

    def ask(self, kind: str, job: Callable[[], None]) -> None:
        """Do something soon; it takes the place of a job of the same kind that has not begun."""
        with self._changed:
            self._waiting[kind] = job
            self._changed.notify()

    def waits(self, kind: str) -> bool:
        """Whether a job of a kind has not begun."""
        return kind in self._waiting

    @property
    def busy(self) -> bool:
        """Whether a job waits: one that takes its time may make room."""
        return bool(self._waiting)

    def close(self) -> None:
        """Take no more jobs."""
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
                # The browser may have gone in the middle of a job.
                if not self.closed:
                    _log.exception("a job of a page failed")
                    self._fail(f"internal error: {type(error).__name__}: {error}")


class BrowserPage:
    """What all pages have: the browser's handle, a worker, a line for what went wrong."""

    def __init__(self, client: ClientHandle):
        self.client = client
        self.worker = Worker(self.fail)

    def fail(self, words: str) -> None:
        """Say in the page what can't be done."""
        if not self.worker.closed:
            self.client.add_notification(
                "Not possible", " ".join(words.split()), color="red", auto_close_seconds=12.0
            )

    def note(self, words: str) -> None:
        """Say something in passing."""
        if not self.worker.closed:
            self.client.add_notification("fungrasp", words, auto_close_seconds=5.0)

    def close(self) -> None:
        """The browser is gone: let go of everything."""
        self.worker.close()


def look_at(
    client: ClientHandle, target: tuple[float, float, float], distance: float, aside: np.ndarray | None = None
) -> None:
    """Put a page's camera in front of something, slightly above it.

    Args:
        target: what is in the middle [m].
        distance: of the eye from it [m].
        aside: horizontal unit vector that is to point to the right, shape [3]; x if None.
    """
    # A phone held upright sees less to the sides.
    distance /= float(np.clip(client.camera.aspect / WIDE, 0.35, 1.0))
    right = np.array([1.0, 0.0, 0.0]) if aside is None else aside
    back = np.array([right[1], -right[0], 0.0])
    away = 0.92 * back + np.array([0.0, 0.0, 0.38])
    middle = np.array(target, dtype=float)
    if client.camera.aspect < UPRIGHT:
        # Its controls cover the lower part of the screen: what is looked at is above them.
        up = np.array([0.0, 0.0, 1.0]) - 0.38 * away
        middle -= SHEET * np.tan(FIELD_OF_VIEW / 2) * distance * up / np.linalg.norm(up)
    client.camera.up_direction = (0.0, 0.0, 1.0)
    client.camera.position = middle + distance * away
    client.camera.look_at = middle
    client.camera.near = 0.005
    client.camera.fov = FIELD_OF_VIEW


def add_table(client: ClientHandle, size: float = 1.6) -> None:
    """The table top, the plane z = 0, with squares of 5 cm."""
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
    """A table in Markdown."""
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


class JointSliders:
    """A slider for each joint, within its limits; coupled joints follow."""

    def __init__(self, gui: GuiApi, folder: Any, hand: Hand, moved: Callable[[], None]):
        """
        Args:
            moved: called when somebody has moved one.
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
        """Of all joints [rad], shape [M]."""
        values = np.array([slider.value for slider in self._sliders])
        return self._hand.all_joints(self._hand.independent(values))

    def show(self, joints: np.ndarray) -> None:
        """Put them where a hand is, without calling anybody. joints: [rad], shape [M]."""
        self._syncing = True
        for slider, value in zip(self._sliders, joints, strict=True):
            slider.value = float(np.clip(value, slider.min, slider.max))
        self._syncing = False

    def remove(self) -> None:
        """Take them out of the page."""
        for slider in self._sliders:
            slider.remove()
