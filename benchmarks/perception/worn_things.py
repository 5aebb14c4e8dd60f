"""Rings and watches on the hands of test captures."""

from __future__ import annotations

import numpy as np
import trimesh

from benchmarks.synthetic_captures.painted_mesh import PaintedMesh
from benchmarks.synthetic_captures.skin_and_sleeve import WRIST_HALF, Forearm
from fungrasp.media.hand_mesh import FINGER_RADII, REFERENCE_PALM
from fungrasp.media.surfaces import Color

METALS: tuple[Color, ...] = ((0.83, 0.69, 0.22), (0.77, 0.77, 0.78), (0.72, 0.45, 0.33), (0.15, 0.15, 0.16))
"""Gold, silver, copper, black steel, sRGB."""

STRAPS: tuple[Color, ...] = ((0.12, 0.10, 0.09), (0.42, 0.26, 0.15), (0.70, 0.70, 0.72), (0.16, 0.22, 0.38))
"""Black and brown leather, steel, blue rubber, sRGB."""

RING_FINGERS = (1, 2, 3)
"""Fingers that wear rings, counted from the index: middle, ring and little finger."""

WATCH_PLACE = (0.06, 0.14)
"""Where on the forearm a watch sits: 0 at the wrist, 1 at the elbow, as ``Forearm`` counts."""


def painted_ring(joints: np.ndarray, rng: np.random.Generator) -> PaintedMesh:
    """A ring round the first link of a finger.

    Args:
        joints: of the hand [m], shape [21, 3].
        rng: decides finger, metal and width.
    """
    finger = int(rng.choice(RING_FINGERS))
    knuckle, middle = joints[1 + 4 * finger], joints[2 + 4 * finger]
    scale = float(np.linalg.norm(joints[9] - joints[0])) / REFERENCE_PALM
    radius = scale * 0.5 * (FINGER_RADII[0] + FINGER_RADII[1])
    width = float(rng.uniform(0.003, 0.006))
    band = trimesh.creation.annulus(radius * 0.9, radius + 0.0013, width, sections=48)
    along = middle - knuckle
    band.apply_transform(_placed(along, knuckle + rng.uniform(0.55, 0.7) * along))
    color = METALS[int(rng.integers(len(METALS)))]
    return PaintedMesh(np.array(band.vertices), np.array(band.faces), np.tile(color, (len(band.vertices), 1)))


def painted_watch(arm: Forearm, back_of_hand: np.ndarray, rng: np.random.Generator) -> PaintedMesh:
    """A watch with its dial on the side of the back of the hand.

    Args:
        arm: the forearm.
        back_of_hand: direction out of the back of the hand, shape [3].
        rng: decides place, strap and dial.
    """
    place = rng.uniform(*WATCH_PLACE)
    width = float(rng.uniform(0.016, 0.024))
    point, axes = arm.frame(np.array([place]))
    half = arm.scale * np.array(WRIST_HALF) * arm.growth(np.array([place]))[0] + 0.0015
    around = 64
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # Across the strap: inner edge, outer edges, inner edge again, so that it has a thickness.
    profile = ((-0.5, -0.002), (-0.5, 0.002), (0.5, 0.002), (0.5, -0.002))
    rings = [
        point[0] + ((half + out) * rim) @ axes[0, :2] + along * width * axes[0, 2] for along, out in profile
    ]
    vertices = np.concatenate(rings)
    row, column = np.mgrid[: len(profile) - 1, :around]
    a, b = row * around + column, row * around + (column + 1) % around
    quads = np.stack([a, b, b + around, a + around], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    strap = np.tile(STRAPS[int(rng.integers(len(STRAPS)))], (len(vertices), 1))
    over = axes[0, 1] * (1.0 if axes[0, 1] @ back_of_hand > 0 else -1.0)
    size = float(rng.uniform(0.015, 0.021))
    dial = trimesh.creation.cylinder(size, 0.008, sections=48).subdivide().subdivide()
    local = np.array(dial.vertices)
    face = np.array([0.92, 0.92, 0.9]) if rng.uniform() < 0.5 else np.array([0.08, 0.09, 0.12])
    metal = np.array(METALS[int(rng.integers(len(METALS)))])
    inside = (np.hypot(local[:, 0], local[:, 1]) < 0.8 * size) & (local[:, 2] > 0)
    dial.apply_transform(_placed(over, point[0] + (half[1] + 0.004) * over))
    colors = np.where(inside[:, None], face, metal)
    return PaintedMesh(
        np.concatenate([vertices, dial.vertices]),
        np.concatenate([faces, np.asarray(dial.faces) + len(vertices)]),
        np.concatenate([strap, colors]),
    )


def _placed(along: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Matrix that turns z to a direction and moves the origin to a point, shape [4, 4]."""
    matrix = np.asarray(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], along))
    matrix[:3, 3] = center
    return matrix
