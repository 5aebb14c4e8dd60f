"""The LEAP Hand: bare black servos with their horns, thin pale brackets between them, a printed pale palm."""

from __future__ import annotations

import numpy as np

from fungrasp.media.hand_shells.frames import Finish, HandFrames, LinkFrame, Shell
from fungrasp.media.hand_shells.shapes import Solid, bar, bullet, disc, housing

SERVO: Finish = ((0.12, 0.125, 0.135), 0.3, 0.3)
PRINT: Finish = ((0.86, 0.85, 0.82), 0.12, 0.15)
HORN: Finish = ((0.74, 0.75, 0.77), 0.8, 0.6)
TIP: Finish = ((0.95, 0.94, 0.90), 0.10, 0.15)
LABEL: Finish = ((0.55, 0.57, 0.60), 0.3, 0.3)

FINGERS = (
    ("mcp_joint", "pip", "dip", "fingertip"),
    *((f"mcp_joint_{i}", f"pip_{i}", f"dip_{i}", f"fingertip_{i}") for i in (2, 3)),
)


def leap_shells(frames: HandFrames) -> list[Shell]:
    """All parts of the hand."""
    parts: list[Shell] = []
    for base, side, middle, tip in FINGERS:
        parts += _bracket(frames, base) + _servo_box(frames, f"{base}_servo")
        parts += _servo_link(frames, side) + _servo_link(frames, middle) + _tip(frames, tip)
    parts += _servo_link(frames, "thumb_temp_base") + _bracket(frames, "thumb_pip")
    parts += _servo_link(frames, "thumb_dip") + _tip(frames, "thumb_fingertip")
    for name in ("servo_index", "servo_middle", "servo_ring"):
        parts += _servo_box(frames, name)
    for name in ("palm_upper", "palm_middle", "palm_heel", "palm_edge", "thumb_mount"):
        body, center, axes, half = frames.box(name)
        bevel = min(0.004, 0.4 * float(half.min()))
        block = housing(2 * half[2], half[0], half[1], 0.005, bevel).shifted(z=-half[2])
        parts.append(Shell(body, block.moved(axes, center), PRINT))
    for across, up in ((0.012, -0.047), (-0.075, -0.047), (-0.053, -0.088), (-0.030, -0.030)):
        parts.append(frames.on_palm(disc(0.0022, 0.0014).shifted(across, up, -0.0120), SERVO))
        parts.append(frames.on_palm(disc(0.0022, 0.0014).shifted(across, up, 0.0348), SERVO))
    return parts


def _servo(length: float, width: float, height: float) -> Solid:
    """A servo's housing along z, from 0."""
    return housing(length, width, height, 0.0022, 0.0014)


def _horns(f: LinkFrame, z: float, width: float, screws: bool = True) -> list[Shell]:
    """The discs at both sides of a servo, with their screws."""
    shells = []
    for side in (-1, 1):
        horn = disc(0.0080, 0.0024).along_x().shifted(side * (width + 0.0008), 0.0, z)
        shells.append(f.shell(horn, HORN))
        for turn in np.arange(4 * screws) * np.pi / 2 + np.pi / 4:
            y, dz = 0.0050 * np.cos(turn), 0.0050 * np.sin(turn)
            screw = (
                disc(0.0011, 0.0030, 0.0003, count=6).along_x().shifted(side * (width + 0.0012), y, z + dz)
            )
            shells.append(f.shell(screw, SERVO))
    return shells


def _servo_link(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    length = f.length + 0.019
    body = _servo(length, 0.0100, 0.0115).shifted(z=-0.0085)
    shells = [f.shell(body, SERVO), *_horns(f, 0.0, 0.0100)]
    if f.length > 0.025:
        # The bracket that holds the next servo.
        for side in (-1, 1):
            cheek = bar(
                [
                    (0.35 * f.length, 0.0010, 0.0060, 0.0008),
                    (0.45 * f.length, 0.0010, 0.0100, 0.0008),
                    (f.length + 0.010, 0.0010, 0.0100, 0.0008),
                ]
            )
            shells.append(f.shell(cheek.shifted(x=side * 0.0112), PRINT))
        label = housing(0.4 * f.length, 0.006, 0.0004, 0.0003, 0.0002).shifted(y=-0.0117, z=0.2 * f.length)
        shells.append(f.shell(label, LABEL))
    return shells


def _servo_box(frames: HandFrames, geom: str) -> list[Shell]:
    body, center, axes, half = frames.box(geom)
    block = _servo(2 * half[2], half[0], half[1]).shifted(z=-half[2])
    return [Shell(body, block.moved(axes, center), SERVO)]


def _bracket(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    block = housing(f.length + 0.016, 0.0110, 0.0100, 0.004, 0.0018).shifted(z=-0.008)
    return [f.shell(block, PRINT), *_horns(f, 0.0, 0.0110)]


def _tip(frames: HandFrames, geom: str) -> list[Shell]:
    f = frames.link(geom)
    root = housing(0.45 * f.length + 0.008, 0.0112, 0.0100, 0.003, 0.0016).shifted(z=-0.008)
    dome = bullet(0.72 * f.length + f.radius, 0.0110, 0.0112, 0.0090).shifted(z=0.28 * f.length)
    return [f.shell(root, PRINT), f.shell(dome, TIP), *_horns(f, 0.0, 0.0112, screws=False)]
