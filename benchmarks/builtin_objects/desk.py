"""Objects of desk and living room: scissors, marker, book, tennis ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    along_x,
    box,
    eye,
    mirrored,
    prism,
    turned,
)
from fungrasp.objects.builtin_objects import lathe


@dataclass(frozen=True)
class Scissors:
    """Scissors lying flat, a little open; the blades point to +x, drawn around the screw."""

    blade: float = 0.095
    """From the screw to the tip [m]."""
    opening: float = 0.12
    """Half the angle between the blades [rad]."""
    thickness: float = 0.003
    """Thickness of one blade [m]."""
    bar: float = 0.005
    """Half the thickness of the loops [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "loops" and "blades"."""
        blade, loop = self._half()
        return {
            "loops": [*loop, *(mirrored(s) for s in loop)],
            "blades": [*blade, *(mirrored(s) for s in blade)],
        }

    def _half(self) -> tuple[list[Solid], list[Solid]]:
        """The upper blade, on the +y side, and its loop on the -y side."""
        t = self.thickness
        tip = [
            (-0.012, -0.007),
            (-0.012, 0.006),
            (0.01, 0.0095),
            (self.blade * 0.6, 0.0085),
            (self.blade, 0.0012),
            (self.blade, -0.0005),
        ]
        shank = [(-0.012, 0.006), (-0.012, -0.007), (-0.045, -0.0115), (-0.045, -0.0015)]
        blade = [prism([*tip, (0.0, -0.007)], 0.0, t), prism(shank, -self.bar * 0.6, self.bar * 0.9, 0.001)]
        loop = eye((-0.079, -0.0125, 0), (0.0355, 0.0195), (0.0048, self.bar))
        return [turned(s, self.opening) for s in blade], [turned(s, self.opening) for s in loop]


@dataclass(frozen=True)
class Marker:
    """A felt pen with its cap on, lying; the cap points to +x."""

    radius: float = 0.0085
    """Radius of the barrel [m]."""
    length: float = 0.125
    """Length of the marker [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "barrel" and "cap"."""
        r, n = self.radius, self.length
        joint = n * 0.62
        barrel = [lathe([(r - 0.003, 0), (r - 0.0005, 0.006), (r, 0.02), (r, joint)], segments=28)]
        cap = [
            lathe(
                [(r + 0.0005, joint), (r + 0.0008, joint + 0.001), (r - 0.0005, n - 0.006), (r - 0.003, n)],
                segments=28,
            ),
        ]
        return {"barrel": [along_x(s) for s in barrel], "cap": [along_x(s) for s in cap]}


@dataclass(frozen=True)
class Book:
    """A hardcover book lying on its back; the spine is at -x."""

    size: tuple[float, float, float] = (0.13, 0.2, 0.028)
    """Width, height of the page, thickness [m]."""
    board: float = 0.0025
    """Thickness of the cover [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "cover" and "pages"."""
        w, h, t = self.size
        b = self.board
        return {
            "cover": [
                box((w, h, b), (0, 0, b / 2)),
                box((w, h, b), (0, 0, t - b / 2)),
                box((b, h, t), (-w / 2 + b / 2, 0, t / 2)),
            ],
            "pages": [box((w - 0.006, h - 0.006, t - 2 * b + 0.0002), (-0.002, 0, t / 2))],
        }


@dataclass(frozen=True)
class Ball:
    """A ball."""

    radius: float = 0.0335
    """Radius of the ball [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the part "ball"."""
        angles = np.linspace(-np.pi / 2, np.pi / 2, 15)[1:-1]
        poles = np.array([(0, 0, self.radius), (0, 0, -self.radius)])
        rounds = lathe([(self.radius * np.cos(a), self.radius * np.sin(a)) for a in angles], segments=28)
        return {"ball": [np.concatenate([rounds, poles])]}
