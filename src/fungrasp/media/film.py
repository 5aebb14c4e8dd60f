"""A recorded trajectory as a film: even frame times, a line of words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.media.camera import Camera
from fungrasp.media.pictures import captioned
from fungrasp.media.render import Renderer


def film(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    times: np.ndarray,
    fps: float,
    camera: Camera,
    *,
    speed: float = 1.0,
    phases: Sequence[tuple[float, str]] = (),
    title: str = "",
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """Frames of a recorded trajectory, states between the recorded ones interpolated.

    Args:
        qpos: joint positions, shape [T, nq].
        times: of the states, increasing [s], shape [T].
        fps: frames per second.
        camera: that stands still.
        speed: seconds of the trajectory in a second of the film.
        phases: start [s] and name of each phase of the motion, for the bar of words.
        title: words before the phase.
        threads: 0 means all CPUs.

    Yields:
        sRGB, shape [H, W, 3] uint8.
    """
    at = frame_times(times, fps, speed)
    frames = Renderer(model, threads=threads).stream(interpolate(model, qpos, times, at), camera)
    return (
        captioned(frame, _words(title, phases, t), f"{t - times[0]:.1f} s")
        for frame, t in zip(frames, at, strict=True)
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


def _words(title: str, phases: Sequence[tuple[float, str]], time: float) -> str:
    current = [name for start, name in phases if start <= time + 1e-9]
    return " · ".join(part for part in (title, current[-1] if current else "") if part)
