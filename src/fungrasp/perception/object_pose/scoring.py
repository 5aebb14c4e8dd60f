"""Scores of a known object's poses in a depth image, by ray casting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points, rotation_matrix, transform_points
from fungrasp.grasps.human_hand import FINGER_RADII, FINGERTIPS
from fungrasp.perception.io.capture import Capture, depth_noise
from fungrasp.perception.object_pose.object_template import ObjectTemplate
from fungrasp.perception.scene.pixel_classes import SHARP
from fungrasp.perception.scene.segmentation import Segmentation

UNSEEN = 0.1  # Weight of an unexplained pixel of the mesh's silhouette, relative to an explained one.
# Weight of an unexplained pixel of a thing within reach outside the mask, relative to one in the mask.
# Without it, a part of the object, or a gap between fingers, would fit as well as all of the object.
LEFT_OUT = 0.2
# Confidence that a thing in front of the object is not an unrecognized part of the arm.
OCCLUDER = 0.25
# Shifts of the hand along the viewing ray [m]: its depth is off by 18 mm in real images.
HAND_SHIFTS = (-0.03, -0.015, 0.0, 0.015, 0.03)
SHIFT_COST = 0.2  # Cost of such a shift, as a fraction of an equal distance of the fingertips.
LEAST_SAMPLES = 30  # Smallest number of surface samples whose colors are compared.
CONTACT = 0.05  # Distance of the fingertips from the surface that halves the quality [m].


@dataclass(frozen=True, eq=False)
class PoseScores:
    """Scores of H poses."""

    quality: np.ndarray
    """Value by which poses are ranked, 0 to 1, shape [H]: explained pixels / (explained pixels + unexplained
    pixels of the mask + contradicted pixels + ``UNSEEN`` of the silhouette's other pixels + ``LEFT_OUT`` of
    other things); less if the fingertips are far."""
    explained: np.ndarray
    """Fraction of the mask's pixels that the pose explains, shape [H]."""
    visible: np.ndarray
    """Fraction of the mesh's silhouette, without skin, that agrees with the measurement, shape [H]."""
    contact: np.ndarray
    """Mean distance of the three nearest fingertips' skin from the surface [m], shape [H]; 0 without a
    hand."""
    pixels: np.ndarray
    """Measured pixels that the pose explains, shape [H]."""
    hidden: np.ndarray
    """Fraction of the mesh's silhouette hidden by skin, shape [H]."""

    def chosen(self, rows: np.ndarray) -> PoseScores:
        """Select some of the poses."""
        return PoseScores(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class PoseScorer:
    """R rays through the image that score poses, made by ``pose_scorer``."""

    known: ObjectTemplate
    """Known object."""
    directions: np.ndarray
    """Directions of the rays with z = 1, camera frame, shape [R, 3]."""
    pixels: np.ndarray
    """Row and column of each ray, shape [R, 2]."""
    depth: np.ndarray
    """Depth measured at each ray [m], shape [R]."""
    spread: np.ndarray
    """Standard deviation of that depth [m], shape [R]."""
    support: np.ndarray
    """Probability that the pixel shows the object or another thing within reach, 0 to 1, shape [R]."""
    skin: np.ndarray
    """Probability that it shows skin, which may hide the object, 0 to 1, shape [R]."""
    background: np.ndarray
    """Probability that it shows background, shape [R]; 0 if depth is sharp."""
    masks: np.ndarray
    """Probability that it shows the object if a mask is right, 0 to 1, shape [N, R]."""
    opaque: np.ndarray
    """Confidence that the object is not behind the thing at the pixel, shape [R]: 1 for the table,
    ``OCCLUDER`` times ``support`` for others."""
    joints: np.ndarray | None
    """Joints of the hand [m], camera frame, shape [21, 3]; None if unknown."""
    step: int
    """Distance between the rays' rows and columns [pixels]."""

    def __call__(self, poses: np.ndarray, owner: np.ndarray, stretch: np.ndarray | None = None) -> PoseScores:
        """Score poses.

        Args:
            poses: object in the camera frame, shape [H, 7].
            owner: index of the mask that each pose was fitted to, shape [H] int.
            stretch: factors along the mesh's axes, shape [H, 3], see ``MeshRays.hits``.
        """
        # Only rays that meet the mesh matter: all sums are over these.
        pose, ray, seen = self.known.rays.hits(poses, self.directions, stretch)

        def summed(values: np.ndarray) -> np.ndarray:
            return np.bincount(pose, values, len(poses))

        noise, support, skin = self.spread[ray], self.support[ray], self.skin[ray]
        error = seen - self.depth[ray]
        likeness = np.exp(-0.5 * np.square(error / (1.5 * noise)))
        mine = self.masks[owner[pose], ray]
        total = np.maximum(self.masks.sum(axis=1), 1.0)[owner]
        explained = summed(likeness * mine) / total
        everywhere = summed(likeness * support)
        in_front = error < -(3.0 * noise + 0.003)
        behind = np.where(error > 3.0 * noise + 0.006, self.opaque[ray], 0.0)
        against_open = np.maximum(in_front + behind, self.background[ray])
        contradicted = summed(against_open * (1.0 - mine)) / total
        hit = np.maximum(np.bincount(pose, minlength=len(poses)), 1)
        hidden = summed(skin)
        # Only the part of the silhouette that no skin hides.
        visible = summed(likeness * (1.0 - skin)) / np.maximum(hit - hidden, 1.0)
        against = (1.0 - explained + contradicted) * total + UNSEEN * (hit - summed(likeness))
        # Other things near the hand: the object is one of them.
        others = ((1.0 - self.masks) @ self.support)[owner]
        left_out = others - summed(likeness * (1.0 - mine) * support)
        quality = everywhere / (everywhere + against + LEFT_OUT * left_out)
        contact = np.zeros(len(poses))
        if self.joints is not None:
            contact = self._contact(poses, stretch)
            quality = quality / (1.0 + np.square(contact / CONTACT))
        return PoseScores(quality, explained, visible, contact, everywhere * self.step**2, hidden / hit)

    def _contact(self, poses: np.ndarray, stretch: np.ndarray | None) -> np.ndarray:
        """Return the mean distance of the three nearest fingertips' skin from the surface [m], shape [H], at
        the best shift of the hand along the viewing ray: landmarks say least about its depth."""
        assert self.joints is not None
        tips = self.joints[FINGERTIPS]
        nearest = np.full(len(poses), np.inf)
        for shift in HAND_SHIFTS:
            moved = inverse_transform_points(poses, tips * (1.0 + shift / tips[:, 2].mean()))
            if stretch is not None:
                moved = moved / stretch[:, None]
            distance, _ = self.known.surface.distance.query(np.zeros(len(poses), dtype=int), moved)
            if stretch is not None:
                distance = distance * stretch.mean(axis=1)[:, None]
            apart = np.sort(np.abs(distance - FINGER_RADII[:, 3]), axis=1)[:, :3].mean(axis=1)
            nearest = np.minimum(nearest, apart + abs(shift) * SHIFT_COST)
        return nearest


def pose_scorer(
    known: ObjectTemplate,
    capture: Capture,
    view: Segmentation,
    masks: Sequence[np.ndarray],
    table: np.ndarray | None,
    joints: np.ndarray | None,
    rays: int,
) -> PoseScorer:
    """Create rays through the part of the image in which the object may be.

    Args:
        view: segmentation, with the standard deviation of the depth.
        masks: proposals for the object's pixels, bool, shape [H, W] each.
        table: plane ``[nx ny nz d]``, camera frame, or None.
        joints: joints of the hand [m], camera frame, shape [21, 3], or None.
        rays: about how many meet a mask.
    """
    k = capture.intrinsics
    rows, columns = np.nonzero(np.logical_or.reduce(masks) & capture.measured)
    pad = int(0.6 * known.size * k.fx / float(np.median(capture.depth[rows, columns])))
    step = max(1, round(float(np.sqrt(max(mask.sum() for mask in masks) / rays))))
    v, u = np.mgrid[
        max(0, rows.min() - pad) : min(k.height, rows.max() + pad) : step,
        max(0, columns.min() - pad) : min(k.width, columns.max() + pad) : step,
    ].reshape(2, -1)
    keep = capture.measured[v, u]
    v, u = v[keep], u[keep]
    depth = capture.depth[v, u].astype(float)
    directions = k.deproject(np.stack([u, v], axis=-1), np.ones(len(u)))
    shown, spread = view.support[v, u], view.spread[v, u]
    skin, background = view.classes.skin[v, u], view.classes.background[v, u]
    if view.edge_width <= SHARP:
        # Sharp depth is better evidence.
        background = np.zeros(len(u))
    opaque = OCCLUDER * shown
    if table is not None:
        height = (directions * depth[:, None]) @ table[:3] + table[3]
        opaque = np.where(np.abs(height) < 3 * depth_noise(depth), 1.0, opaque)
    mine = np.stack([np.where(mask[v, u], shown, 0.0) for mask in masks])
    # Single precision, because the arrays are large.
    depth, spread, shown, skin, background, mine, opaque = (
        array.astype(np.float32) for array in (depth, spread, shown, skin, background, mine, opaque)
    )
    pixels = np.stack([v, u], axis=-1)
    return PoseScorer(
        known, directions, pixels, depth, spread, shown, skin, background, mine, opaque, joints, step
    )


def color_agreement(
    known: ObjectTemplate, capture: Capture, poses: np.ndarray, allowed: np.ndarray
) -> np.ndarray:
    """Return the correlation of the mesh's colors with those of the image, -1 to 1, shape [H]; 0 if the mesh
    has no colors or too little of it is visible.

    The correlation is over visible surface samples and the three channels together, so it does not depend on
    brightness and tint of the light.

    Args:
        poses: object in the camera frame, shape [H, 7].
        allowed: pixels that may show the object, shape [H, W] bool.
    """
    result = np.zeros(len(poses))
    for i, (model, image) in enumerate(_seen_colors(known, capture, poses, allowed)):
        if not len(model):
            continue
        model, image = model - model.mean(axis=0), image - image.mean(axis=0)
        spread = float(np.sqrt(np.square(model).sum() * np.square(image).sum()))
        if np.square(model).sum() > 1e-3 * len(model) and spread > 0:
            result[i] = float((model * image).sum()) / spread
    return result


def _seen_colors(
    known: ObjectTemplate, capture: Capture, poses: np.ndarray, allowed: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the mesh's and the image's colors at each pose's visible samples, RGB 0 to 1, shape [S, 3] each;
    empty for fewer than ``LEAST_SAMPLES``. Nothing for meshes without colors."""
    if known.colors is None:
        return
    points = transform_points(poses, known.surface.samples)
    normals = known.normals @ rotation_matrix(poses[:, 3:]).swapaxes(-1, -2)
    # Samples seen at less than 73 degrees from their normal; the camera is at the origin.
    facing = -np.einsum("hmi,hmi->hm", normals, points) > 0.3 * np.linalg.norm(points, axis=-1)
    with np.errstate(invalid="ignore"):
        pixels = np.rint(np.nan_to_num(capture.intrinsics.project(points), nan=-1.0)).astype(np.int64)
    height, width = allowed.shape
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    depth = capture.depth[v, u]
    seen = inside & facing & allowed[v, u] & (np.abs(points[..., 2] - depth) < 3 * depth_noise(depth))
    for i, shown in enumerate(seen):
        chosen = shown if shown.sum() >= LEAST_SAMPLES else np.zeros_like(shown)
        yield known.colors[chosen], capture.color[v[i, chosen], u[i, chosen]] / 255.0
