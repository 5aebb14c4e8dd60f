"""Solids from which hands are built: sections that are joined, outlines that are thickened, round edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Solid:
    """A closed surface; V vertices, T triangles."""

    vertices: np.ndarray
    """[m], shape [V, 3]."""
    faces: np.ndarray
    """Counter-clockwise from outside, shape [T, 3]."""

    def moved(self, rotation: np.ndarray, position: np.ndarray | Sequence[float]) -> Solid:
        """After a rigid motion. rotation: shape [3, 3], of determinant 1; position: [m], shape [3]."""
        return replace(self, vertices=self.vertices @ np.asarray(rotation).T + position)

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
        """Somewhere else. x, y, z: [m]."""
        return replace(self, vertices=self.vertices + np.array([x, y, z]))

    def along_x(self) -> Solid:
        """With its z axis turned to x."""
        return replace(self, vertices=self.vertices[:, [2, 0, 1]])


def loft(sections: Sequence[np.ndarray]) -> Solid:
    """The solid that runs through sections, closed at its ends.

    Args:
        sections: of equally many points, counter-clockwise seen from the last one's side; star-shaped about
            their means; [m], each of shape [n, 3].
    """
    rings = np.stack(sections)
    count, size = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), [rings[0].mean(axis=0), rings[-1].mean(axis=0)]])
    i, j = np.mgrid[: count - 1, :size]
    a, b = i * size + j, i * size + (j + 1) % size
    sides = np.stack([a, b, b + size, a, b + size, a + size], axis=-1).reshape(-1, 3)
    first, last = np.arange(size), (count - 1) * size + np.arange(size)
    bottom = np.stack([np.full(size, count * size), np.roll(first, -1), first], axis=-1)
    top = np.stack([np.full(size, count * size + 1), last, np.roll(last, -1)], axis=-1)
    return Solid(vertices, np.concatenate([sides, bottom, top]))


def rectangle(width: float, height: float, radius: float, corner: int = 4) -> np.ndarray:
    """A rectangle with round corners about the origin [m], shape [4 corner, 2].

    Args:
        width, height: half of its sides [m].
        radius: of the corners [m], at most half the shorter side.
        corner: points of each corner.
    """
    radius = min(radius, 0.999 * width, 0.999 * height)
    angle = np.linspace(0, np.pi / 2, corner)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    inner = np.array([width - radius, height - radius])
    quarters = [
        arc * [1, 1] + inner * [1, 1],
        (arc * [-1, 1] + inner * [-1, 1])[::-1],
        arc * [-1, -1] + inner * [-1, -1],
        (arc * [1, -1] + inner * [1, -1])[::-1],
    ]
    return np.concatenate(quarters)


def bar(sections: Sequence[tuple[float, float, float, float]], corner: int = 4) -> Solid:
    """A bar along z whose section changes. sections: of each, z, half width, half height, radius of the
    corners [m]."""
    rings = []
    for z, width, height, radius in sections:
        outline = rectangle(width, height, radius, corner)
        rings.append(np.column_stack([outline, np.full(len(outline), z)]))
    return loft(rings)


def housing(length: float, width: float, height: float, radius: float, bevel: float) -> Solid:
    """A bar along z from 0 to ``length`` with broken edges. width, height: half of its sides [m]."""
    bevel = min(bevel, 0.45 * length, 0.8 * width, 0.8 * height)
    thin, short = width - bevel, height - bevel
    return bar(
        [
            (0.0, thin, short, radius - bevel / 2),
            (bevel, width, height, radius),
            (length - bevel, width, height, radius),
            (length, thin, short, radius - bevel / 2),
        ],
        corner=3,
    )


def bullet(length: float, width: float, height: float, radius: float, steps: int = 6) -> Solid:
    """A bar along z from 0 that ends round at ``length``: a fingertip. width, height: half of its sides."""
    cap = min(max(width, height), 0.95 * length)
    turns = np.linspace(0, 0.97 * np.pi / 2, steps)
    sections = [(0.0, 0.9 * width, 0.9 * height, 0.9 * radius), (0.06 * length, width, height, radius)]
    for turn in turns:
        c = float(np.cos(turn))
        z = length - cap + cap * float(np.sin(turn))
        round_corner = radius + (min(width, height) - radius) * float(np.sin(turn))
        sections.append((z, width * c, height * c, round_corner * c))
    return bar(sections)


def disc(radius: float, thickness: float, bevel: float = 0.0008, count: int = 18) -> Solid:
    """A disc about z, from -thickness/2 to thickness/2, with broken edges [m]."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    half, bevel = thickness / 2, min(bevel, 0.4 * thickness)
    profile = [
        (-half, radius - bevel),
        (bevel - half, radius),
        (half - bevel, radius),
        (half, radius - bevel),
    ]
    return loft([np.column_stack([r * circle, np.full(count, z)]) for z, r in profile])


def ball(radius: float, count: int = 18, rings: int = 9) -> Solid:
    """A ball about the origin [m]."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    turns = np.linspace(-0.98, 0.98, rings) * np.pi / 2
    return loft(
        [np.column_stack([radius * np.cos(t) * circle, np.full(count, radius * np.sin(t))]) for t in turns]
    )


def plate(outline: np.ndarray, low: float, high: float, radius: float, bevel: float) -> Solid:
    """An outline that is thickened along z.

    Args:
        outline: corners, counter-clockwise, star-shaped about their mean [m], shape [n, 2].
        low, high: where it begins and ends [m].
        radius: of its corners [m].
        bevel: of its edges [m].
    """
    ring = _rounded(np.asarray(outline, dtype=float), radius)
    small = _inset(ring, bevel)
    middle = _inset(ring, 0.3 * bevel)
    levels = [
        (low, small),
        (low + 0.3 * bevel, middle),
        (low + bevel, ring),
        (high - bevel, ring),
        (high - 0.3 * bevel, middle),
        (high, small),
    ]
    return loft([np.column_stack([points, np.full(len(points), z)]) for z, points in levels])


def _rounded(corners: np.ndarray, radius: float, steps: int = 4) -> np.ndarray:
    """Corners cut by curves that begin ``radius`` before them."""
    points = []
    for before, here, after in zip(
        np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True
    ):
        back, ahead = before - here, after - here
        reach = min(radius, 0.45 * float(np.linalg.norm(back)), 0.45 * float(np.linalg.norm(ahead)))
        start, end = here + reach * back / np.linalg.norm(back), here + reach * ahead / np.linalg.norm(ahead)
        for t in np.linspace(0, 1, steps):
            points.append((1 - t) ** 2 * start + 2 * t * (1 - t) * here + t**2 * end)
    return np.array(points)


def _inset(ring: np.ndarray, distance: float) -> np.ndarray:
    """The ring moved inwards."""
    tangent = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    return ring + distance * normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
