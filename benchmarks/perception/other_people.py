"""Other people in test captures: a second hand, and a head above the table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from benchmarks.synthetic_captures.painted_mesh import PaintedMesh, mirrored_mesh, mixed
from benchmarks.synthetic_captures.skin_and_sleeve import blotches, painted_hand, painted_sleeve
from fungrasp.media.surfaces import Color

HEAD = (0.098, 0.076, 0.118)
"""Half the depth, width and height of a head [m]."""

HAIR: tuple[Color, ...] = (
    (0.10, 0.08, 0.07),
    (0.28, 0.18, 0.11),
    (0.55, 0.40, 0.22),
    (0.70, 0.68, 0.66),
    (0.42, 0.20, 0.12),
)
"""Black, brown, blond, gray and red hair, sRGB."""

SHIRTS: tuple[Color, ...] = ((0.75, 0.75, 0.77), (0.18, 0.24, 0.40), (0.62, 0.20, 0.18), (0.30, 0.32, 0.30))
"""What people on the other side of the table wear, sRGB."""


def other_hand(
    joints: np.ndarray, tone: Color, cloth: Color | None, rng: np.random.Generator
) -> list[PaintedMesh]:
    """The hand and arm of another person, right or left, with or without a sleeve; where it is stays to be
    chosen.

    Args:
        joints: of a right hand [m], wherever it is above a table at z = 0, shape [21, 3].
        tone: of the skin, sRGB.
        cloth: color of the sleeve; None: bare.
        rng: decides the side, and the skin's blotches.
    """
    skin, arm = painted_hand(joints, tone, rng)
    parts = [skin]
    if cloth is not None:
        parts.append(painted_sleeve(arm, float(rng.uniform(0.2, 0.5)), cloth, rng))
    return [mirrored_mesh(part) for part in parts] if rng.uniform() < 0.5 else parts


def painted_person(tone: Color, rng: np.random.Generator) -> list[PaintedMesh]:
    """A head with a face, and shoulders. The head's middle is the origin, it looks along x, z is up.

    Args:
        tone: of the skin, sRGB.
        rng: decides hair, shirt and shape.
    """
    skin = np.asarray(tone)
    ball = trimesh.creation.icosphere(subdivisions=5)
    unit = np.array(ball.vertices)
    size = np.array(HEAD) * rng.uniform(0.93, 1.07, 3)
    x, y, z = (unit * size).T
    front = np.clip(unit[:, 0], 0, 1)
    # The jaw is narrower than the skull, and the face flatter than the back of the head.
    y = y * (1 - 0.28 * np.clip(-unit[:, 2], 0, 1) ** 1.5)
    x = x * (1 - 0.10 * front) + 0.012 * np.clip(-unit[:, 2], 0, 1) * front
    nose = np.exp(-((y / 0.012) ** 2)) * np.clip(1 - np.abs(z + 0.012) / 0.03, 0, 1) ** 0.7
    nose *= 0.45 + 0.55 * np.clip((0.018 - z) / 0.04, 0, 1)
    eyes = np.exp(-(((np.abs(y) - 0.031) / 0.016) ** 2) - ((z - 0.018) / 0.012) ** 2)
    brow = np.exp(-((z - 0.036) ** 2) / 0.008**2) * (np.abs(y) < 0.055)
    lips = np.exp(-((y / 0.022) ** 4) - ((z + 0.058) / 0.008) ** 2)
    seam = np.exp(-((y / 0.022) ** 4) - ((z + 0.058) / 0.0016) ** 2)
    chin = np.exp(-((y / 0.018) ** 2) - ((z + 0.095) / 0.014) ** 2)
    x = x + front * (0.022 * nose - 0.007 * eyes + 0.003 * brow + 0.004 * lips - 0.003 * seam + 0.006 * chin)
    vertices = np.stack([x, y, z], axis=-1)
    red = 0.25 * np.exp(-(((np.abs(y) - 0.042) / 0.02) ** 2) - ((z + 0.02) / 0.02) ** 2) + 0.2 * nose
    red = front * (red + 0.8 * lips) + 0.10 * blotches(vertices, rng)
    colors = mixed(skin, skin * [0.93, 0.66, 0.60], np.clip(red, 0, 1))
    colors = colors * (1 - front * np.clip(0.25 * eyes + 0.45 * seam, 0, 1))[:, None]
    hair = np.asarray(HAIR[int(rng.integers(len(HAIR)))])
    hairline = 0.055 + 0.01 * rng.normal()
    covered = (z > hairline) | ((x < -0.01) & (z > -0.05 - 0.06 * rng.uniform()))
    brows = front * np.exp(-(((z - 0.037) / 0.0045) ** 2)) * (np.abs(np.abs(y) - 0.032) < 0.018)
    colors = mixed(colors, np.broadcast_to(hair, colors.shape), np.clip(brows, 0, 1))
    strands = 0.85 + 0.3 * blotches(vertices * [1, 1, 0.3], rng)
    colors = np.where(covered[:, None], np.clip(hair * strands[:, None], 0, 1), colors)
    vertices = vertices * (1 + 0.08 * covered[:, None])
    head = PaintedMesh(vertices, np.array(ball.faces), np.clip(colors, 0, 1))
    iris = np.array([[0.35, 0.22, 0.12], [0.30, 0.42, 0.52], [0.30, 0.36, 0.22]][int(rng.integers(3))])
    face_x = float(x[np.argmax(eyes * front)])
    parts = [head]
    for side in (-1, 1):
        parts.append(_eye(np.array([face_x - 0.0065, side * 0.031, 0.018]), iris))
        ear = (np.array([-0.005, side * size[1] * 1.0, 0.0]), (0.018, 0.008, 0.030))
        parts.append(_ball(*ear, mixed(skin, skin * [0.93, 0.66, 0.60], np.array([0.3]))[0]))
    parts.append(_ball(np.array([-0.02, 0, -0.13]), (0.05, 0.052, 0.10), 0.95 * skin))
    shirt = np.asarray(SHIRTS[int(rng.integers(len(SHIRTS)))])
    parts.append(_ball(np.array([-0.04, 0, -0.36]), (0.13, 0.22, 0.20), shirt))
    return parts


def _eye(center: np.ndarray, iris: np.ndarray) -> PaintedMesh:
    ball = trimesh.creation.icosphere(subdivisions=4)
    unit = np.array(ball.vertices)
    off = np.degrees(np.arccos(np.clip(unit[:, 0], -1, 1)))
    colors = np.where(off[:, None] < 30, iris, np.array([0.92, 0.90, 0.88]))
    colors = np.where(off[:, None] < 13, 0.04, colors)
    # The lids leave a slit of the eye open.
    lid = np.abs(unit[:, 2]) > 0.5
    colors = np.where(lid[:, None], 0.5 * colors + 0.25 * np.array([0.7, 0.5, 0.42]), colors)
    return PaintedMesh(center + 0.0125 * unit, np.array(ball.faces), colors)


def _ball(center: np.ndarray, size: Sequence[float], color: np.ndarray) -> PaintedMesh:
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = center + np.array(ball.vertices) * size
    return PaintedMesh(vertices, np.array(ball.faces), np.tile(color, (len(vertices), 1)))
