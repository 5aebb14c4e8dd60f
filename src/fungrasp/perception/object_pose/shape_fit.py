"""A box, a cylinder or a sphere fitted to what is seen in a hand: for objects of which there is no mesh.

What no image shows is a guess: the far side is where the fingertips are that hold it, or as deep as it is
wide.
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

REACH = 0.13  # Parts of an object of unknown size are looked for so far from the fingertips [m].
UNIT = 0.1  # Sides of the shapes that are stretched [m].
# Which number of a shape's size each axis takes.
SHAPES = {"box": (0, 1, 2), "cylinder": (0, 0, 1), "sphere": (0, 0, 0)}
# Quality that a shape of fewer numbers may lack: a box with its many numbers fits all a little better.
SIMPLER = {"box": 0.0, "cylinder": 0.02, "sphere": 0.04}
LIMITS = (0.012, 0.4)  # Smallest and largest side of a shape [m].
RAYS = 400  # About how many rays a fit is scored by.
# Standard deviations of the random moves: shift [m], turn [degrees], logarithm of a side.
ROUNDS = ((0.010, 12.0, 0.35), (0.006, 8.0, 0.20), (0.004, 5.0, 0.12), (0.002, 3.0, 0.06), (0.001, 1.5, 0.03))
# Fingertips so far from the surface [m] halve what a shape is worth: without a mesh nothing else tells what
# is held from what lies beside the hand.
TOUCHING = 0.015

TOO_LITTLE = "too little of an object is seen in the hand: click at it (--point), or give a mesh"

KEPT, TRIES = 4, 24  # So many of the best go on, and so many moves of each are tried in each round.
FITS = 0.5  # A fit of lower quality explains too little of what is seen to be of use.


@dataclass(frozen=True, eq=False)
class FittedShape:
    """A shape in the place of an object without a mesh."""

    name: str
    """Of the shape, see ``plain_shape``: "box:60x28x30"."""
    pose: np.ndarray
    """In the camera frame, shape [7]."""
    quality: float
    """How well it explains the image, 0 to 1: see ``PoseScores``."""

    @property
    def fits(self) -> bool:
        """Whether it explains enough of what is seen."""
        return self.quality >= FITS


def fit_shape(
    capture: Capture, joints: np.ndarray | None, table: np.ndarray | None, *, seed: int = 0
) -> FittedShape:
    """The shape that explains best what is seen in the hand.

    Args:
        capture: color and depth; its mask, box or point says where the object is.
        joints: of the hand [m], camera frame, shape [21, 3], if known.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], if there is one.

    Raises:
        FungraspError: too little of an object is seen.
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
    """Poses with axes along the points' principal ones and along the table's normal, each axis as the shape's
    third, shape [H, 7]; sides [m], shape [H, 3]."""
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
            # The far side is not seen: as deep as the shape is wide at least.
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
    """The highest worth that random moves reach, its pose [7] and sides [3]."""

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
        # Half of them grow away from the camera, whose side is seen, the others about their middle.
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
