"""Cameras that show a grasp well."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.media.camera import Camera, fit_camera
from fungrasp.media.grasp_scenes import CONTACT, OBJECT_BODY
from fungrasp.media.render import Renderer, Views
from fungrasp.media.surfaces import VISIBLE_GROUPS, model_materials

_LARGEST = 0.6
_BEST_ELEVATION = 26.0
_STATES = 24


def look_at_grasp(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    width: int = 640,
    height: int = 480,
    margin: float = 1.12,
    elevations: Sequence[float] = (14.0, 30.0, 48.0),
    azimuths: int = 12,
) -> Camera:
    """A camera above the table that frames hand and object, and from which most of the contact can be seen.

    Of all views tried, it has the largest weighted sum of shares: of the colored links, of the object, and
    of each geom of the hand, each compared with the view that shows most of it.

    Args:
        model: made by ``human_grasp_scene`` or ``robot_grasp_scene``, or any with a body named
            ``OBJECT_BODY``.
        qpos: shape [nq], or [T, nq] for a motion: it is all framed, and judged by its last state; None for
            the model's reference.
        margin: how much larger than its contents the picture is; a bar of words needs about 1.3.
        elevations: of the views that are tried [degrees].
        azimuths: number of directions that are tried.
    """
    states = np.atleast_2d(model.qpos0 if qpos is None else np.asarray(qpos, dtype=float))
    small = (48 * width // max(width, height) + 1, 48 * height // max(width, height) + 1)
    views = [(e, a) for e in elevations for a in np.arange(azimuths) * 360.0 / azimuths]
    cameras = [frame_geoms(model, states, a, e, width=small[0], height=small[1]) for e, a in views]
    renderer = Renderer(model, antialias=1, shadows=False)
    seen = renderer.views(states[-1:].repeat(len(views), 0), cameras)
    of_object = [g for g in range(model.ngeom) if model.body(int(model.geom_bodyid[g])).name == OBJECT_BODY]
    of_hand = np.setdiff1d(np.unique(seen.segmentation[seen.segmentation >= 0]), of_object)
    score = 0.4 * _shares(np.isin(seen.segmentation, of_object))
    score += 0.5 * np.mean([_shares(seen.segmentation == g) for g in of_hand] or [0.0 * score], axis=0)
    score += 0.8 * _shares(_touching(model, seen) & ~np.isin(seen.segmentation, of_object))
    score -= 0.004 * np.abs(np.array([e for e, _ in views]) - _BEST_ELEVATION)
    elevation, azimuth = views[int(np.argmax(score))]
    return frame_geoms(model, states, azimuth, elevation, width=width, height=height, margin=margin)


def frame_geoms(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    azimuth: float,
    elevation: float,
    *,
    width: int = 640,
    height: int = 480,
    fov_y: float = 30.0,
    margin: float = 1.12,
) -> Camera:
    """A camera that frames all drawn geoms but planes and huge ones, tightly.

    Args:
        qpos: shape [nq], or [T, nq] for a motion of which all is framed.
        azimuth: of the camera, from the world's x towards y [degrees].
        elevation: above the horizontal [degrees].
        fov_y: vertical field of view [degrees].
        margin: how much larger than its contents the picture is.

    Raises:
        FungraspError: there is no such geom.
    """
    chosen = (
        np.isin(model.geom_group, VISIBLE_GROUPS) & (model.geom_rbound > 0) & (model.geom_rbound < _LARGEST)
    )
    chosen &= model_materials(model).colors[:, 3] > 0
    if not chosen.any():
        raise FungraspError("there is nothing to look at: the model has no visible geom of a size to frame")
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(8, 3)
    boxes = model.geom_aabb[chosen]
    local = boxes[:, None, :3] + corners * boxes[:, None, 3:]
    states = np.atleast_2d(np.asarray(qpos, dtype=float))
    step = max(1, len(states) // _STATES)
    points = []
    data = mujoco.MjData(model)
    for i in [*range(0, len(states), step), len(states) - 1]:
        data.qpos[:] = states[i]
        mujoco.mj_kinematics(model, data)
        rotation = data.geom_xmat[chosen].reshape(-1, 3, 3)
        points.append(data.geom_xpos[chosen][:, None] + np.einsum("gij,gpj->gpi", rotation, local))
    everything = np.concatenate(points).reshape(-1, 3)
    none = np.zeros(len(everything))
    return fit_camera(
        everything, none, azimuth, elevation, fov_y=fov_y, width=width, height=height, margin=margin
    )


def view_angles(camera: Camera) -> tuple[float, float]:
    """Azimuth and elevation of a camera, seen from its target [degrees]."""
    x, y, z = np.subtract(camera.position, camera.target)
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _shares(mask: np.ndarray) -> np.ndarray:
    """How much of a thing each view shows, compared with the best one; mask: shape [views, H, W] bool."""
    pixels = mask.sum((1, 2))
    return np.sqrt(pixels / max(pixels.max(), 1))


def _touching(model: mujoco.MjModel, seen: Views) -> np.ndarray:
    whole = np.flatnonzero(np.all(np.abs(model.geom_rgba[:, :3] - np.asarray(CONTACT)) < 1e-3, axis=1))
    textured = np.flatnonzero(model.geom_matid >= 0)
    assert seen.color is not None
    orange = seen.color[..., 2] < 0.5 * seen.color[..., 0]
    return np.isin(seen.segmentation, whole) | (np.isin(seen.segmentation, textured) & orange)
