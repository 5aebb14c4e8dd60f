"""Sliders for the joints of a hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.hands import Hand

if TYPE_CHECKING:
    from viser import GuiApi


class JointSliders:
    """A slider for each joint, within its limits; coupled joints follow."""

    def __init__(self, gui: GuiApi, folder: Any, hand: Hand, moved: Callable[[], None]):
        """
        Args:
            gui: of the page.
            folder: that holds the sliders.
            hand: any hand.
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
