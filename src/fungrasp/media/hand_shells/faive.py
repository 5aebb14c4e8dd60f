"""The Faive Hand P0: printed white bones with waists, dark rolling joints with crossing ligaments, dark
rubber fingertips, a white palm with ribs."""

from __future__ import annotations

import numpy as np

from fungrasp.media.hand_shells.frames import Finish, HandFrames, LinkFrame, Shell
from fungrasp.media.hand_shells.shapes import bar, bullet, disc, housing, plate

BONE: Finish = ((0.92, 0.92, 0.89), 0.2, 0.2)
ROLLER: Finish = ((0.20, 0.21, 0.23), 0.3, 0.3)
RUBBER: Finish = ((0.16, 0.17, 0.19), 0.05, 0.05)
STRING: Finish = ((0.20, 0.62, 0.75), 0.2, 0.3)
SKIN: Finish = ((0.30, 0.31, 0.34), 0.05, 0.05)

OUTLINE = np.array(
    [
        (0.034, 0.099),
        (0.012, 0.102),
        (-0.016, 0.101),
        (-0.040, 0.090),
        (-0.041, 0.070),
        (-0.026, 0.020),
        (-0.018, 0.012),
        (0.020, 0.012),
        (0.026, 0.030),
        (0.037, 0.062),
    ]
)
"""Of the palm: across to the index finger, to the fingers [m]."""


def faive_shells(frames: HandFrames) -> list[Shell]:
    """All parts of the hand."""
    parts: list[Shell] = []
    for finger in ("index", "middle", "ring", "pinky"):
        parts += _metacarpal(frames, f"{finger}_meta")
        parts += _bone(frames, f"{finger}_pp", 0.0080) + _bone(frames, f"{finger}_mp", 0.0070)
        parts += _tip(frames, f"{finger}_dp")
    parts += _hinge(frames, "thumb_base")
    parts += _bone(frames, "thumb_pp", 0.0085) + _bone(frames, "thumb_mp", 0.0078) + _tip(frames, "thumb_dp")
    body = plate(OUTLINE, -0.0185, -0.0010, 0.012, 0.005)
    pad = plate(0.74 * (OUTLINE - [0, 0.06]) + [0, 0.06], -0.0040, 0.0012, 0.010, 0.002)
    parts += [frames.on_palm(body, BONE), frames.on_palm(pad, SKIN)]
    for across, tilt in ((0.020, 0.05), (0.004, 0.0), (-0.012, -0.05), (-0.027, -0.12)):
        rib = bar(
            [(0.0, 0.0014, 0.001, 0.0008), (0.01, 0.0028, 0.0022, 0.0015), (0.055, 0.0034, 0.0026, 0.002)]
        )
        c, s = np.cos(tilt), np.sin(tilt)
        turn = np.array([[c, 0, s], [-s, 0, c], [0, -1.0, 0]])
        parts.append(frames.on_palm(rib.moved(turn, [across * 0.7, 0.034, -0.0180]), ROLLER))
    stem = disc(0.017, 0.018, 0.002).moved(_TO_FINGERS, [0.0, 0.006, -0.009])
    return [*parts, frames.on_palm(stem, ROLLER)]


_TO_FINGERS = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
"""Turns z to the fingers, where across, to the fingers and out of the palm are x, y and z."""


def _roller(f: LinkFrame, z: float, radius: float) -> list[Shell]:
    """Half of a rolling joint, with its ligaments."""
    cylinder = disc(radius, 2.1 * radius, 0.0008).along_x().shifted(z=z)
    shells = [f.shell(cylinder, ROLLER)]
    for side in (-1, 1):
        string = housing(2.6 * radius, 0.0006, 0.0007, 0.0004, 0.0002).moved(_tilted(side * 0.5), [0, 0, 0])
        shells.append(
            f.shell(string.shifted(side * 0.9 * radius, -0.6 * radius * side, z - 1.3 * radius), STRING)
        )
    return shells


def _tilted(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]])


def _metacarpal(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    bone = bar(
        [
            (-0.006, 0.0055, 0.006, 0.003),
            (0.5 * f.length, 0.0075, 0.0078, 0.004),
            (f.length - 0.002, 0.0080, 0.0080, 0.004),
            (f.length + 0.002, 0.0070, 0.0070, 0.004),
        ]
    )
    return [f.shell(bone, BONE), *_roller(f, f.length, 0.0082)]


def _bone(frames: HandFrames, geom: str, radius: float) -> list[Shell]:
    f = frames.link(geom)
    waist = 0.62 * radius
    bone = bar(
        [
            (0.001, 0.85 * radius, 0.80 * radius, 0.4 * radius),
            (0.006, radius, 0.95 * radius, 0.5 * radius),
            (0.5 * f.length, waist, 0.8 * radius, 0.5 * waist),
            (f.length - 0.006, 0.95 * radius, 0.90 * radius, 0.5 * radius),
            (f.length - 0.001, 0.80 * radius, 0.75 * radius, 0.4 * radius),
        ]
    )
    pad = bar(
        [
            (0.22 * f.length, 0.4 * radius, 0.1 * radius, 0.08 * radius),
            (0.35 * f.length, 0.62 * radius, 0.34 * radius, 0.3 * radius),
            (0.68 * f.length, 0.60 * radius, 0.34 * radius, 0.3 * radius),
            (0.82 * f.length, 0.4 * radius, 0.1 * radius, 0.08 * radius),
        ]
    ).shifted(y=0.72 * radius)
    return [
        f.shell(bone, BONE),
        f.shell(pad, SKIN),
        *_roller(f, 0.0, 0.92 * radius),
        *_roller(f, f.length, 0.86 * radius),
    ]


def _tip(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    r = f.radius
    sleeve = bullet(0.72 * f.length + r, r, 0.95 * r, 0.75 * r).shifted(z=0.28 * f.length)
    bone = housing(0.45 * f.length, 0.9 * r, 0.85 * r, 0.5 * r, 0.001).shifted(z=0.0005)
    return [f.shell(bone, BONE), f.shell(sleeve, RUBBER), *_roller(f, 0.0, 0.9 * r)]


def _hinge(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    block = housing(f.length + 0.012, 0.0088, 0.0088, 0.004, 0.002).shifted(z=-0.006)
    return [f.shell(block, ROLLER)]
