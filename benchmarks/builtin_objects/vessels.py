"""Vessels: mug, wine glass, pitcher, teapot; can, box, bottle, spray bottle."""

from __future__ import annotations

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    bow,
    box,
    ellipse,
    ring,
    sweep,
)
from fungrasp.objects.builtin_objects import lathe


def mug(
    radius: float = 0.041,  # Radius of the outside [m]
    height: float = 0.095,  # Height of the mug [m]
    wall: float = 0.0045,  # Thickness of wall and floor [m]
    rim: float = 0.012,  # Height of the part called rim [m]
    reach: float = 0.031,  # From the wall to the middle line of the handle [m]
) -> PartSolids:
    """A straight mug; the handle points to +x."""
    r, h, inside = radius, height, radius - wall
    floor, lip = 0.006, h - rim
    return {
        "body": [
            lathe([(r - 0.002, 0), (r, 0.002), (r, floor)], segments=48),
            *ring([(r, floor), (r, lip)], [(inside, floor), (inside, lip)]),
        ],
        "rim": ring([(r, lip), (r, h - 0.001), (r - 0.001, h)], [(inside, lip), (inside, h)]),
        "handle": bow(
            (r - 0.002, 0.017), (r - 0.002, h - 0.017), reach, half_width=0.0065, half_depth=0.0042
        ),
    }


def wine_glass(
    radius: float = 0.038,  # Radius of the bowl where it is widest [m]
    height: float = 0.19,  # Height of the wine glass [m]
    stem: float = 0.085,  # Height of the underside of the bowl [m]
) -> PartSolids:
    """A stemmed glass."""
    r, s, h = radius, stem, height
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


def pitcher(
    bottom: float = 0.056,  # Radius of the foot [m]
    top: float = 0.066,  # Radius of the mouth [m]
    height: float = 0.22,  # Height of the pitcher [m]
    wall: float = 0.004,  # Thickness of the wall of the pitcher [m]
) -> PartSolids:
    """A jug; the handle points to +x and the spout to -x."""
    b, t, h, w = bottom, top, height, wall
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
        "spout": [_pitcher_cheek(top, height, wall, side, neck) for side in (-1, 1)],
        "handle": bow((b, 0.035), (t - 0.002, h - 0.022), reach=0.045, half_width=0.011, half_depth=0.006),
    }


def _pitcher_cheek(top: float, height: float, wall: float, side: int, neck: float) -> Solid:
    """Half of the spout: a plate from the edge of the mouth's gap to the beak and down to the neck."""
    t, h = top - wall / 2, height
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
    normal *= wall / 2 / np.linalg.norm(normal)
    return np.concatenate([corners + normal, corners - normal])


def teapot(
    radius: float = 0.07,  # Radius of the belly [m]
    height: float = 0.115,  # Up to the lid [m]
) -> PartSolids:
    """A round teapot with its lid on; the handle points to +x and the spout to -x."""
    r, h = radius, height
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


def can(
    radius: float = 0.033,  # Radius of the can [m]
    height: float = 0.115,  # Height of the can [m]
) -> PartSolids:
    """A drink can."""
    r, h = radius, height
    return {
        "body": [lathe([(r - 0.008, 0), (r, 0.01), (r, h - 0.014), (r - 0.006, h - 0.003)], segments=48)],
        "rim": [lathe([(r - 0.0058, h - 0.0032), (r - 0.0055, h - 0.001), (r - 0.0062, h)], segments=48)],
    }


def carton(
    size: tuple[float, float, float] = (0.06, 0.11, 0.17),  # Extents of the carton along x, y and z [m]
) -> PartSolids:
    """A closed cardboard box, standing."""
    return {"body": [box(size, bevel=0.001)]}


def bottle(
    radius: float = 0.0325,  # Radius of the bottle [m]
    height: float = 0.205,  # With the cap [m]
) -> PartSolids:
    """A drink bottle with a waist and a screw cap."""
    r, h = radius, height
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


def spray_bottle(
    width: float = 0.062,  # Width of the body, along y [m]
    length: float = 0.09,  # Length of the body, along x [m]
    body: float = 0.165,  # Height of the shoulder [m]
    height: float = 0.255,  # Height of the spray bottle [m]
) -> PartSolids:
    """A trigger sprayer; the nozzle and the trigger point to +x."""
    a, b, s, h = length / 2, width / 2, body, height
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
