"""Mug, can, carton."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.objects.builtin.assembly import Parts
from fungrasp.objects.builtin.shapes import box, lathe, ring, sweep


@dataclass(frozen=True)
class Mug:
    """A straight mug with a D-shaped handle towards +x."""

    radius: float = 0.041
    """Of the outside [m]."""
    height: float = 0.095
    """[m]."""
    wall: float = 0.0045
    """[m]."""

    def parts(self) -> Parts:
        r, h, w = self.radius, self.height, self.wall
        inside = r - w
        angles = np.linspace(-np.pi / 2, np.pi / 2, 5)
        sections = []
        for a in np.concatenate([angles]):
            c = np.array([r - 0.003 + 0.034 * np.cos(a), 0, h / 2 + 0.032 * np.sin(a)])
            n = np.array([np.cos(a), 0, np.sin(a)])
            t = np.linspace(0, 2 * np.pi, 12, endpoint=False)
            sections.append(c + 0.004 * np.cos(t)[:, None] * n + 0.0065 * np.sin(t)[:, None] * [0, 1, 0])
        body = [lathe([(r - 0.002, 0), (r, 0.002), (r, 0.006)])]
        body += ring([(r, 0.006), (r, h - 0.012)], [(inside, 0.006), (inside, h - 0.012)])
        rim = ring([(r, h - 0.012), (r, h)], [(inside, h - 0.012), (inside, h)])
        return {"body": body, "rim": rim, "handle": sweep(sections)}


@dataclass(frozen=True)
class Can:
    """A drink can."""

    radius: float = 0.033
    """[m]."""
    height: float = 0.115
    """[m]."""

    def parts(self) -> Parts:
        r, h = self.radius, self.height
        return {"body": [lathe([(r - 0.006, 0), (r, 0.008), (r, h - 0.012), (r - 0.006, h)])]}


@dataclass(frozen=True)
class Carton:
    """A closed carton."""

    size: tuple[float, float, float] = (0.06, 0.11, 0.17)
    """[m]."""

    def parts(self) -> Parts:
        return {"body": [box(self.size)]}
