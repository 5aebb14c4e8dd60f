"""Closed containers: can, box, bottle, spray bottle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import box, ellipse, sweep
from fungrasp.objects.builtin_objects import lathe


@dataclass(frozen=True)
class Can:
    """A drink can."""

    radius: float = 0.033
    """Radius of the can [m]."""
    height: float = 0.115
    """Height of the can [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body" and "rim"."""
        r, h = self.radius, self.height
        return {
            "body": [lathe([(r - 0.008, 0), (r, 0.01), (r, h - 0.014), (r - 0.006, h - 0.003)], segments=48)],
            "rim": [lathe([(r - 0.0058, h - 0.0032), (r - 0.0055, h - 0.001), (r - 0.0062, h)], segments=48)],
        }


@dataclass(frozen=True)
class Carton:
    """A closed cardboard box, standing."""

    size: tuple[float, float, float] = (0.06, 0.11, 0.17)
    """Extents of the carton along x, y and z [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the part "body"."""
        return {"body": [box(self.size, bevel=0.001)]}


@dataclass(frozen=True)
class Bottle:
    """A drink bottle with a waist and a screw cap."""

    radius: float = 0.0325
    """Radius of the bottle [m]."""
    height: float = 0.205
    """With the cap [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "neck" and "cap"."""
        r, h = self.radius, self.height
        waist = r - 0.0035
        return {
            "body": [
                lathe([(r - 0.005, 0), (r, 0.006), (r, 0.06), (waist, 0.072)], segments=48),
                lathe([(waist, 0.072), (waist, 0.098)], segments=48),
                lathe(
                    [(waist, 0.098), (r, 0.110), (r, 0.138), (r - 0.006, 0.156), (0.0135, h - 0.026)],
                    segments=48,
                ),
            ],
            "neck": [
                lathe([(0.0125, h - 0.028), (0.0125, h - 0.013)], segments=32),
                lathe([(0.016, h - 0.022), (0.016, h - 0.019)], segments=32),
            ],
            "cap": [
                lathe([(0.0145, h - 0.016), (0.015, h - 0.015), (0.015, h - 0.001), (0.014, h)], segments=32)
            ],
        }


@dataclass(frozen=True)
class SprayBottle:
    """A trigger sprayer; the nozzle and the trigger point to +x."""

    width: float = 0.062
    """Width of the body, along y [m]."""
    length: float = 0.09
    """Length of the body, along x [m]."""
    body: float = 0.165
    """Height of the shoulder [m]."""
    height: float = 0.255
    """Height of the spray bottle [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "neck", "head" and "trigger"."""
        a, b, s, h = self.length / 2, self.width / 2, self.body, self.height
        levels = [(0, 0.94), (0.005, 1.0), (s * 0.55, 1.0), (s * 0.8, 0.8), (s, 0.36)]
        sections = [
            ellipse(
                (0, 0, z),
                (a * k, 0, 0),
                (0, b * (k if k > 0.9 else (k + 0.25) / 1.12), 0),
                corners=32,
                squareness=2.8,
            )
            for z, k in levels
        ]
        lower, upper = np.concatenate(sections[:4]), np.concatenate(sections[3:])
        top = h - 0.036
        nozzle = 0.062
        head = [
            ellipse((-0.034, 0, h - 0.012), (0, 0.009, 0), (0, 0, 0.008), squareness=4),
            ellipse((-0.016, 0, h - 0.016), (0, 0.0145, 0), (0, 0, 0.015), squareness=4),
            ellipse((0.02, 0, h - 0.016), (0, 0.0145, 0), (0, 0, 0.015), squareness=4),
            ellipse((nozzle - 0.012, 0, h - 0.013), (0, 0.0085, 0), (0, 0, 0.0085), squareness=3),
        ]
        tip = [
            ellipse((nozzle - 0.012, 0, h - 0.013), (0, 0.0105, 0), (0, 0, 0.0105), squareness=2.5),
            ellipse((nozzle, 0, h - 0.013), (0, 0.0095, 0), (0, 0, 0.0095), squareness=2.5),
        ]
        trigger = [
            ellipse((0.030, 0, h - 0.022), (0.006, 0, 0), (0, 0.0085, 0), squareness=3),
            ellipse((0.034, 0, h - 0.045), (0.0045, 0, 0.001), (0, 0.0085, 0), squareness=3),
            ellipse((0.0385, 0, h - 0.064), (0.004, 0, 0.002), (0, 0.008, 0), squareness=3),
            ellipse((0.046, 0, h - 0.080), (0.003, 0, 0.003), (0, 0.0075, 0), squareness=3),
        ]
        return {
            "body": [lower, upper],
            "neck": [
                lathe([(0.0135, s - 0.002), (0.0135, top + 0.008)], segments=28),
                lathe([(0.0185, s + 0.008), (0.0185, s + 0.026), (0.0165, s + 0.029)], segments=28),
            ],
            "head": [*sweep(head), *sweep(tip)],
            "trigger": sweep(trigger),
        }
