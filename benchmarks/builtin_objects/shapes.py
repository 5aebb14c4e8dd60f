"""Convex solids, as the points they are the hull of: [m], shape [N, 3], object frame.

Neighboring solids of a row (``ring``, ``sweep``) share their corners exactly: their union has no seams.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

Solid = np.ndarray
"""Points [m], shape [N, 3]: the solid is their convex hull."""

Vector = Sequence[float] | np.ndarray
"""Three numbers."""

Profile = Sequence[tuple[float, float]]
"""Radius and height [m] of the points of an outline that is turned about an axis."""


def box(size: Sequence[float], center: Sequence[float] = (0, 0, 0), bevel: float = 0.0) -> Solid:
    """A box of ``size`` around ``center`` whose edges are cut at 45 degrees, ``bevel`` from each face [m]."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    half = np.asarray(size, dtype=float) / 2
    corners = [signs * (half - bevel * (1 - np.eye(3)[axis])) for axis in range(3)]
    return np.unique(np.concatenate(corners), axis=0) + np.asarray(center)


def prism(outline: Sequence[tuple[float, float]], bottom: float, top: float, bevel: float = 0.0) -> Solid:
    """A plate with a convex ``outline`` in x and y [m], from z = ``bottom`` to ``top`` [m].

    Args:
        bevel: the outline shrinks by this towards its center [m] at the top and bottom, over the same height.
    """
    points = np.asarray(outline, dtype=float)
    inward = points.mean(axis=0) - points
    small = points + inward * (bevel / np.linalg.norm(inward, axis=1, keepdims=True))
    levels = [(small, bottom), (points, bottom + bevel), (points, top - bevel), (small, top)]
    return np.concatenate([np.column_stack([p, np.full(len(p), z)]) for p, z in levels])


def ring(outer: Profile, inner: Profile, pieces: int = 12, fineness: int = 4) -> list[Solid]:
    """A hollow solid of revolution about z, cut into ``pieces`` equal sectors.

    Args:
        outer: convex profile.
        inner: profile of the hole; straight within a sector, so the hole has ``pieces`` sides.
        pieces: number of sectors.
        fineness: edges of the outer circle per sector.
    """
    angles = np.linspace(0, 2 * np.pi, pieces * fineness, endpoint=False)
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    solids = []
    for k in range(pieces):
        arc = corners[np.arange(k * fineness, (k + 1) * fineness + 1) % len(corners)]
        points = [_at(arc, radius, height) for radius, height in outer]
        points += [_at(arc[[0, -1]], radius, height) for radius, height in inner]
        solids.append(np.concatenate(points))
    return solids


def ellipse(
    center: Vector,
    first: Vector,
    second: Vector,
    corners: int = 16,
    squareness: float = 2.0,
) -> np.ndarray:
    """A section for ``sweep``: a superellipse around ``center`` with half-axes ``first`` and ``second`` [m].

    Args:
        corners: number of points; a multiple of 4 puts an edge, not a corner, at the end of each axis.
        squareness: exponent; 2 is an ellipse, larger is closer to a rectangle.

    Returns:
        [m], shape [corners, 3].
    """
    angles = (np.arange(corners) + 0.5) * 2 * np.pi / corners
    power = 2 / squareness
    c, s = np.cos(angles), np.sin(angles)
    along, across = np.sign(c) * np.abs(c) ** power, np.sign(s) * np.abs(s) ** power
    return np.asarray(center) + along[:, None] * np.asarray(first) + across[:, None] * np.asarray(second)


def sweep(sections: Sequence[np.ndarray]) -> list[Solid]:
    """A bar through convex ``sections``, each [m], shape [S, 3]: one solid between each two neighbors."""
    return [np.concatenate(pair) for pair in pairwise(sections)]


def bow(
    start: Sequence[float],
    end: Sequence[float],
    reach: float,
    half_width: float,
    half_depth: float,
    pieces: int = 5,
) -> list[Solid]:
    """A handle in the xz plane: half an ellipse from ``start`` to ``end``, bulging by ``reach`` to +x [m].

    Args:
        start: x and z of its lower end [m].
        end: x and z of its upper end [m].
        half_width: of the section, along y [m].
        half_depth: of the section, in the plane [m].
        pieces: number of straight solids.
    """
    low, high = np.array([start[0], 0, start[1]]), np.array([end[0], 0, end[1]])
    middle, along = (low + high) / 2, (high - low) / 2
    outward = np.cross([0, 1, 0], along)
    outward = outward / np.linalg.norm(outward) * reach
    sections = []
    for angle in np.linspace(-np.pi / 2, np.pi / 2, pieces + 1):
        normal = np.cos(angle) * outward / reach + np.sin(angle) * along / np.linalg.norm(along)
        at = middle + np.cos(angle) * outward + np.sin(angle) * along
        sections.append(ellipse(at, half_depth * normal, (0, half_width, 0), squareness=2.5))
    return sweep(sections)


def eye(
    center: Sequence[float], half: Sequence[float], section: Sequence[float], pieces: int = 8
) -> list[Solid]:
    """A closed elliptic loop in the xy plane.

    Args:
        center: [m], shape [3].
        half: half-axes of its middle line along x and y [m].
        section: half-width in the plane and half-height along z of the bar [m].
        pieces: number of straight solids.
    """
    sections = []
    for angle in np.linspace(0, 2 * np.pi, pieces, endpoint=False):
        normal = np.array([np.cos(angle) / half[0], np.sin(angle) / half[1], 0])
        normal /= np.linalg.norm(normal)
        at = np.asarray(center) + np.array([half[0] * np.cos(angle), half[1] * np.sin(angle), 0])
        sections.append(ellipse(at, section[0] * normal, (0, 0, section[1]), corners=12))
    return sweep([*sections, sections[0]])


def along_x(solid: Solid) -> Solid:
    """The solid turned so that its z axis points along x."""
    return np.roll(solid, 1, axis=1)


def along_y(solid: Solid) -> Solid:
    """The solid turned so that its z axis points along y."""
    return np.roll(solid, 2, axis=1)


def moved(solid: Solid, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
    """The solid moved by (x, y, z) [m]."""
    return solid + np.array([x, y, z])


def turned(solid: Solid, angle: float, pivot: Sequence[float] = (0, 0, 0)) -> Solid:
    """The solid turned by ``angle`` [rad] about the vertical through ``pivot`` [m]."""
    c, s = np.cos(angle), np.sin(angle)
    return (solid - np.asarray(pivot)) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + np.asarray(pivot)


def mirrored(solid: Solid) -> Solid:
    """The solid with y and z negated: turned half round about x."""
    return solid * [1, -1, -1]


def _at(directions: np.ndarray, radius: float, height: float) -> np.ndarray:
    return np.column_stack([radius * directions, np.full(len(directions), height)])
