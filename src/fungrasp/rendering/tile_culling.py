"""Which rays are worth casting: tests of the geoms' bounding boxes against square tiles of a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.rendering.camera import Camera

TILE = 8
"""Side of the tiles of the picture that share a test [pixels]."""


@dataclass(frozen=True)
class Boxes:
    """Bounding boxes of what is visible, in one state; B boxes."""

    centres: np.ndarray
    """[m], world frame, shape [B, 3]."""
    rotations: np.ndarray
    """World from box, shape [B, 3, 3]."""
    halves: np.ndarray
    """Half the sides [m], shape [B, 3]."""
    unbounded: bool
    """Whether there also is something without a box (a plane)."""


def seen_tiles(camera: Camera, boxes: Boxes) -> np.ndarray:
    """Tiles in which something may appear, shape [tile rows, tile columns] bool."""
    shape = tile_shape(camera)
    if boxes.unbounded:
        return np.ones(shape, bool)
    directions = camera.directions(tile_centres(camera)).reshape(-1, 3)
    far = np.linalg.norm(boxes.centres - camera.position, axis=-1) + np.linalg.norm(boxes.halves, axis=-1)
    growth = np.broadcast_to(0.75 * TILE / camera.focal * far, (len(directions), len(far)))
    eye = np.broadcast_to(np.asarray(camera.position, dtype=float), directions.shape)
    return _lines_meet(eye, directions, growth, boxes).reshape(shape)


def blocked(
    points: np.ndarray, widths: np.ndarray, light: np.ndarray, spread: float, boxes: Boxes
) -> np.ndarray:
    """Which points may have something between them and the light.

    Args:
        points: [m], world frame, shape [P, 3].
        widths: a point stands for all points so near [m], shape [P].
        light: unit vector towards the light, shape [3].
        spread: tangent of the light's angular radius.

    Returns:
        shape [P] bool.
    """
    size = np.linalg.norm(boxes.halves, axis=-1)
    far = np.linalg.norm(boxes.centres - points[:, None], axis=-1) + size
    return _lines_meet(points, np.broadcast_to(light, points.shape), widths[:, None] + spread * far, boxes)


def near(points: np.ndarray, reach: np.ndarray, boxes: Boxes) -> np.ndarray:
    """Which points lie at most ``reach`` [m, shape P] from a box. points: [m], shape [P, 3]. Returns shape
    [P] bool.
    """
    local = _in_boxes(points, boxes, boxes.centres)
    outside = np.maximum(np.abs(local) - boxes.halves, 0.0)
    return np.any(np.einsum("pbi,pbi->pb", outside, outside) < reach[:, None] ** 2, axis=1)


def tile_shape(camera: Camera) -> tuple[int, int]:
    """Rows and columns of tiles that cover the picture."""
    return -(-camera.height // TILE), -(-camera.width // TILE)


def tile_centres(camera: Camera) -> np.ndarray:
    """Image points (u, v) in the middle of each tile, shape [rows, columns, 2]."""
    rows, columns = tile_shape(camera)
    u = np.arange(columns) * TILE + 0.5 * (TILE - 1)
    v = np.arange(rows) * TILE + 0.5 * (TILE - 1)
    return np.stack(np.meshgrid(u, v), axis=-1)


def spread_tiles(tiles: np.ndarray, camera: Camera) -> np.ndarray:
    """A value per tile as a value per pixel, shape [height, width]."""
    return tiles.repeat(TILE, 0).repeat(TILE, 1)[: camera.height, : camera.width]


def _lines_meet(origins: np.ndarray, directions: np.ndarray, growth: np.ndarray, boxes: Boxes) -> np.ndarray:
    """Which rays [P] meet some box whose faces are moved out by ``growth`` [m], shape [P, B]."""
    start = _in_boxes(origins, boxes, boxes.centres)
    slope = _in_boxes(directions, boxes, np.zeros(3))
    slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
    half = boxes.halves + growth[..., None]
    middle, reach = -start / slope, half / np.abs(slope)
    enter, leave = (middle - reach).max(-1), (middle + reach).min(-1)
    return np.any((leave >= np.maximum(enter, 0.0)), axis=1)


def _in_boxes(vectors: np.ndarray, boxes: Boxes, origins: np.ndarray) -> np.ndarray:
    """Vectors [P, 3] minus origins [B, 3] or [3] in the frame of each box, shape [P, B, 3]."""
    axes = boxes.rotations.transpose(1, 0, 2).reshape(3, -1)
    shift = np.einsum("bi,bij->bj", np.broadcast_to(origins, boxes.centres.shape), boxes.rotations)
    return (vectors @ axes).reshape(len(vectors), -1, 3) - shift
