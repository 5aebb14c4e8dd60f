"""Objects to drink and pour from: mug, wine glass, pitcher, teapot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    bow,
    ellipse,
    ring,
    sweep,
)
from fungrasp.objects.builtin_objects import lathe


@dataclass(frozen=True)
class Mug:
    """A straight mug; the handle points to +x."""

    radius: float = 0.041
    """Radius of the outside [m]."""
    height: float = 0.095
    """Height of the mug [m]."""
    wall: float = 0.0045
    """Thickness of wall and floor [m]."""
    rim: float = 0.012
    """Height of the part called rim [m]."""
    reach: float = 0.031
    """From the wall to the middle line of the handle [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "rim" and "handle"."""
        r, h, inside = self.radius, self.height, self.radius - self.wall
        floor, lip = 0.006, h - self.rim
        return {
            "body": [
                lathe([(r - 0.002, 0), (r, 0.002), (r, floor)], segments=48),
                *ring([(r, floor), (r, lip)], [(inside, floor), (inside, lip)]),
            ],
            "rim": ring([(r, lip), (r, h - 0.001), (r - 0.001, h)], [(inside, lip), (inside, h)]),
            "handle": bow(
                (r - 0.002, 0.017), (r - 0.002, h - 0.017), self.reach, half_width=0.0065, half_depth=0.0042
            ),
        }


@dataclass(frozen=True)
class WineGlass:
    """A stemmed glass."""

    radius: float = 0.038
    """Radius of the bowl where it is widest [m]."""
    height: float = 0.19
    """Height of the wine glass [m]."""
    stem: float = 0.085
    """Height of the underside of the bowl [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "base", "stem" and "bowl"."""
        r, s, h = self.radius, self.stem, self.height
        floor, widest = s + 0.012, s + 0.045
        return {
            "base": [lathe([(0.034, 0), (0.035, 0.0015), (0.033, 0.003), (0.006, 0.009)], segments=48)],
            "stem": sweep(
                [
                    ellipse((0, 0, z), (a, 0, 0), (0, a, 0))
                    for z, a in ((0.007, 0.005), (0.03, 0.0037), (s, 0.005))
                ]
            ),
            "bowl": [
                lathe([(0.005, s - 0.003), (0.017, s + 0.003), (0.027, floor)], segments=48),
                *ring(
                    [(0.027, floor), (0.0335, s + 0.024), (r, widest)],
                    [(0.0225, floor), (r - 0.0035, widest)],
                ),
                *ring(
                    [(r, widest), (r - 0.0005, s + 0.06), (r - 0.006, h)],
                    [(r - 0.0035, widest), (r - 0.0085, h)],
                ),
            ],
        }


@dataclass(frozen=True)
class Pitcher:
    """A jug; the handle points to +x and the spout to -x."""

    bottom: float = 0.056
    """Radius of the foot [m]."""
    top: float = 0.066
    """Radius of the mouth [m]."""
    height: float = 0.22
    """Height of the pitcher [m]."""
    wall: float = 0.004
    """Thickness of the wall of the pitcher [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "spout" and "handle"."""
        b, t, h, w = self.bottom, self.top, self.height, self.wall
        floor, neck = 0.006, h - 0.05
        inside = b + (t - b) * (neck - floor) / (h - floor) - w
        gap = 5
        mouth = ring([(t, neck), (t, h)], [(inside, neck), (t - w, h)])
        return {
            "body": [
                lathe([(b - 0.002, 0), (b, 0.002), (b, floor)], segments=48),
                *ring([(b, floor), (t, neck)], [(b - w, floor), (inside, neck)]),
                *mouth[:gap],
                *mouth[gap + 2 :],
            ],
            "spout": [self._cheek(side, neck) for side in (-1, 1)],
            "handle": bow(
                (b, 0.035), (t - 0.002, h - 0.022), reach=0.045, half_width=0.011, half_depth=0.006
            ),
        }

    def _cheek(self, side: int, neck: float) -> Solid:
        """Half of the spout: a plate from the edge of the mouth's gap to the beak and down to the neck."""
        t, h = self.top - self.wall / 2, self.height
        edge = np.deg2rad(150)
        corners = np.array(
            [
                (t * np.cos(edge), side * t * np.sin(edge), h),
                (t * np.cos(edge), side * t * np.sin(edge), neck),
                (-t, 0, neck),
                (-t - 0.024, 0, h + 0.006),
            ]
        )
        normal = np.cross(corners[3] - corners[0], corners[2] - corners[0])
        normal *= self.wall / 2 / np.linalg.norm(normal)
        return np.concatenate([corners + normal, corners - normal])


@dataclass(frozen=True)
class Teapot:
    """A round teapot with its lid on; the handle points to +x and the spout to -x."""

    radius: float = 0.07
    """Radius of the belly [m]."""
    height: float = 0.115
    """Up to the lid [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "lid", "spout" and "handle"."""
        r, h = self.radius, self.height
        angles = np.linspace(-0.95, 1.05, 8)
        belly = [(r * np.cos(a), h * 0.46 + r * 0.68 * np.sin(a)) for a in angles]
        top = belly[-1][1]
        spout = [
            ellipse((-r * 0.80, 0, h * 0.34), (0.004, 0, -0.017), (0, 0.015, 0)),
            ellipse((-r * 1.22, 0, h * 0.52), (0.007, 0, -0.010), (0, 0.010, 0)),
            ellipse((-r * 1.52, 0, h * 0.86), (0.0085, 0, -0.0045), (0, 0.0075, 0)),
            ellipse((-r * 1.72, 0, h * 0.95), (0.004, 0, -0.0075), (0, 0.007, 0)),
        ]
        return {
            "body": [lathe([(0.042, belly[0][1] - 0.005), *belly], segments=40)],
            "lid": [
                lathe(
                    [
                        (belly[-1][0] - 0.001, top - 0.001),
                        (belly[-1][0] - 0.003, top + 0.003),
                        (0.012, top + 0.01),
                    ]
                ),
                lathe([(0.006, top + 0.008), (0.006, top + 0.014)], segments=20),
                lathe(
                    [(0.006, top + 0.013), (0.011, top + 0.018), (0.011, top + 0.023), (0.006, top + 0.027)],
                    segments=24,
                ),
            ],
            "spout": sweep(spout),
            "handle": bow(
                (r * 0.74, h * 0.2), (r * 0.7, h * 0.76), reach=0.055, half_width=0.008, half_depth=0.0055
            ),
        }
