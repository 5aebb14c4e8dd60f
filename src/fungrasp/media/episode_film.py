"""Videos of recorded episodes, with highlighted contact links and a closer camera after the first touch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.hands import Hand
from fungrasp.media.camera import Camera
from fungrasp.media.grasp_scenes import (
    frame_geoms,
    look_at_grasp,
    robot_grasp_scene,
    robot_scene_colors,
    robot_scene_states,
    view_angles,
)
from fungrasp.media.pictures import captioned
from fungrasp.media.render import Renderer
from fungrasp.objects import ObjectModel

CAPTION_MARGIN = 1.18
"""Ratio of a frame's size to its contents, with room for the caption bar."""

VERDICT_TIME = 1.0
"""Duration of the last frame, which shows the outcome [s]."""

FARTHEST = 0.4
"""Largest displacement at which the object is kept in the frame [m]."""

STILL = 1e-3
"""Smallest motion that renders a new frame [m]."""

FRAME = 3
"""Width of the border of an inset [pixels]."""

STEADY = 0.1
"""Half of the time window over which contacts are averaged to avoid flicker [s]."""


@dataclass(frozen=True)
class FilmSettings:
    """Settings of a video."""

    fps: float = 15.0
    """Frames per second."""
    speed: float = 1.5
    """Speed of playback relative to the episode."""
    width: int = 432
    """Width [pixels]."""
    height: int = 324
    """Height [pixels]."""


def episode_film(
    trajectory: Trajectory,
    hand: Hand,
    obj: ObjectModel,
    settings: FilmSettings | None = None,
    *,
    title: str = "",
    inset: np.ndarray | None = None,
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """Yield the frames of a recorded episode with the object's visual mesh and highlighted links in contact.

    From the first touch on, the camera is closer. Frames without motion are rendered once. If the simulation
    diverged, the video ends there.

    Args:
        trajectory: episode of ``hand`` and ``obj``.
        settings: defaults if None.
        inset: picture in the upper left corner, for example of the human grasp: sRGB, shape [h, w, 3] uint8.
        threads: 0 for all CPUs; the result does not depend on it.

    Yields:
        sRGB, shape [height, width, 3] uint8.
    """
    trajectory, settings = _finite_part(trajectory), settings or FilmSettings()
    wrist, joints, object_poses = trajectory.palm_pose, trajectory.joint_positions, trajectory.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], obj, object_poses[0])
    recorded = robot_scene_states(model, hand, wrist, joints, object_poses)
    times = trajectory.times.astype(float)
    at = frame_times(times, settings.fps, settings.speed)
    states = interpolate(model, recorded, times, at)
    holding = trajectory.link_contacts[trajectory.phase == trajectory.phase.max()].mean(axis=0) > 0.5
    judged, _ = robot_grasp_scene(hand, wrist[0], joints[0], obj, object_poses[0], holding)
    cameras = _cameras(judged, recorded, trajectory, at, settings)
    colors = robot_scene_colors(model, hand, _steady(trajectory.link_contacts, times, at))
    drawn = _moving(model, states)
    drawn[1:] |= [a != b for a, b in pairwise(cameras)]
    drawn[1:] |= np.any(colors[1:] != colors[:-1], axis=(1, 2))
    which = np.flatnonzero(drawn)
    pictures = Renderer(model, threads=threads).stream(
        states[which], [cameras[i] for i in which], geom_rgba=colors[which]
    )
    picture, clock = np.empty(0), ""
    for fresh, time in zip(drawn, at, strict=True):
        picture = next(pictures) if fresh else picture
        phase = [name for start, name in episode_phases(trajectory) if start <= time][-1]
        clock = f"{time - at[0]:.1f} s"
        yield captioned(_with_inset(picture, inset), " · ".join(filter(None, (title, phase))), clock)
    done = "used" if trajectory.is_use_test else "lifted and held"
    verdict = done if trajectory.success else f"failed: {trajectory.reason}"
    for _ in range(round(VERDICT_TIME * settings.fps)):
        yield captioned(_with_inset(picture, inset), " · ".join(filter(None, (title, verdict))), clock)


def _with_inset(picture: np.ndarray, inset: np.ndarray | None) -> np.ndarray:
    """Add a bordered picture in the upper left corner."""
    if inset is None:
        return picture
    height, width = (n + 2 * FRAME for n in inset.shape[:2])
    whole = picture.copy()
    whole[:height, :width] = 255
    whole[FRAME : height - FRAME, FRAME : width - FRAME] = inset
    return whole


def film_frames(trajectory: Trajectory, settings: FilmSettings) -> int:
    """Return the number of frames of ``episode_film``."""
    times = _finite_part(trajectory).times.astype(float)
    return len(frame_times(times, settings.fps, settings.speed)) + round(VERDICT_TIME * settings.fps)


def episode_phases(trajectory: Trajectory) -> list[tuple[float, str]]:
    """Return start [s] and name of each phase: the recorded ones, and "close" from the first touch to the
    lift."""
    touch = _first_touch(trajectory)
    if trajectory.phase[touch] > 0 or not trajectory.link_contacts[touch].any():
        return trajectory.phases
    return sorted([*trajectory.phases, (float(trajectory.times[touch]), "close")])


def _cameras(
    model: mujoco.MjModel, states: np.ndarray, trajectory: Trajectory, at: np.ndarray, settings: FilmSettings
) -> list[Camera]:
    """Return the camera of each frame: one that frames the whole motion, then one that frames the motion from
    the first touch on. States with an object that moved away are ignored. model: links that touch during the
    hold are colored, so that the view shows them."""
    touch = _first_touch(trajectory)
    travel = np.linalg.norm(trajectory.object_pose[:, :3] - trajectory.object_pose[0, :3], axis=1)
    close = travel < FARTHEST
    close[touch] = True
    size = {"width": settings.width, "height": settings.height, "margin": CAPTION_MARGIN}
    near = look_at_grasp(model, states[touch:][close[touch:]], **size)
    wide = frame_geoms(model, states[close], *view_angles(near), **size)
    return [wide if time < trajectory.times[touch] else near for time in at]


def _steady(contacts: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the links that touch most of the time around each frame, shape [F, L]. contacts: shape [T, L]
    bool."""
    first, last = (np.searchsorted(times, at + side * STEADY) for side in (-1, 1))
    spans = zip(first.tolist(), last.tolist(), strict=True)
    return np.array([contacts[a : max(b, a + 1)].mean(axis=0) > 0.5 for a, b in spans])


def _moving(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """Return whether a geom has moved by ``STILL`` since the last state that was marked, shape [F] bool."""
    data = mujoco.MjData(model)
    moving, before = np.zeros(len(states), dtype=bool), np.full((model.ngeom, 12), np.inf)
    for i, state in enumerate(states):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        now = np.concatenate([data.geom_xpos, model.geom_rbound[:, None] * data.geom_xmat], axis=1)
        moving[i] = np.abs(now - before).max() > STILL
        before = now if moving[i] else before
    return moving


def _first_touch(trajectory: Trajectory) -> int:
    """Return the index of the first state with contact, or of the last state before the lift."""
    touching = np.flatnonzero(trajectory.link_contacts.any(axis=1))
    return int(touching[0]) if len(touching) else int(np.flatnonzero(trajectory.phase == 0)[-1])


def _finite_part(trajectory: Trajectory) -> Trajectory:
    finite = np.isfinite(np.concatenate([trajectory.palm_pose, trajectory.object_pose], axis=1)).all(axis=1)
    finite &= np.isfinite(trajectory.joint_positions).all(axis=1)
    count = int(np.argmin(np.append(finite, False)))
    names = ("times", "qpos", "object_pose", "palm_pose", "joint_positions", "link_contacts", "phase")
    return replace(trajectory, **{name: getattr(trajectory, name)[:count] for name in names})


def frame_times(times: np.ndarray, fps: float, speed: float = 1.0) -> np.ndarray:
    """Return the times of a video's frames, from the first to the last state [s]."""
    if not fps > 0 or not speed > 0:
        raise FungraspError(f"frames per second and speed must be positive, not {fps} and {speed}")
    count = int(np.floor((times[-1] - times[0]) * fps / speed + 1e-6)) + 1
    return times[0] + np.arange(count) * speed / fps


def interpolate(model: mujoco.MjModel, qpos: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate recorded states along the shortest motion of each joint.

    Args:
        qpos: shape [T, nq].
        times: increasing [s], shape [T].
        at: [s], shape [F].

    Returns:
        shape [F, nq].
    """
    result = np.empty((len(at), model.nq))
    velocity = np.zeros(model.nv)
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(len(times) - 2, 0))
    for i, (k, t) in enumerate(zip(before, at, strict=True)):
        result[i] = qpos[k]
        if k + 1 < len(times):
            step = times[k + 1] - times[k]
            mujoco.mj_differentiatePos(model, velocity, step, qpos[k], qpos[k + 1])
            mujoco.mj_integratePos(model, result[i], velocity, min(t - times[k], step))
    return result
