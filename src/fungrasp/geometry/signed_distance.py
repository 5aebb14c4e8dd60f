"""Signed distance of triangle meshes, precomputed on grids and queried for batches of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.files import atomic_path
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.geometry.array_distances import GridArrays, array_distances
from fungrasp.geometry.arrays import is_numpy, rows_like
from fungrasp.geometry.poses import Array
from fungrasp.geometry.triangle_mesh import triangle_mesh

if TYPE_CHECKING:
    import trimesh

MOST_SAMPLES = 2_000_000
"""Maximum number of surface samples of a mesh, and of point-triangle pairs in one batch."""

CHUNK = 50_000
"""Batch size of nearest-point queries."""


@dataclass(frozen=True)
class SignedDistanceGrid:
    """Distance to a surface, negative inside, at the corners of a regular grid."""

    origin: np.ndarray
    """Position of the first corner [m], shape [3], mesh frame."""
    spacing: float
    """Edge of a cell [m]."""
    values: np.ndarray
    """Signed distance [m], shape [X, Y, Z], float32."""

    @classmethod
    def from_mesh(
        cls,
        vertices: np.ndarray,
        faces: np.ndarray,
        spacing: float = 0.0025,
        margin: float = 0.03,
        max_cells: int = 2_000_000,
    ) -> SignedDistanceGrid:
        """Compute a grid from a mesh.

        Distances are exact near the surface. Farther away they are to the surface point nearest to a corner
        near the surface. The sign is that of the winding number, so that small holes are harmless.

        Args:
            vertices: [m], shape [V, 3].
            faces: vertex indices, shape [F, 3].
            spacing: edge of a cell [m]; increased if the grid would have more than ``max_cells``.
            margin: empty border around the mesh [m].
        """
        mesh = triangle_mesh(vertices, faces)
        low, high = mesh.bounds
        low, high = low - margin, high + margin
        spacing = max(spacing, float(np.cbrt(np.prod(high - low) / max_cells)))
        shape = np.ceil((high - low) / spacing).astype(int) + 1
        axes = [low[i] + spacing * np.arange(shape[i]) for i in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        samples = _SurfaceSamples(mesh)
        touched = np.zeros(shape, dtype=bool)
        touched[tuple(np.round((samples.points - low) / spacing).astype(int).T)] = True
        feet = np.zeros((*shape, 3))
        feet[touched] = samples.nearest(points[touched])[0]
        # The import takes as long as NumPy's, and grids are mostly read from the cache.
        from scipy import ndimage

        transformed: Any = ndimage.distance_transform_edt(~touched, return_indices=True)
        nearest_touched = transformed[1]
        distance = np.linalg.norm(points - feet[tuple(nearest_touched)], axis=-1)
        near = distance < 2.5 * spacing
        distance[near] = np.linalg.norm(points[near] - samples.nearest(points[near])[0], axis=-1)
        values = distance * _sign(mesh, points, distance, spacing)
        return cls(low, spacing, values.astype(np.float32))

    def mirrored(self) -> SignedDistanceGrid:
        """Return the grid of the surface reflected in the plane y = 0."""
        last = self.origin[1] + self.spacing * (self.values.shape[1] - 1)
        origin = np.array([self.origin[0], -last, self.origin[2]])
        return SignedDistanceGrid(origin, self.spacing, np.ascontiguousarray(self.values[:, ::-1]))

    def scaled(self, factor: float) -> SignedDistanceGrid:
        """Return the grid of the surface scaled by a factor."""
        values = (factor * self.values).astype(self.values.dtype)
        return SignedDistanceGrid(factor * self.origin, factor * self.spacing, values)

    def save(self, path: str | Path) -> None:
        """Write to an ``.npz`` file atomically."""
        with atomic_path(path) as temporary:
            np.savez_compressed(temporary, origin=self.origin, spacing=self.spacing, values=self.values)

    @classmethod
    def load(cls, path: str | Path) -> SignedDistanceGrid:
        """Read a file written by ``save``."""
        data = read_npz(path, "signed distances")
        return cls(data["origin"], float(data["spacing"]), data["values"])


class SignedDistanceBank:
    """Grids of several objects for batched queries. Each row of a batch selects an object."""

    def __init__(self, grids: Sequence[SignedDistanceGrid]):
        """
        Args:
            grids: one per object; queries refer to them by index.
        """
        shape = np.array([grid.values.shape for grid in grids])
        self.arrays = GridArrays(
            values=np.concatenate([grid.values.ravel() for grid in grids]),
            start=np.cumsum([0, *(grid.values.size for grid in grids[:-1])]),
            stride=np.stack([shape[:, 1] * shape[:, 2], shape[:, 2], np.ones(len(grids), dtype=int)], axis=1),
            last=shape - 1.000001,
            origin=np.array([grid.origin for grid in grids], dtype=float),
            spacing=np.array([grid.spacing for grid in grids], dtype=float),
        )
        """The concatenated grids."""
        self._copies: dict[tuple[str, str], GridArrays] = {}

    def query(self, grid: Array, points: Array) -> tuple[Array, Array]:
        """Return the trilinear signed distance and its exact gradient.

        Outside a grid, the distance to its border is added, so that the distance keeps increasing. NaN points
        yield NaN.

        Args:
            grid: index of each row's grid, shape [N].
            points: [m], shape [N, P, 3], object frame.

        Returns:
            distance [m], shape [N, P]; gradient, shape [N, P, 3].
        """
        if not is_numpy(points):
            return array_distances(self._on(points), grid, points)
        # Importing Numba takes half a second, so import it with the first query.
        from fungrasp.geometry.distance_queries import signed_distances

        where, rows = np.array(points, dtype=float), np.array(grid, dtype=np.int64)
        distance, gradient = np.empty(where.shape[:2]), np.empty(where.shape)
        signed_distances(self.arrays, rows, where, distance, gradient)
        return distance, gradient

    def _on(self, points: Array) -> GridArrays:
        """Return the arrays on the device of the points, copied once."""
        key = str(points.device), str(points.dtype)
        if key not in self._copies:
            # In single precision the index would round up to the last corner, which has no next corner.
            single = "float32" in key[1]
            arrays = self.arrays._replace(last=self.arrays.last - 1e-4 * single)
            self._copies[key] = GridArrays(*(rows_like(points, array) for array in arrays))
        return self._copies[key]


def project_to_surface(
    bank: SignedDistanceBank, grid: np.ndarray, points: np.ndarray, iterations: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Project points to the nearest surface points by Newton steps ``p - d(p) n(p)``.

    Args:
        grid: index of each row's grid in the bank, shape [N].
        points: [m], shape [N, P, 3], object frame.
        iterations: number of steps.

    Returns:
        surface points [m] and outward unit normals, each shape [N, P, 3].
    """
    from fungrasp.geometry.compiling import plain
    from fungrasp.geometry.distance_queries import nearest_surfaces

    surface, normal = np.empty(points.shape), np.empty(points.shape)
    nearest_surfaces(bank.arrays, plain(grid, np.int64), plain(points), iterations, surface, normal)
    return surface, normal


def mesh_signed_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return the exact signed distance, negative inside.

    Args:
        mesh: faces outward.
        points: [m], shape [P, 3].

    Returns:
        [m], shape [P].
    """
    nearest, _ = nearest_on_mesh(mesh, points)
    distance = np.linalg.norm(points - nearest, axis=-1)
    return np.where(_inside(mesh, points), -distance, distance)


def nearest_on_mesh(mesh: trimesh.Trimesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return nearest surface points, using the exact distance to the triangles of the nearest samples.

    Args:
        points: [m], shape [P, 3].

    Returns:
        nearest points [m], shape [P, 3]; face indices, shape [P].
    """
    return _surface_samples(mesh).nearest(points)


def winding_number(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return the winding number of the surface around each point: 1 inside, 0 outside, in between near holes.

    It is the sum of the solid angles of all triangles (Van Oosterom and Strackee, 1983) divided by 4 pi.

    Args:
        points: [m], shape [P, 3].

    Returns:
        shape [P].
    """
    corners = np.ascontiguousarray(mesh.triangles, dtype=np.float32)
    result = np.empty(len(points))
    chunk = max(1, min(2048, MOST_SAMPLES // len(corners)))
    for start in range(0, len(points), chunk):
        p = points[start : start + chunk, None, :].astype(np.float32)
        a, b, c = (corners[None, :, i] - p for i in range(3))
        la, lb, lc = (np.sqrt(np.einsum("pfi,pfi->pf", v, v)) for v in (a, b, c))
        volume = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
        flat = la * lb * lc
        flat += np.einsum("pfi,pfi->pf", a, b) * lc
        flat += np.einsum("pfi,pfi->pf", b, c) * la
        flat += np.einsum("pfi,pfi->pf", c, a) * lb
        result[start : start + chunk] = np.arctan2(volume, flat).sum(axis=1) / (2 * np.pi)
    return result


def crossing_number(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return how often the upward ray from each point leaves the mesh minus how often it enters it.

    For a closed mesh this is the winding number, at a cost that hardly grows with the number of faces.

    Args:
        mesh: closed, faces outward.
        points: [m], shape [P, 3].

    Returns:
        shape [P], integer.
    """
    result = np.zeros(len(points), dtype=np.int64)
    corners = np.asarray(mesh.triangles)
    flat = corners[..., :2]
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    size = np.maximum(high - low, 1e-9)
    # A negligible offset, so that no ray hits an edge of the mesh.
    at = points[:, :2] + size * [1.1e-9, 1.7e-9]
    over = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1) & (points[:, 2] < corners[..., 2].max()))
    # A planar grid; each cell lists the triangles whose bounding boxes overlap it.
    cells = int(np.clip(np.sqrt(len(corners)), 1, 512))
    first = np.clip(((flat.min(axis=1) - low) / size * cells).astype(int), 0, cells - 1)
    last = np.clip(((flat.max(axis=1) - low) / size * cells).astype(int), 0, cells - 1)
    span = last - first + 1
    count = span.prod(axis=1)
    owner = np.repeat(np.arange(len(corners)), count)
    row, column = np.divmod(_counted(count), span[owner, 1])
    cell = (first[owner, 0] + row) * cells + first[owner, 1] + column
    owner = owner[np.argsort(cell, kind="stable")]
    held = np.bincount(cell, minlength=cells * cells)
    start = np.cumsum(held) - held
    own = np.clip(((at[over] - low) / size * cells).astype(int), 0, cells - 1) @ [cells, 1]
    pairs = np.concatenate([[0], np.cumsum(held[own])])
    done = 0
    while done < len(over):
        stop = max(done + 1, int(np.searchsorted(pairs, pairs[done] + MOST_SAMPLES, side="right")) - 1)
        number = held[own[done:stop]]
        point = np.repeat(over[done:stop], number)
        face = owner[np.repeat(start[own[done:stop]], number) + _counted(number)]
        result += _crossings(corners[face], at[point], points[point, 2], point, len(points))
        done = stop
    return result


def _crossings(
    triangles: np.ndarray, at: np.ndarray, height: np.ndarray, point: np.ndarray, count: int
) -> np.ndarray:
    """Return the sum over triangles above each point: +1 for those facing up, -1 for those facing down.

    triangles: shape [Q, 3, 3]; at, height, point: xy, z and index of each triangle's point, shape [Q, 2],
    [Q], [Q].
    """
    a, b, c = (triangles[:, i, :2] - at for i in range(3))
    opposite = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    turn = np.where((opposite > 0).all(axis=1), 1, np.where((opposite < 0).all(axis=1), -1, 0))
    met = np.flatnonzero(turn)
    weight = opposite[met]
    above = np.sum(weight * triangles[met, :, 2], axis=1) / weight.sum(axis=1) > height[met]
    return np.bincount(point[met], weights=turn[met] * above, minlength=count).astype(np.int64)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _inside(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return which points a mesh encloses, shape [P]; by winding number if it is not closed."""
    if mesh.is_watertight and mesh.is_winding_consistent:
        return crossing_number(mesh, points) > 0
    return winding_number(mesh, points) > 0.5


def points_on_triangles(triangles: np.ndarray, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Sample points on triangles in rows along the longest edge, so that slivers need few points.

    Args:
        triangles: [m], shape [F, 3, 3].
        gap: maximum gap between rows and within a row [m].

    Returns:
        points [m], shape [Q, 3]; triangle index of each, shape [Q].
    """
    lengths = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=-1)
    turn = (lengths.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.swapaxes(np.take_along_axis(triangles, turn[..., None], axis=1), 0, 1)
    base = lengths.max(axis=1)
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(base, 1e-12)
    rows = 1 + np.ceil(height / gap).astype(int)
    owner = np.repeat(np.arange(len(triangles)), rows)
    up = _counted(rows) / np.maximum(rows - 1, 1)[owner]
    columns = 1 + np.ceil((1 - up) * base[owner] / gap).astype(int)
    along = _counted(columns) * np.repeat((1 - up) / np.maximum(columns - 1, 1), columns)
    owner, up = np.repeat(owner, columns), np.repeat(up, columns)
    return a[owner] + along[:, None] * (b - a)[owner] + up[:, None] * (c - a)[owner], owner


class _SurfaceSamples:
    """KD-tree of surface samples. Their gap is the largest of 1 mm, 1/200 of the mesh size and the gap that
    yields about ``MOST_SAMPLES``."""

    def __init__(self, mesh: trimesh.Trimesh):
        gap = max(0.001, float(mesh.extents.max()) / 200, float(np.sqrt(mesh.area / MOST_SAMPLES)))
        self.points, self._owners = points_on_triangles(np.asarray(mesh.triangles), gap)
        self._triangles = mesh.triangles
        # Samples are uniform, so midpoint splits suffice and take a third of the time.
        from scipy.spatial import KDTree

        self._tree = KDTree(self.points, balanced_tree=False, compact_nodes=False)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [self._nearest(points[i : i + CHUNK]) for i in range(0, max(len(points), 1), CHUNK)]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def _nearest(self, points: np.ndarray, candidates: int = 6) -> tuple[np.ndarray, np.ndarray]:
        import trimesh

        found = self._tree.query(points, k=candidates, workers=-1)[1]
        faces = self._owners[found]
        flat = trimesh.triangles.closest_point(
            self._triangles[faces.ravel()], np.repeat(points, candidates, axis=0)
        ).reshape(len(points), candidates, 3)
        best = np.argmin(np.sum((flat - points[:, None]) ** 2, axis=-1), axis=1)
        rows = np.arange(len(points))
        return flat[rows, best], faces[rows, best]


@lru_cache(maxsize=32)
def _surface_samples(mesh: trimesh.Trimesh) -> _SurfaceSamples:
    """Cache samples: a set of grasps queries its objects in turn."""
    return _SurfaceSamples(mesh)


def _counted(numbers: np.ndarray) -> np.ndarray:
    """Return 0, 1, ... n - 1 for each n, concatenated."""
    return np.arange(numbers.sum()) - np.repeat(np.cumsum(numbers) - numbers, numbers)


def _sign(mesh: trimesh.Trimesh, points: np.ndarray, distance: np.ndarray, spacing: float) -> np.ndarray:
    """Return the sign of each grid corner, shape [X, Y, Z]. Corners farther than half a cell from the surface
    share the sign of their connected component, because no grid edge between two of them can cross the
    surface. The others are tested one by one."""
    from scipy import ndimage

    flat = points.reshape(-1, 3)
    clear = distance > 0.55 * spacing
    labeled: Any = ndimage.label(clear)
    components, count = labeled
    inside = np.zeros(count + 1, dtype=bool)
    first = np.full(count + 1, -1)
    labels = components.ravel()
    order = np.argsort(distance.ravel())
    first[labels[order]] = order
    if count:
        inside[1:] = _inside(mesh, flat[first[1:]])
    result = inside[components]
    result[~clear] = _inside(mesh, points[~clear])
    return np.where(result, -1.0, 1.0)
