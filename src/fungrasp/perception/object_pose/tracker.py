"""Tracking of a known object: each pose is fitted from the previous one.

A fit from a near start takes a hundredth of the search's work, so it keeps up with a camera. Only the part of
the image around the object is used. The object's colors are learned at its first pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    transform_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.capture import Intrinsics, depth_noise
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.search import IcpSettings, ObjectEvidence, fit_poses, free_space
from fungrasp.perception.scene.pixel_classes import color_cells, table_of_colors

RAYS = 900  # About how many rays meet the object.
POINTS = 300  # Number of measured points, and of surface samples, in a fit.
STARTS = 6  # Starts of the fit: the predicted pose, the last one, and random ones near the prediction.
# Standard deviations of the random starts: shift [m] and rotation [degrees]. A hand moves an object by at
# most 1 m/s and 6 rad/s: 7 cm and 23 degrees at 15 images per second, most of which is predicted.
SPREAD = (0.012, 12.0)
NEAR = 0.03  # Difference in depth from the predicted surface within which a pixel may show the object [m].
MARGIN = 0.05  # Margin around the predicted object [m]: the motion between two images.
# Coarse fit of all starts, fine fit of the best two.
ROUNDS = (IcpSettings(5, 120, 120, 0.02), IcpSettings(6, POINTS, POINTS, 0.006))
LEAST_POINTS = 25  # Smallest number of measured points from which the object is tracked.
# Fraction of the learned colors that each image renews: light changes as the object turns.
LEARNING = 0.05
# Smallest score of a pose whose colors and motion are used; below, the object may be lost.
FOLLOWED = 0.5


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """Pose of the object in one image."""

    pose: np.ndarray
    """Pose in the camera frame, shape [7]; the last one if the object was not found."""
    score: float
    """Fraction of the visible silhouette in which depth and color agree, 0 to 1. Below ``FOLLOWED``, the
    object is probably lost and must be searched again."""


class ObjectTracker:
    """Tracks a known object."""

    def __init__(
        self, mesh: ObjectModel | trimesh.Trimesh, intrinsics: Intrinsics, pose: np.ndarray, *, seed: int = 0
    ):
        """
        Args:
            mesh: object [m].
            intrinsics: intrinsics of the images.
            pose: pose in the first image, camera frame, shape [7], from ``estimate_object_pose``.
            seed: random seed.

        Raises:
            FungraspError: the mesh has no faces, or the pose is not 7 finite numbers.
        """
        self.pose = np.array(pose, dtype=float)
        if self.pose.shape != (7,) or not np.isfinite(self.pose).all():
            raise FungraspError("ObjectTracker: pose must be 7 finite numbers")
        self._known, self._intrinsics = object_template(mesh), intrinsics
        self._rng = np.random.default_rng(seed)
        self._motion: np.ndarray | None = None
        self._colors: tuple[np.ndarray, np.ndarray] | None = None

    def update(self, color: np.ndarray, depth: np.ndarray) -> ObjectTrack:
        """Track the object in the next image.

        Args:
            color: RGB, uint8, shape [H, W, 3].
            depth: [m], shape [H, W]; 0: not measured.

        Raises:
            FungraspError: an image does not have the size of the intrinsics.
        """
        k = self._intrinsics
        if depth.shape != (k.height, k.width) or color.shape != (k.height, k.width, 3):
            raise FungraspError(
                f"ObjectTracker: color and depth must be images of {k.width} x {k.height}, not of shape "
                f"{list(color.shape)} and {list(depth.shape)}"
            )
        starts = self._starts()
        view = self._view(starts[0], color, depth)
        if view is None:
            self._motion = None
            return ObjectTrack(self.pose, 0.0)
        evidence, pixels, cells = view
        poses, cost = fit_poses(self._known.surface, evidence, starts, ROUNDS[0])
        poses, _ = fit_poses(self._known.surface, evidence, poses[np.argsort(cost)[:2]], ROUNDS[1])
        scores, shown = self._scores(poses, depth, pixels, cells)
        best = int(scores.argmax())
        score = float(scores[best])
        if score >= FOLLOWED:
            self._motion = compose(poses[best], invert(self.pose))
            self._learn(cells, shown[best])
            self.pose = poses[best]
        else:
            self._motion = None
        return ObjectTrack(poses[best] if score >= FOLLOWED else self.pose, score)

    def _starts(self) -> np.ndarray:
        """Return the starts of the fit, the most probable first, shape [S, 7]."""
        ahead = self.pose if self._motion is None else compose(self._motion, self.pose)
        moves = self._rng.normal(size=(STARTS - 2, 6))
        turned = quaternion_multiply(
            quaternion_from_rotation_vector(np.radians(SPREAD[1]) * moves[:, 3:]), ahead[3:]
        )
        around = np.concatenate([ahead[:3] + SPREAD[0] * moves[:, :3], turned], axis=1)
        return np.concatenate([ahead[None], self.pose[None], around])

    def _view(
        self, pose: np.ndarray, color: np.ndarray, depth: np.ndarray
    ) -> tuple[ObjectEvidence, np.ndarray, np.ndarray] | None:
        """Return the evidence near a pose: evidence for the fit; pixels ``[u v]`` of the rays, shape [R, 2];
        their color cells, shape [R]. None if too little is measured."""
        k = self._intrinsics
        corners = transform_points(pose, self._known.surface.samples[:200])
        if corners[:, 2].min() < 0.05:
            return None
        outline = k.project(corners)
        pad = MARGIN * k.fx / float(np.median(corners[:, 2]))
        low = np.clip(np.floor(outline.min(axis=0) - pad), 0, [k.width - 1, k.height - 1]).astype(int)
        high = np.clip(np.ceil(outline.max(axis=0) + pad), low + 1, [k.width, k.height]).astype(int)
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        seen_depth, cells = depth[window], color_cells(color[window])
        share = float(np.prod(outline.max(axis=0) - outline.min(axis=0)) / np.prod(high - low))
        step = max(1, round(float(np.sqrt(share * seen_depth.size / RAYS))))
        v, u = np.mgrid[low[1] : high[1] : step, low[0] : high[0] : step].reshape(2, -1)
        pixels = np.stack([u, v], axis=1)
        rays = k.deproject(pixels, np.ones(len(pixels)))
        predicted = self._known.rays.cast(pose[None], rays)[0]
        # Predicted depth of each pixel: that of the nearest ray.
        grid = predicted.reshape(-(-(high[1] - low[1]) // step), -(-(high[0] - low[0]) // step))
        whole = grid.repeat(step, axis=0).repeat(step, axis=1)[: seen_depth.shape[0], : seen_depth.shape[1]]
        shown = (seen_depth > 0) & (np.abs(seen_depth - whole) < NEAR)
        background = None
        if self._colors is None:
            self._learn(
                cells[::step, ::step].ravel(), (np.abs(seen_depth - whole) < NEAR)[::step, ::step].ravel()
            )
        if self._colors is not None:
            odds = np.log(self._colors[0] / self._colors[1])[cells]
            shown &= odds > -1.0
            background = odds < -3.0
        rows, columns = np.nonzero(shown)
        if len(rows) < LEAST_POINTS:
            return None
        some = self._rng.permutation(len(rows))[:POINTS]
        rows, columns = rows[some], columns[some]
        points = k.deproject(np.stack([columns, rows], axis=1) + low, seen_depth[rows, columns])
        free = free_space(seen_depth, k, shown, background=background, corner=(int(low[0]), int(low[1])))
        return ObjectEvidence(points, free), pixels, cells[::step, ::step].ravel()

    def _scores(
        self, poses: np.ndarray, depth: np.ndarray, pixels: np.ndarray, cells: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the score of each pose, shape [H], and the rays that show the object, shape [H, R] bool."""
        rays = self._intrinsics.deproject(pixels, np.ones(len(pixels)))
        seen = self._known.rays.cast(poses, rays)
        measured = depth[pixels[:, 1], pixels[:, 0]].astype(float)
        noise = 3.0 * depth_noise(measured) + 0.004
        hit = np.isfinite(seen) & (measured > 0)
        error = np.where(hit, seen - measured, 0.0)
        agrees = hit & (np.abs(error) < noise)
        # Things in front hide the object: these pixels say little.
        hidden = hit & (error > noise)
        if self._colors is not None:
            agrees &= (self._colors[0] > 0.2 * self._colors[1])[cells]
        counted = np.maximum(hit.sum(axis=1) - 0.8 * hidden.sum(axis=1), 1.0)
        return agrees.sum(axis=1) / counted, agrees

    def _learn(self, cells: np.ndarray, shown: np.ndarray) -> None:
        """Update the colors of the object and of its surroundings."""
        if shown.sum() < LEAST_POINTS or (~shown).sum() < LEAST_POINTS:
            return
        new = table_of_colors(cells[shown]), table_of_colors(cells[~shown])
        if self._colors is None:
            self._colors = new
        else:
            old = self._colors
            self._colors = (
                (1 - LEARNING) * old[0] + LEARNING * new[0],
                (1 - LEARNING) * old[1] + LEARNING * new[1],
            )
