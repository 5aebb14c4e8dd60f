"""Fit of a box, cylinder or sphere to a held object without a mesh.

The hidden side is a guess: it reaches to the fingertips, or as deep as the shape is wide.
Camera frame: OpenCV [m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.objects import plain_shape
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.object_view import LEAST_PIXELS, WIDEST, cleaned_mask
from fungrasp.perception.object_pose.scoring import PoseScorer, pose_scorer
from fungrasp.perception.scene.segmentation import segment

REACH = 0.13  # Largest distance of an unknown object's parts from the fingertips [m].
UNIT = 0.1  # Side of the unscaled shapes [m].
# Index of the size that each axis of a shape has.
SHAPES = {"box": (0, 1, 2), "cylinder": (0, 0, 1), "sphere": (0, 0, 0)}
# Bonus for shapes with fewer sizes: a box with its three fits everything slightly better.
SIMPLER = {"box": 0.0, "cylinder": 0.02, "sphere": 0.04}
LIMITS = (0.012, 0.4)  # Smallest and largest side of a shape [m].
RAYS = 400  # About how many rays meet a mask.
# Standard deviations of random moves in each round: shift [m], rotation [degrees], logarithm of a side.
ROUNDS = ((0.010, 12.0, 0.35), (0.006, 8.0, 0.20), (0.004, 5.0, 0.12), (0.002, 3.0, 0.06), (0.001, 1.5, 0.03))
# Distance of the fingertips from the surface at which the worth of a shape is halved [m]: without a mesh,
# only contact distinguishes the held object from things beside the hand.
TOUCHING = 0.015

TOO_LITTLE = "too little of an object is seen in the hand: click at it (--point), or give a mesh"

KEPT, TRIES = 4, 24  # Number of best shapes kept per round, and of random moves of each.
FITS = 0.5  # Smallest quality of a usable fit.


@dataclass(frozen=True, eq=False)
class FittedShape:
    """A shape fitted to an object without a mesh."""

    name: str
    """Name of the shape, "box:60x28x30", see ``plain_shape``."""
    pose: np.ndarray
    """Pose of the shape in the camera frame, shape [7]."""
    quality: float
    """How well the shape explains the image, 0 to 1, see ``PoseScores``."""

    @property
    def fits(self) -> bool:
        """Whether the quality is sufficient."""
        return self.quality >= FITS


def fit_shape(
    capture: Capture, joints: np.ndarray | None, table: np.ndarray | None, *, seed: int = 0
) -> FittedShape:
    """Fit the shape that best explains the object in the hand.

    Args:
        capture: image, maybe with a mask, box or point of the object.
        joints: joints of the hand [m], camera frame, shape [21, 3]; None if unknown.
        table: plane ``[nx ny nz d]``, camera frame, shape [4]; None if unknown.
        seed: random seed.

    Raises:
        FungraspError: too little of an object is visible.
    """
    capture, rng = capture.reduced(WIDEST), np.random.default_rng(seed)
    if capture.mask is not None and (capture.mask & capture.measured).any():
        capture = capture.with_object(mask=cleaned_mask(capture, 2 * REACH, rng)[0])
    view = segment(capture, joints, table, REACH)
    masks = [mask for mask in view.masks if (mask & capture.measured).sum() >= LEAST_PIXELS][:4]
    if not masks:
        raise FungraspError(TOO_LITTLE)
    found: list[tuple[float, FittedShape]] = []
    for kind, numbers in SHAPES.items():
        size = "x".join(["100"] * (max(numbers) + 1))
        known = object_template(plain_shape(f"{kind}:{size}", 1.0))
        scorer = pose_scorer(known, capture, view, masks, table, joints, RAYS)
        for owner, mask in enumerate(masks):
            rows, columns = np.nonzero(mask & capture.measured & (view.classes.obj > 0.5))
            if len(rows) < LEAST_PIXELS:
                continue
            depth = capture.depth[rows, columns]
            points = capture.intrinsics.deproject(np.stack([columns, rows], axis=-1), depth)
            poses, sides = _starts(points, numbers, table)
            worth, pose, side = _climbed(scorer, poses, sides, numbers, owner, rng)
            quality = float(scorer(pose[None], np.array([owner]), side[None] / UNIT).quality[0])
            name = f"{kind}:" + "x".join(
                f"{1000 * one:.0f}" for one in side[np.unique(numbers, return_index=True)[1]]
            )
            found.append((worth + SIMPLER[kind], FittedShape(name, pose, quality)))
    if not found:
        raise FungraspError(TOO_LITTLE)
    return max(found, key=lambda one: one[0])[1]


def _starts(
    points: np.ndarray, numbers: tuple[int, ...], table: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return starts: poses along the points' principal axes and the table's normal, with each axis as the
    shape's third, shape [H, 7]; sides [m], shape [H, 3]."""
    middle = np.median(points, axis=0)
    near = points[np.linalg.norm(points - middle, axis=1) < REACH]
    sight = middle / np.linalg.norm(middle)
    frames = [np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2]]
    for up in ([] if table is None else [table[:3]]) + [sight]:
        flat = near - near.mean(axis=0)
        flat = flat - np.outer(flat @ up, up)
        along = np.linalg.svd(flat, full_matrices=False)[2][0]
        frames.append(np.stack([along, np.cross(up, along), up]))
    poses, sides = [], []
    for frame in frames:
        for turn in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            axes = frame[list(turn)]
            axes = axes * np.sign(np.linalg.det(axes)) if np.linalg.det(axes) < 0 else axes
            local = near @ axes.T
            low, high = np.percentile(local, [3, 97], axis=0)
            side = np.clip(high - low, *LIMITS)
            # The hidden side: at least as deep as the smaller visible side.
            facing = np.abs(axes @ sight)
            deep = int(facing.argmax())
            side[deep] = max(side[deep], float(np.delete(side, deep).min()))
            center = 0.5 * (low + high)
            toward = np.sign(axes @ sight)
            front = np.where(toward > 0, low, high)
            center[deep] = front[deep] + 0.5 * toward[deep] * side[deep]
            side = np.array([side[np.array(numbers) == n].mean() for n in numbers])
            turned = Rotation.from_matrix(axes.T).as_quat(scalar_first=True)
            poses.append([*(center @ axes), *turned])
            sides.append(side)
    return np.array(poses), np.array(sides)


def _climbed(
    scorer: PoseScorer,
    poses: np.ndarray,
    sides: np.ndarray,
    numbers: tuple[int, ...],
    owner: int,
    rng: np.random.Generator,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the highest worth found by random moves, its pose, shape [7], and its sides [m], shape [3]."""

    def scored(poses: np.ndarray, sides: np.ndarray) -> np.ndarray:
        scores = scorer(poses, np.full(len(poses), owner), sides / UNIT)
        return scores.quality / (1.0 + np.square(scores.contact / TOUCHING))

    quality = scored(poses, sides)
    for shift, turn, grow in ROUNDS:
        rows = np.argsort(-quality)[:KEPT]
        poses, sides, quality = poses[rows], sides[rows], quality[rows]
        moves = rng.normal(size=(len(rows) * TRIES, 9))
        near = np.repeat(poses, TRIES, axis=0)
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[:, 3:6])
        turned = quaternion_multiply(steps, near[:, 3:])
        turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        growth = np.exp(grow * moves[:, 6:][:, list(numbers)])
        before = np.repeat(sides, TRIES, axis=0)
        wider = np.clip(before * growth, *LIMITS)
        # Half of them grow away from the camera, which sees the near side, the others about their center.
        towards = near[:, :3] / np.linalg.norm(near[:, :3], axis=1, keepdims=True)
        axes = Rotation.from_quat(turned, scalar_first=True).as_matrix()
        deeper = np.einsum("hik,hi->hk", axes, towards)
        back = np.einsum("hik,hk->hi", axes, 0.5 * (wider - before) * deeper)
        back[::2] = 0.0
        tried = np.concatenate([near[:, :3] + shift * moves[:, :3] + back, turned], axis=1)
        better = scored(tried, wider)
        poses, sides = np.concatenate([poses, tried]), np.concatenate([sides, wider])
        quality = np.concatenate([quality, better])
    best = int(quality.argmax())
    return float(quality[best]), poses[best], sides[best]
