"""The Shadow Dexterous Hand: slender dark phalanges between metal knuckles, padded fronts, nails, a palm with
metacarpal ridges, and a metal wrist."""

from __future__ import annotations

import numpy as np

from fungrasp.media.hand_shells.frames import Finish, HandFrames, Shell
from fungrasp.media.hand_shells.shapes import ball, bar, bullet, disc, housing, plate

DARK: Finish = ((0.14, 0.14, 0.15), 0.3, 0.3)
METAL: Finish = ((0.70, 0.71, 0.73), 0.8, 0.6)
FLESH: Finish = ((0.42, 0.43, 0.45), 0.08, 0.1)
NAIL: Finish = ((0.80, 0.80, 0.80), 0.5, 0.5)
BRASS: Finish = ((0.72, 0.60, 0.36), 0.6, 0.5)

OUTLINE = np.array(
    [
        (0.044, 0.0875),
        (-0.020, 0.0875),
        (-0.022, 0.052),
        (-0.038, 0.030),
        (-0.039, 0.004),
        (-0.027, -0.012),
        (0.034, -0.012),
        (0.042, 0.004),
        (0.042, 0.040),
    ]
)
"""Of the palm: across to the index finger, to the fingers [m]."""


def shadow_shells(frames: HandFrames) -> list[Shell]:
    """All parts of the hand."""
    parts: list[Shell] = []
    for finger in ("ff", "mf", "rf", "lf"):
        parts.append(_knuckle(frames, f"{finger}_knuckle", 0.0095))
        parts += _phalanx(frames, f"{finger}_proximal", 0.0086) + _phalanx(frames, f"{finger}_middle", 0.0078)
        parts += _tip(frames, f"{finger}_distal")
    parts += [_knuckle(frames, "th_base", 0.013), _knuckle(frames, "th_hub", 0.0105)]
    parts += _phalanx(frames, "th_proximal", 0.0100) + _phalanx(frames, "th_middle", 0.0090)
    parts += _tip(frames, "th_distal")
    parts += [
        frames.on_palm(plate(OUTLINE, -0.0115, 0.0105, 0.010, 0.0045), DARK),
        frames.on_palm(plate(0.80 * (OUTLINE - [0, 0.036]) + [0, 0.036], 0.009, 0.0128, 0.009, 0.003), FLESH),
        # Base of the thumb.
        frames.on_palm(ball(0.0165).shifted(0.031, 0.006, 0.008), DARK),
    ]
    for across in (0.033, 0.011, -0.011):
        ridge = bar(
            [(0.0, 0.003, 0.002, 0.0015), (0.012, 0.0045, 0.0032, 0.002), (0.078, 0.006, 0.004, 0.003)]
        ).moved(_TO_FINGERS, [across, 0.006, -0.0105])
        parts.append(frames.on_palm(ridge, METAL))
    wrist = disc(0.0235, 0.016, 0.002).moved(_TO_FINGERS, [0.002, -0.019, 0.0])
    ring = disc(0.026, 0.006, 0.0015).moved(_TO_FINGERS, [0.002, -0.029, 0.0])
    parts += [frames.on_palm(wrist, METAL), frames.on_palm(ring, DARK)]
    body, center, axes, half = frames.box("lf_metacarpal")
    # Its frame stands across the palm (x), out of it (-y) and to the fingers (z).
    block = housing(2 * half[2] + 0.01, half[0], 0.0088, 0.006, 0.003).shifted(z=-half[2] - 0.004)
    return [*parts, Shell(body, block.moved(axes, center), DARK)]


_TO_FINGERS = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
"""Turns z to the fingers, where across, to the fingers and out of the palm are x, y and z."""


def _knuckle(frames: HandFrames, geom: str, radius: float) -> Shell:
    model = frames.model
    body = model.body(int(model.geom(geom).bodyid[0])).name
    return Shell(body, ball(radius).moved(np.eye(3), model.geom(geom).pos), METAL)


def _phalanx(frames: HandFrames, geom: str, radius: float) -> list[Shell]:
    f = frames.link(geom)
    start, end = -0.003, f.length + 0.006
    waist = 0.82 * radius
    body = bar(
        [
            (start, 0.7 * radius, 0.7 * radius, 0.5 * radius),
            (start + 0.003, radius, radius, 0.8 * radius),
            (0.45 * f.length, waist, waist, 0.7 * waist),
            (end - 0.006, 0.95 * radius, 0.95 * radius, 0.75 * radius),
            (end - 0.002, 0.8 * radius, 0.8 * radius, 0.6 * radius),
        ]
    )
    pad = bar(
        [
            (0.05 * f.length, 0.4 * radius, 0.15 * radius, 0.1 * radius),
            (0.2 * f.length, 0.75 * radius, 0.42 * radius, 0.35 * radius),
            (0.8 * f.length, 0.72 * radius, 0.42 * radius, 0.35 * radius),
            (0.98 * f.length, 0.4 * radius, 0.15 * radius, 0.1 * radius),
        ]
    ).shifted(y=0.72 * radius)
    axle = disc(0.62 * radius, 2.3 * radius, 0.0008).along_x().shifted(z=f.length + 0.0045)
    pins = disc(0.30 * radius, 2.45 * radius, 0.0004).along_x().shifted(z=f.length + 0.0045)
    return [f.shell(body, DARK), f.shell(pad, FLESH), f.shell(axle, METAL), f.shell(pins, BRASS)]


def _tip(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    r = f.radius
    core = bullet(f.length + r + 0.004, 0.97 * r, 0.92 * r, 0.7 * r).shifted(z=-0.004)
    pad = bullet(f.length + 0.9 * r, 0.88 * r, 0.55 * r, 0.5 * r).shifted(y=0.52 * r)
    nail = bar(
        [
            (0.45 * f.length, 0.50 * r, 0.05 * r, 0.04 * r),
            (0.60 * f.length, 0.66 * r, 0.12 * r, 0.10 * r),
            (f.length + 0.35 * r, 0.52 * r, 0.12 * r, 0.10 * r),
            (f.length + 0.55 * r, 0.30 * r, 0.05 * r, 0.04 * r),
        ]
    ).shifted(y=-0.86 * r)
    return [f.shell(core, DARK), f.shell(pad, FLESH), f.shell(nail, NAIL)]
