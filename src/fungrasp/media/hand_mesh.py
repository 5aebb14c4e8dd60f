"""Visual mesh of a human hand from its 21 joints: blended tapered capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError

LINK_JOINTS = (
    (0, 5),
    *((1, 2), (2, 3), (3, 4)),
    *((5, 6), (6, 7), (7, 8)),
    *((9, 10), (10, 11), (11, 12)),
    *((13, 14), (14, 15), (15, 16)),
    *((17, 18), (18, 19), (19, 20)),
)
"""Joints at the near and far end of each of the 16 human links."""

REFERENCE_PALM = 0.091
"""Distance from wrist to middle knuckle of the hand with the sizes below [m]; other hands are scaled."""

FINGER_RADII = (0.0108, 0.0090, 0.0078, 0.0066)
"""Radii of the index finger at its joints, from knuckle to tip [m]. They are for rendering; perception and
contacts use simple capsules."""

THUMB_RADII = (0.0150, 0.0118, 0.0100, 0.0082)
"""Radii of the thumb at its joints [m]."""

_SIZES = {"index": 1.0, "middle": 1.02, "ring": 0.96, "pinky": 0.84}


@dataclass(frozen=True)
class HandMesh:
    """A closed surface with V vertices and T triangles."""

    vertices: np.ndarray
    """Positions of the vertices [m], world frame, shape [V, 3]."""
    faces: np.ndarray
    """Vertex indices, counter-clockwise from outside, shape [T, 3]."""
    links: np.ndarray
    """Weights of the 16 links for each vertex, summing to 1, shape [V, 16]."""


@dataclass(frozen=True)
class _Cone:
    start: np.ndarray
    end: np.ndarray
    start_radius: float
    end_radius: float


def human_hand_mesh(joints: np.ndarray, *, cell: float = 0.0022) -> HandMesh:
    """Return the mesh of a right hand with a part of the forearm.

    Args:
        joints: [m], world frame, in the order of docs/concepts.md, shape [21, 3].
        cell: grid spacing [m].

    Raises:
        FungraspError: ``joints`` has the wrong shape, is not finite, or does not have the size of a hand.
    """
    joints = np.asarray(joints, dtype=float)
    if joints.shape != (21, 3) or not np.isfinite(joints).all():
        raise FungraspError(
            f"a human hand is 21 joints of 3 finite numbers, not an array of shape {joints.shape}"
        )
    length = float(np.linalg.norm(joints[5] - joints[0]))
    if not 0.03 < length < 0.3:
        raise FungraspError(f"the joints are not a human hand: wrist to middle knuckle is {length:.3g} m")
    scale = length / REFERENCE_PALM
    palm, fingers = _palm(joints, scale), _fingers(joints, scale)
    cones = [*palm, *(cone for chain in fingers for cone in chain)]
    low = (
        np.min([np.minimum(c.start, c.end) - max(c.start_radius, c.end_radius) for c in cones], axis=0)
        - 4 * cell
    )
    high = (
        np.max([np.maximum(c.start, c.end) + max(c.start_radius, c.end_radius) for c in cones], axis=0)
        + 4 * cell
    )
    shape = tuple(int(n) for n in np.ceil((high - low) / cell))
    skin = _blend(palm, low, cell, shape, 0.011 * scale)
    for chain in fingers:
        finger = _blend(chain, low, cell, shape, 0.003 * scale)
        root = chain[0].start
        near = _distance(root, low, cell, shape) < 0.034 * scale
        skin = np.where(near, _smooth_minimum(skin, finger, 0.009 * scale), np.minimum(skin, finger))
    vertices, faces = surface_nets(skin)
    vertices = low + cell * vertices
    return HandMesh(vertices, faces, _membership(vertices, joints, scale))


def surface_nets(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero level set of a field on a grid, with one vertex per intersected cell.

    Args:
        field: negative inside, positive on the border, shape [X, Y, Z].

    Returns:
        vertices in units of the grid, shape [V, 3]; faces, counter-clockwise from outside, shape [T, 3].
    """
    inside = field < 0
    cells = tuple(n - 1 for n in field.shape)
    total = np.zeros((*cells, 3), np.float32)
    count = np.zeros(cells, np.float32)
    for axis in range(3):
        a, b = _ends(axis)
        crosses = inside[a] != inside[b]
        gap = np.where(crosses, field[a] - field[b], 1.0)
        along = np.where(crosses, field[a] / gap, 0.0).astype(np.float32)
        others = [k for k in range(3) if k != axis]
        for i in (0, 1):
            for j in (0, 1):
                window = [slice(None)] * 3
                window[others[0]] = slice(i, cells[others[0]] + i)
                window[others[1]] = slice(j, cells[others[1]] + j)
                here = crosses[tuple(window)]
                count += here
                total[..., axis] += along[tuple(window)]
                total[..., others[0]] += here * np.float32(i)
                total[..., others[1]] += here * np.float32(j)
    active = count > 0
    number = np.full(cells, -1)
    number[active] = np.arange(int(active.sum()))
    vertices = np.argwhere(active) + total[active] / count[active][:, None]
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        a, b = _ends(axis)
        crosses = inside[a] != inside[b]
        at = np.argwhere(crosses)
        at = at[(at[:, u] > 0) & (at[:, v] > 0) & (at[:, u] < cells[u]) & (at[:, v] < cells[v])]
        step_u, step_v = np.eye(3, dtype=int)[u], np.eye(3, dtype=int)[v]
        corners = [
            number[tuple((at - p * step_u - q * step_v).T)] for p, q in ((1, 1), (0, 1), (0, 0), (1, 0))
        ]
        quads = np.stack(corners, axis=-1)
        outward = inside[a][tuple(at.T)]
        quads = np.where(outward[:, None], quads, quads[:, ::-1])
        faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return vertices, np.concatenate(faces)


def _ends(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    a, b = [slice(None)] * 3, [slice(None)] * 3
    a[axis], b[axis] = slice(None, -1), slice(1, None)
    return tuple(a), tuple(b)


def _fingers(joints: np.ndarray, scale: float) -> list[list[_Cone]]:
    chains = []
    starts = {"index": 1, "middle": 5, "ring": 9, "pinky": 13}
    for name, start in starts.items():
        radii = [r * _SIZES[name] * scale for r in FINGER_RADII]
        chains.append(_chain(joints[start : start + 4], radii))
    return [*chains, _chain(joints[17:21], [r * scale for r in THUMB_RADII])]


def _chain(points: np.ndarray, radii: Sequence[float]) -> list[_Cone]:
    points = points.copy()
    last = points[3] - points[2]
    length = np.linalg.norm(last)
    points[3] -= last / max(length, 1e-9) * min(0.75 * radii[3], 0.8 * length)
    return [_Cone(points[i], points[i + 1], radii[i], radii[i + 1]) for i in range(3)]


def _palm(joints: np.ndarray, scale: float) -> list[_Cone]:
    wrist, index, middle, ring, pinky, thumb = (joints[i] for i in (0, 1, 5, 9, 13, 17))
    forward = _unit(0.5 * (middle + ring) - wrist)
    across = index - pinky
    across = _unit(across - forward * (across @ forward))
    front = _unit(np.cross(across, forward))
    if front @ (thumb - 0.5 * (index + wrist)) < 0:
        front = -front

    def at(along: float, aside: float, ahead: float = 0.0) -> np.ndarray:
        return wrist + scale * (along * forward + aside * across + ahead * front)

    cones = []
    roots = (at(0.008, 0.015), at(0.006, 0.006), at(0.006, -0.005), at(0.008, -0.015))
    for root, knuckle, radius in zip(
        roots, (index, middle, ring, pinky), (0.0118, 0.0120, 0.0114, 0.0104), strict=True
    ):
        cones.append(_Cone(root, knuckle, 0.0135 * scale, radius * scale))
    for a, b in ((index, middle), (middle, ring), (ring, pinky)):
        back = -0.010 * scale * forward
        cones.append(_Cone(a + back, b + back, 0.0108 * scale, 0.0104 * scale))
    ball = 0.35 * joints[17] + 0.65 * joints[18]
    cones.append(_Cone(0.6 * wrist + 0.4 * thumb, ball, 0.0150 * scale, 0.0135 * scale))
    cones.append(
        _Cone(0.5 * (thumb + wrist), 0.45 * index + 0.35 * wrist + 0.2 * ball, 0.0135 * scale, 0.0105 * scale)
    )
    heel = at(0.016, -0.018, 0.004)
    cones.append(_Cone(heel, 0.45 * heel + 0.55 * pinky, 0.0140 * scale, 0.0125 * scale))
    cones.append(_Cone(at(-0.045, 0.011), at(0.004, 0.010), 0.0185 * scale, 0.0160 * scale))
    cones.append(_Cone(at(-0.045, -0.011), at(0.004, -0.010), 0.0185 * scale, 0.0160 * scale))
    return cones


def _blend(
    cones: Sequence[_Cone], low: np.ndarray, cell: float, shape: tuple[int, ...], width: float
) -> np.ndarray:
    field = np.full(shape, 0.05, np.float32)
    for cone in cones:
        reach = max(cone.start_radius, cone.end_radius) + width + 3 * cell
        first = np.floor((np.minimum(cone.start, cone.end) - reach - low) / cell).astype(int).clip(0)
        last = np.ceil((np.maximum(cone.start, cone.end) + reach - low) / cell).astype(int) + 1
        box = tuple(slice(int(f), int(min(e, n))) for f, e, n in zip(first, last, shape, strict=True))
        size = tuple(s.stop - s.start for s in box)
        grid = np.moveaxis(np.indices(size, dtype=np.float32), 0, -1) * np.float32(cell)
        field[box] = _smooth_minimum(field[box], _cone_distance(grid, cone, low + cell * first), width)
    return field


def _cone_distance(points: np.ndarray, cone: _Cone, origin: np.ndarray) -> np.ndarray:
    start, axis = (cone.start - origin).astype(np.float32), (cone.end - cone.start).astype(np.float32)
    offset = points - start
    t = np.clip(offset @ axis / np.float32(max(float(axis @ axis), 1e-12)), 0, 1)
    away = offset - t[..., None] * axis
    radius = cone.start_radius + t * np.float32(cone.end_radius - cone.start_radius)
    return np.sqrt(np.einsum("...i,...i->...", away, away)) - radius


def _smooth_minimum(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    overlap = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - overlap**2 * np.float32(0.25 * width)


def _distance(point: np.ndarray, low: np.ndarray, cell: float, shape: tuple[int, ...]) -> np.ndarray:
    x, y, z = (low[k] + cell * np.arange(shape[k]) - point[k] for k in range(3))
    return np.sqrt(x[:, None, None] ** 2 + y[None, :, None] ** 2 + z[None, None, :] ** 2)


def _membership(vertices: np.ndarray, joints: np.ndarray, scale: float) -> np.ndarray:
    palm = [_Cone(joints[0], joints[k], 0.012, 0.011) for k in (1, 5, 9, 13)]
    palm.append(_Cone(2 * joints[0] - joints[5], joints[0], 0.016, 0.016))
    radii = [0.0, *(0.009, 0.008, 0.007) * 4, 0.0135, 0.011, 0.009]
    zero = np.zeros(3)

    def to(cone: _Cone) -> np.ndarray:
        return _cone_distance(vertices.astype(np.float32), cone, zero)

    distance = [np.min([to(cone) for cone in palm], axis=0)]
    for (a, b), radius in zip(LINK_JOINTS[1:], radii[1:], strict=True):
        distance.append(to(_Cone(joints[a], joints[b], radius * scale, radius * scale)))
    nearest = np.stack(distance, axis=-1) / (0.0022 * scale)
    weight = np.exp(nearest.min(-1, keepdims=True) - nearest)
    return weight / weight.sum(-1, keepdims=True)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
