"""A recorded trajectory as a film: even frame times, a camera that follows and circles, a line of words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.rendering.camera import Camera
from fungrasp.rendering.render import Renderer
from fungrasp.rendering.shading import Look
from fungrasp.report.pictures import captioned


def film(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    times: np.ndarray,
    fps: float,
    camera: Camera | Sequence[Camera],
    *,
    mocap: np.ndarray | None = None,
    geom_rgba: np.ndarray | None = None,
    follow: str | None = None,
    orbit: float = 0.0,
    speed: float = 1.0,
    phases: Sequence[tuple[float, str]] = (),
    title: str = "",
    look: Look | None = None,
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """Frames of a recorded trajectory, states between the recorded ones interpolated.

    Args:
        qpos: joint positions, shape [T, nq].
        times: of the states, increasing [s], shape [T].
        fps: frames per second.
        camera: as it stands at the start, or one for each frame (``frame_times`` says how many).
        mocap: poses of the mocap bodies, shape [T, nmocap, 7]; a frame takes the latest.
        geom_rgba: colors, shape [ngeom, 4] or [T, ngeom, 4]; a frame takes the latest.
        follow: body with which a single camera moves, smoothly, without turning.
        orbit: angle that a single camera circles its target from start to end, half of it to each side of
            where it was placed [degrees].
        speed: seconds of the trajectory in a second of the film.
        phases: start [s] and name of each phase of the motion; the bar of words shows the current one, and
            the time. Without phases and title there is no bar.
        title: words before the phase.

    Yields:
        sRGB, shape [H, W, 3] uint8.

    Raises:
        FungraspError: the arguments do not fit one another.
    """
    qpos, times = np.asarray(qpos, dtype=float), np.asarray(times, dtype=float)
    if times.ndim != 1 or len(times) == 0 or np.any(np.diff(times) <= 0) or not np.isfinite(times).all():
        raise FungraspError("the times of a trajectory must be finite and increase")
    if qpos.shape != (len(times), model.nq):
        raise FungraspError(f"qpos must have shape {(len(times), model.nq)}, not {qpos.shape}")
    at = frame_times(times, fps, speed)
    states = interpolate(model, qpos, times, at)
    latest = np.clip(np.searchsorted(times, at + 1e-9, side="right") - 1, 0, None)
    if isinstance(camera, Camera):
        shift = np.zeros((len(at), 3)) if follow is None else _shifts(model, states, follow, fps)
        turn = orbit * (np.arange(len(at)) / max(len(at) - 1, 1) - 0.5)
        cameras = [_moved(camera, s, a) for s, a in zip(shift, turn, strict=True)]
    else:
        cameras = list(camera)
    if geom_rgba is not None and np.ndim(geom_rgba) == 3:
        geom_rgba = np.asarray(geom_rgba)[latest]
    renderer = Renderer(model, look=look, threads=threads)
    frames = renderer.stream(
        states, cameras, mocap=None if mocap is None else mocap[latest], geom_rgba=geom_rgba
    )
    if not phases and not title:
        return frames
    return (
        captioned(f, _words(title, phases, t), f"{t - times[0]:.1f} s")
        for f, t in zip(frames, at, strict=True)
    )


def frame_times(times: np.ndarray, fps: float, speed: float = 1.0) -> np.ndarray:
    """Times of a film's frames [s]: the first state, and from there on as long as there are states."""
    if not fps > 0 or not speed > 0:
        raise FungraspError(f"frames per second and speed must be positive, not {fps} and {speed}")
    count = int(np.floor((times[-1] - times[0]) * fps / speed + 1e-6)) + 1
    return times[0] + np.arange(count) * speed / fps


def interpolate(model: mujoco.MjModel, qpos: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """States between recorded ones, along the shortest motion of each joint.

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


def _shifts(model: mujoco.MjModel, states: np.ndarray, follow: str, fps: float) -> np.ndarray:
    bodies = [model.body(i).name for i in range(model.nbody)]
    if follow not in bodies:
        raise UnknownNameError("body", follow, bodies)
    data = mujoco.MjData(model)
    path = np.empty((len(states), 3))
    for i, state in enumerate(states):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        path[i] = data.body(follow).xpos
    half = max(1, round(0.4 * fps))
    padded = np.concatenate([path[:1].repeat(half, 0), path, path[-1:].repeat(half, 0)])
    window = np.hanning(2 * half + 3)[1:-1]
    window /= window.sum()
    smooth = np.stack([np.convolve(padded[:, k], window, "valid") for k in range(3)], axis=-1)
    return smooth - path[0]


def _moved(camera: Camera, shift: np.ndarray, turn: float) -> Camera:
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    offset = np.subtract(camera.position, camera.target)
    turned = np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], offset[2]])
    x, y, z = (float(v) for v in np.add(camera.target, shift))
    px, py, pz = (float(v) for v in np.array([x, y, z]) + turned)
    return replace(camera, position=(px, py, pz), target=(x, y, z))


def _words(title: str, phases: Sequence[tuple[float, str]], time: float) -> str:
    current = [name for start, name in phases if start <= time + 1e-9]
    return " · ".join(part for part in (title, current[-1] if current else "") if part)
