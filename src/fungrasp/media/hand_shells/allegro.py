"""The Allegro Hand v4: square black servo housings with side plates, large white round fingertips, a flat
wide palm with three fingers."""

from __future__ import annotations

import numpy as np

from fungrasp.media.hand_shells.frames import Finish, HandFrames, Shell
from fungrasp.media.hand_shells.shapes import bar, bullet, disc, housing, plate

BLACK: Finish = ((0.115, 0.12, 0.135), 0.35, 0.35)
PLATE: Finish = ((0.30, 0.31, 0.33), 0.5, 0.5)
STEEL: Finish = ((0.66, 0.67, 0.69), 0.7, 0.7)
RUBBER: Finish = ((0.13, 0.13, 0.14), 0.05, 0.05)
WHITE: Finish = ((0.93, 0.92, 0.88), 0.15, 0.2)

WIDTH, HEIGHT = 0.0098, 0.0135
"""Half of a link's section, along and across the bending axis [m]: 19.6 x 27.5 mm in the data sheet."""

OUTLINE = np.array(
    [
        (0.0565, -0.001),
        (-0.0565, -0.001),
        (-0.0565, -0.046),
        (-0.0495, -0.058),
        (-0.0495, -0.095),
        (0.0255, -0.095),
        (0.0255, -0.060),
        (0.0565, -0.042),
    ]
)
"""Of the palm: across to the index finger, to the fingers [m]."""


def allegro_shells(frames: HandFrames) -> list[Shell]:
    """All parts of the hand."""
    parts: list[Shell] = []
    for finger in ("ff", "mf", "rf", "th"):
        for link in ("proximal", "medial"):
            parts += _segment(frames, f"{finger}_{link}")
        parts += _tip(frames, f"{finger}_distal")
        parts += _base(frames, f"{finger}_base")
    body = plate(OUTLINE, -0.0290, 0.0085, 0.006, 0.0025)
    pad = plate(0.86 * (OUTLINE - [0, -0.048]) + [0, -0.048], 0.0075, 0.0108, 0.005, 0.0015)
    lid = plate(0.80 * (OUTLINE - [0, -0.048]) + [0, -0.048], -0.0312, -0.0285, 0.005, 0.0012)
    parts += [frames.on_palm(body, BLACK), frames.on_palm(pad, RUBBER), frames.on_palm(lid, PLATE)]
    for across, up in ((0.050, -0.007), (-0.050, -0.007), (-0.043, -0.089), (0.019, -0.089)):
        parts.append(frames.on_palm(disc(0.0026, 0.0016).shifted(across, up, -0.0296), STEEL))
    # Slots between the fingers.
    for across in (0.0218, -0.0218):
        parts.append(
            frames.on_palm(
                housing(0.024, 0.0022, 0.014, 0.002, 0.001).moved(_UP, [across, -0.030, -0.009]), PLATE
            )
        )
    return parts


_UP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
"""Turns z to the fingers."""


def _segment(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    ends = f.length + 0.012
    body = housing(ends - 0.004, WIDTH, HEIGHT - 0.001, 0.003, 0.0018).shifted(z=-0.004)
    parts = [f.shell(body, BLACK)]
    for side in (-1, 1):
        cheek = bar(
            [
                (-0.010, 0.0012, 0.006, 0.001),
                (-0.004, 0.0012, 0.0110, 0.001),
                (0.55 * ends, 0.0012, 0.0110, 0.001),
                (0.55 * ends + 0.004, 0.0012, 0.008, 0.001),
            ]
        )
        parts.append(f.shell(cheek.shifted(x=side * (WIDTH + 0.0008)), PLATE))
        cap = disc(0.0062, 0.0026).along_x().shifted(side * (WIDTH + 0.0016), 0.0, -0.002)
        parts.append(f.shell(cap, STEEL))
    grip = housing(0.7 * f.length, 0.0075, 0.0012, 0.001, 0.0008).shifted(
        y=HEIGHT - 0.0006, z=0.14 * f.length
    )
    return [*parts, f.shell(grip, RUBBER)]


def _tip(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    collar = housing(0.45 * f.length + 0.006, WIDTH, 0.0115, 0.004, 0.0015).shifted(z=-0.006)
    dome = bullet(0.72 * f.length + f.radius, 0.0122, 0.0122, 0.0122, steps=7).shifted(z=0.28 * f.length)
    parts = [f.shell(collar, BLACK), f.shell(dome, WHITE)]
    for side in (-1, 1):
        parts.append(
            f.shell(disc(0.0058, 0.0026).along_x().shifted(side * (WIDTH + 0.0008), 0.0, -0.002), STEEL)
        )
    return parts


def _base(frames: HandFrames, geom: str) -> list[Shell]:
    body, center, axes, half = frames.box(geom)
    block = housing(2 * half[2], half[0], half[1], 0.003, 0.0018).shifted(z=-half[2])
    return [Shell(body, block.moved(axes, center), BLACK)]
