"""Workshop tools: hammer, screwdriver, drill, clamp, flashlight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    along_x,
    along_y,
    box,
    ellipse,
    mirrored,
    moved,
    prism,
    sweep,
    turned,
)
from fungrasp.objects.builtin_objects import lathe


@dataclass(frozen=True)
class Hammer:
    """A claw hammer lying on its side; the head is at +x, its face points to -y and the claw to +y."""

    length: float = 0.32
    """Length of the hammer [m]."""
    grip: float = 0.14
    """Length of the rubber grip [m]."""
    face: float = 0.0145
    """Radius of the striking face [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "grip", "shaft" and "head"."""
        head = self.length - 0.014
        grip = [
            ellipse((x, 0, 0), (0, a, 0), (0, 0, b), squareness=2.4)
            for x, a, b in (
                (0, 0.014, 0.011),
                (0.006, 0.0185, 0.014),
                (0.03, 0.0175, 0.0135),
                (self.grip * 0.65, 0.0155, 0.0125),
                (self.grip, 0.0165, 0.0125),
            )
        ]
        shaft = [
            ellipse((self.grip - 0.002, 0, 0), (0, 0.0135, 0), (0, 0, 0.0095), squareness=2.2),
            ellipse((head, 0, 0), (0, 0.0105, 0), (0, 0, 0.0085), squareness=2.2),
        ]
        poll = [
            lathe([(0.0105, -0.03), (0.0105, -0.012)], segments=24),
            lathe(
                [(self.face - 0.001, -0.056), (self.face, -0.054), (self.face, -0.033), (0.0105, -0.028)],
                segments=32,
            ),
        ]
        return {
            "grip": sweep(grip),
            "shaft": sweep(shaft),
            "head": [
                box((0.027, 0.034, 0.025), (head, 0, 0), bevel=0.003),
                *(moved(along_y(solid), x=head) for solid in poll),
                *(moved(solid, x=head) for side in (-1, 1) for solid in self._claw(side)),
            ],
        }

    @staticmethod
    def _claw(side: int) -> list[Solid]:
        """One prong of the claw, bent towards the grip."""
        rows = [  # y, x, half-thickness along x, inner and outer edge along z
            (0.012, 0.0, 0.0105, 0.0, 0.0115),
            (0.034, -0.003, 0.0085, 0.0012, 0.0135),
            (0.052, -0.011, 0.005, 0.003, 0.0135),
            (0.068, -0.024, 0.0014, 0.0045, 0.0125),
        ]
        sections = [
            np.array(
                [
                    (x + s * t + s * t * 0.5 * (y > 0.04), y - s * t * 0.6 * (y > 0.04), side * z)
                    for s in (-1, 1)
                    for z in zs
                ]
            )
            for y, x, t, *zs in rows
        ]
        return sweep(sections)


@dataclass(frozen=True)
class Screwdriver:
    """A screwdriver lying on the table; the tip points to +x."""

    handle: float = 0.105
    """Length of the handle [m]."""
    shaft: float = 0.115
    """Length of the bare shaft [m]."""
    radius: float = 0.016
    """Radius of the six-sided handle [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "handle" and "shaft"."""
        r, n = self.radius, self.handle
        profile = [
            (0.55, 0),
            (0.86, 0.004),
            (1.0, 0.012),
            (1.0, 0.052),
            (0.68, 0.078),
            (0.68, 0.084),
            (0.86, 0.097),
            (0.6, n),
        ]
        sections = [self._flats(r * k, z) for k, z in profile]
        shaft = [lathe([(0.0032, n - 0.006), (0.0032, n + self.shaft - 0.012)], segments=16)]
        tip = np.concatenate(
            [
                ellipse((0, 0, n + self.shaft - 0.013), (0.0032, 0, 0), (0, 0.0032, 0), corners=16),
                ellipse((0, 0, n + self.shaft), (0.0005, 0, 0), (0, 0.0034, 0), corners=8, squareness=6),
            ]
        )
        grip = [np.concatenate(sections[:4]), *sweep(sections[3:])]
        return {"handle": [along_x(s) for s in grip], "shaft": [along_x(s) for s in (*shaft, tip)]}

    @staticmethod
    def _flats(radius: float, height: float) -> np.ndarray:
        """A hexagon with cut corners, one flat below."""
        angles = np.deg2rad([60 * k + d for k in range(6) for d in (-20, 20)])
        return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(12, height)])


@dataclass(frozen=True)
class Drill:
    """A cordless drill standing on its battery; the chuck points to +x."""

    height: float = 0.215
    """Height of the drill [m]."""
    barrel: float = 0.029
    """Radius of the motor housing [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "grip", "trigger", "body", "chuck" and "battery"."""
        axis = self.height - self.barrel
        r = self.barrel
        under = axis - r + 0.006
        grip = [
            ellipse((x, 0, z), (a, 0, 0), (0, b, 0), corners=20, squareness=2.5)
            for z, x, a, b in (
                (0.046, -0.012, 0.022, 0.017),
                (0.085, -0.018, 0.0195, 0.0155),
                (0.125, -0.016, 0.0185, 0.016),
                (under, -0.008, 0.026, 0.0175),
            )
        ]
        trigger = [
            ellipse((0.012, 0, under - 0.002), (0.010, 0, 0), (0, 0.009, 0), squareness=3),
            ellipse((0.009, 0, under - 0.014), (0.0085, 0, 0), (0, 0.009, 0), squareness=3),
            ellipse((0.005, 0, under - 0.03), (0.010, 0, 0), (0, 0.0085, 0), squareness=3),
        ]
        housing = [
            lathe(
                [(r - 0.01, -0.073), (r - 0.002, -0.066), (r, -0.055), (r, 0.03), (r - 0.005, 0.044)],
                segments=36,
            ),
            lathe([(r - 0.006, 0.042), (r - 0.007, 0.064)], segments=36),
        ]
        chuck = [
            lathe([(0.0195, 0.063), (0.0205, 0.066), (0.0205, 0.088), (0.0185, 0.092)], segments=28),
            lathe([(0.0185, 0.092), (0.0095, 0.108), (0.0085, 0.109)], segments=28),
        ]
        return {
            "grip": sweep(grip),
            "trigger": sweep(trigger),
            "body": [moved(along_x(s), z=axis) for s in housing],
            "chuck": [moved(along_x(s), z=axis) for s in chuck],
            "battery": [
                box((0.112, 0.070, 0.034), (0.0, 0, 0.017), bevel=0.004),
                box((0.098, 0.058, 0.018), (-0.001, 0, 0.041), bevel=0.004),
            ],
        }


@dataclass(frozen=True)
class Clamp:
    """A spring clamp lying flat and closed; the jaws point to +x."""

    handle: float = 0.095
    """Length of a handle [m]."""
    jaw: float = 0.07
    """Length of a jaw [m]."""
    spread: float = 0.30
    """Angle between a handle and the middle line [rad]."""
    thickness: float = 0.026
    """Along z [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "jaws", "handles" and "pivot"."""
        t = self.thickness / 2
        side = {"jaws": self._jaw(t), "handles": self._handle(t)}
        both = {name: [*solids, *(mirrored(s) for s in solids)] for name, solids in side.items()}
        return {**both, "pivot": [lathe([(0.0125, -t + 0.001), (0.0125, t - 0.001)], segments=28)]}

    def _jaw(self, t: float) -> list[Solid]:
        length = self.jaw
        arm = [
            prism(
                [(-0.004, 0.006), (-0.004, 0.017), (length * 0.55, 0.026), (length * 0.55, 0.014)],
                -t * 0.8,
                t * 0.8,
                0.0015,
            ),
            prism(
                [
                    (length * 0.55, 0.014),
                    (length * 0.55, 0.026),
                    (length * 0.8, 0.024),
                    (length, 0.012),
                    (length, 0.006),
                ],
                -t * 0.8,
                t * 0.8,
                0.0015,
            ),
        ]
        pad = prism(
            [
                (length - 0.022, 0.0002),
                (length + 0.002, 0.0002),
                (length + 0.002, 0.009),
                (length - 0.022, 0.0125),
            ],
            -t,
            t,
        )
        return [*arm, pad]

    def _handle(self, t: float) -> list[Solid]:
        sections = [
            ellipse((x, y, 0), (0, a, 0), (0, 0, b), squareness=3.5)
            for x, y, a, b in (
                (0.004, -0.009, 0.006, t * 0.8),
                (-self.handle * 0.35, -0.015, 0.0065, t * 0.85),
                (-self.handle * 0.93, -0.0155, 0.0075, t),
                (-self.handle, -0.0155, 0.005, t * 0.7),
            )
        ]
        return [turned(solid, self.spread) for solid in sweep(sections)]


@dataclass(frozen=True)
class Flashlight:
    """A torch lying on the table; the light points to +x."""

    radius: float = 0.0145
    """Radius of the body [m]."""
    length: float = 0.15
    """Length of the flashlight [m]."""

    def parts(self) -> PartSolids:
        """Convex solids of the parts "body", "head" and "switch"."""
        r, n = self.radius, self.length
        body = [
            lathe([(r - 0.002, 0), (r, 0.002), (r, 0.016)], segments=32),
            lathe([(r - 0.001, 0.016), (r - 0.001, 0.1)], segments=32),
        ]
        head = [
            lathe(
                [(r - 0.001, 0.098), (r + 0.006, 0.122), (r + 0.006, n - 0.002), (r + 0.005, n)], segments=36
            ),
        ]
        return {
            "body": [along_x(s) for s in body],
            "head": [along_x(s) for s in head],
            "switch": [box((0.014, 0.009, 0.006), (0.075, 0, r - 0.001), bevel=0.001)],
        }
