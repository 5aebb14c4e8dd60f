"""Nodes of a page's scene: where they are, their colors, surfaces with edges."""

from __future__ import annotations

from typing import Any

import numpy as np

Color = tuple[float, float, float]
"""sRGB, each from 0 to 1."""

STILL = 2e-5
"""What moves by less is not sent to the browser [m, or part of a quaternion]."""


def creased(
    vertices: np.ndarray, faces: np.ndarray, corner_normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with vertices apart where it has an edge: browsers smooth over shared ones.

    Args:
        vertices: [m], shape [V, 3].
        faces: shape [T, 3].
        corner_normals: as of ``fungrasp.media.surfaces.corner_normals``, shape [T, 3, 3].
    """
    corners = np.column_stack([faces.ravel(), np.round(corner_normals.reshape(-1, 3) * 20)]).astype(int)
    _, first, index = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    return vertices[faces.ravel()[first]], index.reshape(-1, 3)


def move(handle: Any, pose: np.ndarray) -> None:
    """Put a node of the scene somewhere. pose: shape [7]."""
    if np.abs(handle.position - pose[:3]).max() > STILL:
        handle.position = pose[:3]
    if np.abs(handle.wxyz - pose[3:]).max() > STILL:
        handle.wxyz = pose[3:]


def pose_of(handle: Any) -> np.ndarray:
    """Where a node of the scene is, shape [7]."""
    return np.concatenate([handle.position, handle.wxyz])


def color_bytes(color: Any) -> tuple[int, int, int]:
    """8-bit color. color: sRGB, each from 0 to 1."""
    red, green, blue = (round(255 * float(c)) for c in np.clip(color, 0, 1))
    return red, green, blue
