"""Whether the image has the colours that a coloured mesh would show in a pose."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import rotation_matrix, transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.known_object import KnownObject
from fungrasp.perception.object_pose.scoring import noise_at


def colour_agreement(
    known: KnownObject, capture: Capture, poses: np.ndarray, allowed: np.ndarray
) -> np.ndarray:
    """Correlation of the mesh's colours with those of the image, over the visible surface samples and the
    three channels together: blind to the brightness and the tint of the light.

    Args:
        known: the object.
        capture: the image.
        poses: object in the camera frame, shape [H, 7].
        allowed: pixels that may show the object, shape [H, W] bool.

    Returns:
        -1 to 1, shape [H]; 0 where the mesh has no colours or too little of it is seen.
    """
    result = np.zeros(len(poses))
    if known.colours is None:
        return result
    points = transform_points(poses, known.surface.samples)
    normals = known.normals @ rotation_matrix(poses[:, 3:]).swapaxes(-1, -2)
    facing = -np.einsum("hmi,hmi->hm", normals, points) > 0.3 * np.linalg.norm(points, axis=-1)
    with np.errstate(invalid="ignore"):
        pixels = np.rint(np.nan_to_num(capture.intrinsics.project(points), nan=-1.0)).astype(np.int64)
    height, width = allowed.shape
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    depth = capture.depth[v, u]
    seen = inside & facing & allowed[v, u] & (np.abs(points[..., 2] - depth) < 3 * noise_at(depth))
    for i, shown in enumerate(seen):
        if shown.sum() < 30:
            continue
        model = known.colours[shown]
        image = capture.colour[v[i, shown], u[i, shown]] / 255.0
        model, image = model - model.mean(axis=0), image - image.mean(axis=0)
        spread = float(np.sqrt(np.square(model).sum() * np.square(image).sum()))
        if spread > 1e-3 * len(model):
            result[i] = float((model * image).sum()) / spread
    return result
