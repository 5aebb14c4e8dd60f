"""The Inspire RH56: a smooth silver hand of a person's shape, black pads, two phalanges to a finger."""

from __future__ import annotations

import numpy as np

from fungrasp.media.hand_shells.frames import Finish, HandFrames, Shell
from fungrasp.media.hand_shells.shapes import bar, bullet, disc, housing, plate

SILVER: Finish = ((0.72, 0.74, 0.77), 0.7, 0.45)
BLACK: Finish = ((0.11, 0.115, 0.125), 0.15, 0.2)
GRAY: Finish = ((0.40, 0.42, 0.45), 0.5, 0.4)
BLUE: Finish = ((0.10, 0.42, 0.75), 0.4, 0.4)

OUTLINE = np.array(
    [
        (0.042, 0.128),
        (0.036, 0.133),
        (-0.036, 0.133),
        (-0.042, 0.126),
        (-0.041, 0.060),
        (-0.027, 0.034),
        (-0.026, 0.002),
        (0.026, 0.002),
        (0.029, 0.034),
        (0.042, 0.062),
    ]
)
"""Of the palm: across to the index finger, to the fingers [m]."""


def inspire_shells(frames: HandFrames) -> list[Shell]:
    """All parts of the hand."""
    parts: list[Shell] = []
    for finger in ("index", "middle", "ring", "pinky"):
        parts += _proximal(frames, f"{finger}_proximal", 0.0078) + _tip(frames, f"{finger}_intermediate")
    parts += _yaw(frames, "thumb_proximal_base")
    parts += _proximal(frames, "thumb_proximal", 0.0092) + _proximal(frames, "thumb_intermediate", 0.0080)
    parts += _tip(frames, "thumb_distal")
    middle = np.array([0.0, 0.075])
    body = plate(OUTLINE, -0.0160, 0.0165, 0.012, 0.0085)
    back = plate(0.88 * (OUTLINE - middle) + middle, -0.0185, -0.0120, 0.012, 0.004)
    palm = plate(0.80 * (OUTLINE - middle - [0, 0.012]) + middle + [0, 0.012], 0.0140, 0.0188, 0.012, 0.003)
    band = plate(_band(0.0275, 0.010, 0.018), -0.0175, 0.0185, 0.002, 0.0012)
    parts += [
        frames.on_palm(body, SILVER),
        frames.on_palm(back, SILVER),
        frames.on_palm(palm, BLACK),
        frames.on_palm(band, BLACK),
        frames.on_palm(disc(0.006, 0.0016).shifted(0.0, 0.095, -0.0186), BLUE),
    ]
    flange = disc(0.024, 0.010, 0.0015).moved(_TO_FINGERS, [0.0, -0.004, 0.001])
    return [*parts, frames.on_palm(flange, GRAY)]


_TO_FINGERS = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
"""Turns z to the fingers, where across, to the fingers and out of the palm are x, y and z."""


def _band(width: float, low: float, high: float) -> np.ndarray:
    return np.array([(width, high), (-width, high), (-width, low), (width, low)])


def _proximal(frames: HandFrames, geom: str, radius: float) -> list[Shell]:
    f = frames.link(geom)
    back = bar(
        [
            (-0.006, 0.80 * radius, 0.70 * radius, 0.6 * radius),
            (-0.002, radius, 0.95 * radius, 0.75 * radius),
            (0.85 * f.length, 0.92 * radius, 0.88 * radius, 0.7 * radius),
            (f.length + 0.002, 0.70 * radius, 0.65 * radius, 0.5 * radius),
        ]
    ).shifted(y=-0.10 * radius)
    pad = bar(
        [
            (0.08 * f.length, 0.5 * radius, 0.2 * radius, 0.15 * radius),
            (0.22 * f.length, 0.80 * radius, 0.45 * radius, 0.4 * radius),
            (0.74 * f.length, 0.76 * radius, 0.45 * radius, 0.4 * radius),
            (0.90 * f.length, 0.5 * radius, 0.2 * radius, 0.15 * radius),
        ]
    ).shifted(y=0.62 * radius)
    hinge = disc(0.72 * radius, 1.95 * radius, 0.001).along_x()
    return [
        f.shell(back, SILVER),
        f.shell(pad, BLACK),
        f.shell(hinge, GRAY),
        f.shell(hinge.shifted(z=f.length), GRAY),
    ]


def _tip(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    r = f.radius
    back = bullet(f.length + r, 1.02 * r, 0.98 * r, 0.75 * r)
    pad = bullet(0.92 * f.length + 0.9 * r, 0.86 * r, 0.55 * r, 0.5 * r).shifted(
        y=0.55 * r, z=0.08 * f.length
    )
    return [f.shell(back, SILVER), f.shell(pad, BLACK)]


def _yaw(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    block = housing(f.length + 0.014, 0.0085, 0.0085, 0.005, 0.003).shifted(z=-0.007)
    return [f.shell(block, GRAY)]
