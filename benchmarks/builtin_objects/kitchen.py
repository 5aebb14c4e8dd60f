"""Kitchen tools: pan, knife, bowl, spatula, dish brush."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import ellipse, ring, sweep
from fungrasp.objects.builtin_objects import lathe


@dataclass(frozen=True)
class Pan:
    """A frying pan; the handle points to +x."""

    bottom: float = 0.09
    """Radius of the floor [m]."""
    top: float = 0.12
    """Radius of the rim [m]."""
    depth: float = 0.045
    """Depth of the pan [m]."""
    handle: float = 0.18
    """Length of the handle [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body" and "handle"."""
        b, t, d = self.bottom, self.top, self.depth
        floor = 0.004
        start, end = t - 0.006, t + self.handle
        bar = [
            ellipse((start, 0, d - 0.013), (0, 0.013, 0), (0, 0, 0.0045), squareness=3),
            ellipse((start + 0.05, 0, d), (0, 0.0095, 0), (0, 0, 0.0065), squareness=2.5),
            ellipse((end - 0.06, 0, d + 0.012), (0, 0.0125, 0), (0, 0, 0.0085), squareness=2.5),
            ellipse((end - 0.008, 0, d + 0.013), (0, 0.012, 0), (0, 0, 0.008), squareness=2.5),
            ellipse((end, 0, d + 0.013), (0, 0.008, 0), (0, 0, 0.005), squareness=2.5),
        ]
        return {
            "body": [
                lathe([(b - 0.002, 0), (b, 0.001), (b + 0.003, floor)], segments=56),
                *ring(
                    [(b + 0.003, floor), (b + 0.014, d * 0.4), (t, d)],
                    [(b - 0.001, floor), (t - 0.004, d)],
                    pieces=14,
                ),
            ],
            "handle": sweep(bar),
        }


@dataclass(frozen=True)
class Knife:
    """A chef's knife lying on its side; the blade points to +x, its edge to -y."""

    blade: float = 0.19
    """Length of the blade [m]."""
    handle: float = 0.12
    """Length of the handle [m]."""
    width: float = 0.042
    """Width of the blade at the heel [m]."""
    spine: float = 0.0024
    """Thickness of the blade at its back [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "handle" and "blade"."""
        length, w, thick = self.blade, self.width, self.spine
        back = 0.012
        spine = [(0.0, back), (length * 0.6, back - 0.001), (length, back - 0.018)]
        edge = [
            (0.012, back - w),
            (length * 0.45, back - w + 0.002),
            (length * 0.8, back - w + 0.012),
            (length, back - 0.019),
        ]
        points = [(x, y, s * thick / 2) for x, y in spine for s in (-1, 1)]
        points += [(x, y, s * 0.0002) for x, y in edge for s in (-1, 1)]
        points += [(0.0, back - w + 0.006, s * thick / 2 * 0.6) for s in (-1, 1)]
        grip = [
            ellipse((-self.handle, -0.004, 0), (0, 0.011, 0), (0, 0, 0.0075), squareness=2.6),
            ellipse((-self.handle + 0.008, -0.003, 0), (0, 0.0155, 0), (0, 0, 0.0095), squareness=2.6),
            ellipse((-self.handle * 0.55, 0.0, 0), (0, 0.0125, 0), (0, 0, 0.0095), squareness=2.6),
            ellipse((-0.022, 0.0005, 0), (0, 0.0115, 0), (0, 0, 0.0085), squareness=2.6),
            ellipse((0.006, -0.002, 0), (0, 0.014, 0), (0, 0, 0.0075), squareness=2.6),
        ]
        return {"handle": sweep(grip), "blade": [np.array(points)]}


@dataclass(frozen=True)
class Bowl:
    """A soup bowl."""

    radius: float = 0.075
    """Radius of the rim [m]."""
    height: float = 0.06
    """Height of the bowl [m]."""
    wall: float = 0.0045
    """Thickness at the rim [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body" and "rim"."""
        r, h, w = self.radius, self.height, self.wall
        foot, floor, middle, lip = 0.036, 0.008, 0.028, h - 0.01
        outer_middle, outer_lip = r * 0.87, r * 0.985
        inner_middle = outer_middle - w - 0.002
        inner_lip = inner_middle + (r - w - inner_middle) * (lip - middle) / (h - middle)
        return {
            "body": [
                lathe([(foot - 0.002, 0), (foot, 0.001), (foot + 0.012, floor)], segments=48),
                *ring(
                    [(foot + 0.012, floor), (outer_middle - 0.004, 0.0225), (outer_middle, middle)],
                    [(foot + 0.002, floor), (inner_middle, middle)],
                ),
                *ring([(outer_middle, middle), (outer_lip, lip)], [(inner_middle, middle), (inner_lip, lip)]),
            ],
            "rim": ring([(outer_lip, lip), (r, h - 0.001), (r - 0.001, h)], [(inner_lip, lip), (r - w, h)]),
        }


@dataclass(frozen=True)
class Spatula:
    """A turner lying on the table; the blade points to +x."""

    handle: float = 0.13
    """Length of the grip [m]."""
    shaft: float = 0.11
    """Length of the bar between grip and blade [m]."""
    blade: float = 0.09
    """Length of the blade [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "handle", "shaft" and "blade"."""
        bend = self.shaft + 0.01
        plate = [
            (bend, -0.02), (bend, 0.02), (bend + self.blade, -0.041), (bend + self.blade, 0.041),
            (bend + 0.02, -0.037), (bend + 0.02, 0.037),
        ]  # fmt: skip
        blade = np.array([(x, y, z) for x, y in plate for z in (0.0, 0.0018)])
        grip = [
            ellipse((x, 0, z), (0, a, 0), (0, 0, b), squareness=3)
            for x, z, a, b in (
                (-self.handle, 0.022, 0.010, 0.005),
                (-self.handle + 0.008, 0.022, 0.0145, 0.0085),
                (-0.05, 0.022, 0.0105, 0.0085),
                (0.0, 0.022, 0.0125, 0.008),
            )
        ]
        shaft = [
            ellipse((-0.004, 0, 0.022), (0, 0.005, 0), (0, 0, 0.0025), corners=12, squareness=3),
            ellipse((self.shaft * 0.8, 0, 0.014), (0, 0.005, 0), (0, 0, 0.0025), corners=12, squareness=3),
            ellipse((bend + 0.012, 0, 0.0022), (0, 0.007, 0), (0, 0, 0.0016), corners=12, squareness=3),
        ]
        return {"handle": sweep(grip), "shaft": sweep(shaft), "blade": [blade]}


@dataclass(frozen=True)
class Brush:
    """A dish brush lying on its bristles; the head points to +x."""

    handle: float = 0.18
    """Length of the handle [m]."""
    head: float = 0.075
    """Length of the head [m]."""
    bristles: float = 0.026
    """Length of the bristles [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "handle", "head" and "bristles"."""
        back, length = self.bristles, self.head
        bar = [
            ellipse((x, 0, z), (0, a, 0), (0, 0, b), squareness=3)
            for x, z, a, b in (
                (-self.handle, 0.030, 0.008, 0.005),
                (-self.handle + 0.01, 0.031, 0.0125, 0.0085),
                (-self.handle * 0.55, 0.036, 0.0115, 0.0085),
                (-0.045, 0.037, 0.0085, 0.007),
                (0.012, back + 0.006, 0.014, 0.0055),
            )
        ]
        middle = length / 2
        plate = np.concatenate(
            [
                ellipse((middle, 0, z), (middle - cut, 0, 0), (0, 0.026 - cut, 0), corners=28, squareness=3.5)
                for z, cut in ((back, 0.001), (back + 0.003, 0), (back + 0.008, 0), (back + 0.011, 0.004))
            ]
        )
        tuft = np.concatenate(
            [
                ellipse((middle, 0, 0), (middle - 0.002, 0, 0), (0, 0.025, 0), corners=28, squareness=3.5),
                ellipse(
                    (middle, 0, back + 0.001),
                    (middle - 0.006, 0, 0),
                    (0, 0.021, 0),
                    corners=28,
                    squareness=3.5,
                ),
            ]
        )
        return {"handle": sweep(bar), "head": [plate], "bristles": [tuft]}
