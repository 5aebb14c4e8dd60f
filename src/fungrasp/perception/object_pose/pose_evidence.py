"""Evidence for a pose of the mesh, and its ambiguity: other sizes of the mesh, other poses.

If another size of the mesh fits as well, it may be the wrong mesh. Depth says little about the size of a
thing with smoothed or hidden outlines, but colors still change there. As in region-based tracking, they are
searched for changes along lines across the silhouette (Tjaden et al., IJCV 2019; Stoiber et al., CVPR 2022).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.estimates import ObjectEstimate, PerceptionWarning, PoseEvidence
from fungrasp.perception.object_pose.object_template import ObjectTemplate, object_template
from fungrasp.perception.object_pose.object_view import ObjectView
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.scene.table import plane_tolerance

SIZE_RAYS = 170  # About how many rays meet a mask when other sizes of the mesh are compared.
# Other sizes of the whole mesh, and of each side alone.
WHOLE, SIDES = (0.67, 0.82, 1.22, 1.5), (0.75, 1.33)
OWN = 8  # Number of sets of random moves for the mesh's own size; other sizes have one.
# Moves of each size in successive rounds: number, standard deviations of shift [m] and rotation [degrees].
SETTLED = ((8, 0.004, 4.0), (5, 0.002, 2.0), (5, 0.001, 1.0))
# Distance (ADD-S [m]) and rotation [degrees] beyond which a pose is a different answer.
RIVAL_DISTANCE, TURNED = 0.01, 30.0
CLOSE = 0.1  # Difference in score within which a pose fits almost as well.
SAME = 0.001  # Mean distance of surfaces within which poses look the same, by symmetry [m].


def pose_evidence(
    view: ObjectView, scorer: PoseScorer, pose: np.ndarray, owner: int, rival: float, rng: np.random.Generator
) -> PoseEvidence:
    """Return the evidence for one pose.

    Args:
        pose: object in the camera frame, shape [7].
        owner: index of the mask that it was fitted to.
        rival: quality of the best different pose.
    """
    scores = scorer(pose[None], np.array([owner]))
    points = view.evidence[owner].points
    size, side = scale_ambiguity(view.scorer(SIZE_RAYS), pose, owner, np.median(points, axis=0), rng)
    capture = view.capture
    edges = silhouette_edges(view, pose, owner)
    hinted = 1.0 if capture.mask is not None else 0.5 if capture.box or capture.point else 0.0
    return PoseEvidence(
        hinted=hinted,
        explained=float(scores.explained[0]),
        visible=float(scores.visible[0]),
        hidden=float(scores.hidden[0]),
        pixels=float(scores.pixels[0]),
        rival=rival / max(float(scores.quality[0]), 1e-6),
        other_size=size,
        other_side=side,
        colored=float(view.known.colors is not None),
        edge_width=view.seen.edge_width,
        foreign=view.foreign,
        **edges,
    )


def scale_ambiguity(
    scorer: PoseScorer, pose: np.ndarray, owner: int, anchor: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return how well other sizes of the mesh explain the image.

    All sizes are moved in the same ways about the same pose; the mesh's own size in more ways, so that none
    of the many others gains by chance. The whole mesh is scaled about its visible part, a side also about
    either end: a mesh that is too short usually lies at one end of the thing.

    Args:
        pose: object in the camera frame, shape [7].
        owner: index of the mask that it was fitted to.
        anchor: center of the visible part [m], camera frame, shape [3].

    Returns:
        Logarithms of quality relative to the mesh's own size, of the best other size and of the best other
        length of a side; negative if worse. Near 0, the image does not determine the size.
    """
    samples = scorer.known.surface.samples
    low, high = samples.min(axis=0), samples.max(axis=0)
    seen = np.clip(inverse_transform_points(pose, anchor[None])[0], low, high)
    sizes = [(np.ones(3), seen)] * OWN + [(np.full(3, size), seen) for size in WHOLE]
    for axis in range(3):
        mine = np.arange(3) == axis
        for still in (low, seen, high):
            for size in SIDES:
                sizes.append((np.where(mine, size, 1.0), np.where(mine, still, seen)))
    stretch, still = (np.array(part) for part in zip(*sizes, strict=True))
    places, turns = transform_points(pose, still), np.repeat(pose[None, 3:], len(stretch), axis=0)
    quality, rows = np.zeros(len(stretch)), np.arange(len(stretch))
    for count, shift, turn in SETTLED:
        moves = rng.normal(size=(OWN, count, 6))
        moves[:, 0] = 0.0
        moves = np.concatenate([moves, np.broadcast_to(moves[0], (len(stretch) - OWN, count, 6))])
        near = places[:, None] + shift * moves[..., :3]
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[..., 3:])
        turned = quaternion_multiply(steps, turns[:, None])
        turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        factors, middle = np.repeat(stretch, count, axis=0), np.repeat(still, count, axis=0)
        around = turned.reshape(-1, 4)
        poses = np.concatenate([near.reshape(-1, 3) - rotate(around, factors * middle), around], axis=1)
        tried = scorer(poses, np.full(len(poses), owner), factors).quality.reshape(near.shape[:2])
        best = tried.argmax(axis=1)
        places, turns, quality = near[rows, best], turned[rows, best], tried[rows, best]
    worth = np.log(np.maximum(quality, 1e-4) / max(quality[:OWN].max(), 1e-4))
    first = OWN + len(WHOLE)
    return float(worth[OWN:first].max()), float(worth[first:].max())


def best_rival(known: ObjectTemplate, poses: np.ndarray, quality: np.ndarray) -> float:
    """Return the quality of the best pose that differs from the first, 0 if there is none.

    poses: shape [H, 7]; quality: shape [H].
    """
    different = add_s(known.surface.samples[:300], poses, poses[0]) > RIVAL_DISTANCE
    return float(quality[different].max(initial=0.0))


def ambiguity(model: ObjectModel, obj: ObjectEstimate) -> PerceptionWarning | None:
    """Return a warning if a different pose fits almost as well as the answer.

    The score is about the position of the surface: it may be high although the orientation of a nearly
    symmetric object is uncertain.
    """
    near = [pose for pose, score in obj.alternatives if score > obj.score - CLOSE]
    if not near:
        return None
    surface = object_template(model).surface
    points, answer = surface.samples[:300], obj.pose_camera_object
    apart = np.array([surface.distances(transform_points(pose, points), answer).mean() for pose in near])
    turned = np.degrees(rotation_error(np.stack(near), obj.pose_camera_object))
    others = np.flatnonzero(((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE))
    if not len(others):
        return None
    # Alternatives are sorted by score.
    distance_mm, turn_deg = 1000 * float(apart[others[0]]), float(turned[others[0]])
    if distance_mm > 1000 * RIVAL_DISTANCE:
        how = f"turned by {turn_deg:.0f} degrees" if turn_deg > TURNED else "elsewhere"
        return PerceptionWarning.of("object_elsewhere", how=how, distance_mm=distance_mm)
    return PerceptionWarning.of("object_orientation", turn_deg=turn_deg, distance_mm=distance_mm)


SILHOUETTE_RAYS = 40_000  # About the largest number of rays that draw the silhouette.
# Length of lines across the rim to each side [pixels]; the other side of a small thing is farther.
REACH = 14
# Standard deviation of the expected distance of the color change from the rim [pixels]: of two equal changes,
# the nearer one counts.
NEAR = 6.0
APART = 2  # Distance to each side at which colors are compared [pixels]: outlines are one or two pixels wide.
LINES = 400  # About the largest number of lines.
FEWEST = 15  # Smallest number of lines.
# A line is dropped if, within the first number of pixels from the rim, more than the second fraction of it is
# hidden or outside the image.
CLEAR, BLOCKED = 8, 0.15
# Distance in front of the mesh [m], besides three standard deviations, from which depth shows other things.
IN_FRONT = 0.004
FAINT = 3.0  # Smallest color change of a line [of 255], above the noise of cameras.
STILL = 5.0  # Weight of the prior that the outline does not move, in lines.
EIGHTHS = 8  # Parts of the outline, by direction: a mesh that is too short is wrong at one end only.
FEW = 6  # Smallest number of lines in such a part.
# Percentile of the distances of the object's pixels from the silhouette, as single pixels are wrong.
LEFT_OVER = 99.5
# Distance from the silhouette within which pixels of a mask are its rim, and to which a piece must reach not
# to be part of the rim [pixels].
RIM = 2.5, 5.0
# Distance from the silhouette, or behind the object, beyond which a thing is another one, as a fraction of
# the mesh's size.
ANOTHER = 0.5


def silhouette_edges(view: ObjectView, pose: np.ndarray, owner: int) -> dict[str, float]:
    """Compare the silhouette of a pose with the image.

    Args:
        pose: object in the camera frame, shape [7].
        owner: index of the mask that it was fitted to.

    Returns:
        ``larger``, ``off``, ``left_over`` and ``mask_piece`` of ``PoseEvidence``.
    """
    capture, lens = view.capture, view.capture.intrinsics
    own, mask = view.masks[owner] & capture.measured, capture.mask
    shows = own & (view.support > 0.5) if mask is None else mask
    rows, columns = np.nonzero(own | shows if view.given is None else own | shows | view.given)
    drawn = lens.project(transform_points(pose, view.known.surface.samples))
    low = np.floor(np.minimum(drawn.min(axis=0), [columns.min(), rows.min()])).astype(int) - REACH - 4
    high = np.ceil(np.maximum(drawn.max(axis=0), [columns.max(), rows.max()])).astype(int) + REACH + 5
    low, high = np.maximum(low, 0), np.minimum(high, [lens.width, lens.height])
    step = max(1, int(np.sqrt(np.prod(high - low) / SILHOUETTE_RAYS)))
    part = (slice(low[1], high[1], step), slice(low[0], high[0], step))
    v, u = np.mgrid[part]
    rays = lens.deproject(np.stack([u.ravel(), v.ravel()], axis=-1), np.ones(u.size))
    seen = view.known.rays.cast(pose[None], rays)[0].reshape(u.shape)
    inside = np.isfinite(seen)
    if not inside.any():
        return {"larger": np.nan, "off": np.nan, "left_over": 1.0, "mask_piece": 0.0}
    from_rim: Any = ndimage.distance_transform_edt(~inside)
    away = step * from_rim
    meters = float(np.median(capture.depth[own])) / lens.fx
    beyond = np.maximum(away[shows[part]] - 1.0, 0.0)
    far = float(np.percentile(beyond, LEFT_OVER)) if len(beyond) else 0.0
    depth, spread = capture.depth[part], view.seen.spread[part]
    in_front = (depth > 0) & inside & (depth < seen - 3 * spread - IN_FRONT)
    hidden = in_front | (view.seen.classes.skin[part] > 0.5)
    larger, off = edge_offset(capture.color[part], inside, hidden)
    piece = 0.0
    if view.given is not None:
        pieces = view.given[part] & (away > RIM[0]) & (meters * away < ANOTHER * view.known.size)
        nearer = float(np.percentile(capture.depth[own], 98)) + ANOTHER * view.known.size
        pieces &= (depth > 0) & (depth < nearer)
        if view.table is not None:
            height = rays.reshape(*depth.shape, 3) @ view.table[:3] * depth + view.table[3]
            pieces &= height > plane_tolerance(depth)
        piece = step**2 * _largest_piece(pieces, away)
    scale = step * 640 / lens.width
    far = meters * far / view.known.size
    return {"larger": scale * larger, "off": scale * off, "left_over": far, "mask_piece": piece}


def _largest_piece(shown: np.ndarray, away: np.ndarray) -> float:
    """Return the number of pixels in the largest piece of an image, shape [H, W] bool, that is not a rim."""
    if not shown.any():
        return 0.0
    # Pieces one pixel wide are noise.
    opened: Any = ndimage.binary_opening(shown, np.ones((2, 2)))
    labeled: Any = ndimage.label(opened)
    labels, count = labeled
    sizes, farthest = np.bincount(labels[opened], minlength=count + 1), np.zeros(count + 1)
    np.maximum.at(farthest, labels[opened], away[opened])
    return float(sizes[farthest > RIM[1]].max(initial=0))


def edge_offset(color: np.ndarray, inside: np.ndarray, hidden: np.ndarray) -> tuple[float, float]:
    """Compare the outline in an image with that of a silhouette.

    On each line across the rim, the strongest color change is located. A shift, a stretch and a dilation are
    fitted to these places, weighted by the strength of the change.

    Args:
        color: RGB, 0 to 255, shape [H, W, 3].
        inside: silhouette, shape [H, W] bool.
        hidden: pixels where something is in front of the object, shape [H, W] bool.

    Returns:
        ``larger`` and ``off`` of ``PoseEvidence`` [pixels]; NaN if too little of the outline is visible.
    """
    depth_in: Any = ndimage.distance_transform_edt(inside)
    depth_out: Any = ndimage.distance_transform_edt(~inside)
    # Distance from the rim between the pixels, positive inside.
    field = np.where(inside, depth_in - 0.5, 0.5 - depth_out)
    slope = np.array(np.gradient(ndimage.gaussian_filter(field, 1.5)))
    rim = inside & (field < 1.0)
    rim[[0, 1, -2, -1]] = rim[:, [0, 1, -2, -1]] = False
    at = np.stack(np.nonzero(rim))
    at = at[:, :: max(1, round(at.shape[1] / LINES))]
    inward = slope[:, *at] / (np.linalg.norm(slope[:, *at], axis=0) + 1e-6)
    along = np.arange(-REACH, REACH + 1)
    places = at[:, :, None] + inward[:, :, None] * (along - field[*at][:, None])
    last = np.array(inside.shape)[:, None, None] - 1
    blocked = ((places < 0) | (places > last)).any(axis=0)
    blocked |= hidden[tuple(np.clip(np.rint(places).astype(int), 0, last))]
    used = blocked[:, np.abs(along) <= CLEAR].mean(axis=1) < BLOCKED
    if used.sum() < FEWEST:
        return np.nan, np.nan
    at, inward, places, blocked = at[:, used], inward[:, used], places[:, used], blocked[used]
    red, green, blue = np.moveaxis(color.astype(np.float32), -1, 0)
    # Brightness and opponent colors: shadows change only the first.
    channels = (red + green + blue) / 3.0, red - green, 0.5 * (red + green) - blue
    lines = np.stack(
        [
            ndimage.map_coordinates(ndimage.gaussian_filter(one, 1.0), places, order=1, mode="nearest")
            for one in channels
        ]
    )
    change = np.linalg.norm(lines[..., 2 * APART :] - lines[..., : -2 * APART], axis=0)
    change, offset = np.where(blocked[:, APART:-APART], 0.0, change), along[APART:-APART]
    strength = change.max(axis=1)
    telling = strength > FAINT
    if telling.sum() < FEWEST:
        return np.nan, np.nan
    at, inward, change, strength = at[:, telling], inward[:, telling], change[telling], strength[telling]
    found = _peaks(change * np.exp(-0.5 * np.square(offset / NEAR)), offset)
    weight = strength / strength.mean()
    middle, radius = np.stack(np.nonzero(inside)).mean(axis=1), np.sqrt(inside.sum() / np.pi)
    (y, x), (out_y, out_x) = (at - middle[:, None]) / radius, -inward
    moves = np.stack([out_y, out_x, out_y * y + out_x * x, out_y * y - out_x * x, out_y * x + out_x * y], 1)
    weighted = moves * weight[:, None]
    # Lines give the distance of the change inward.
    larger = float(np.linalg.solve(weighted.T @ moves + STILL * np.eye(5), weighted.T @ -found)[2])
    eighth = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * EIGHTHS).astype(int) % EIGHTHS
    count = np.bincount(eighth, minlength=EIGHTHS)
    means = np.bincount(eighth, np.abs(found), EIGHTHS)[count >= FEW] / count[count >= FEW]
    return larger, float(means.max()) if len(means) else np.nan


def _peaks(height: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return the position of the maximum of each row of heights, [N, M], by a parabola, [N]. offset: [M]."""
    row, best = np.arange(len(height)), np.clip(height.argmax(axis=1), 1, len(offset) - 2)
    before, top, after = (height[row, best + i] for i in (-1, 0, 1))
    bend = np.maximum(2.0 * top - before - after, 1e-6)
    return offset[best] + np.clip(0.5 * (after - before) / bend, -0.5, 0.5)
