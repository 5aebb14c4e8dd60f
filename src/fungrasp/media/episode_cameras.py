"""What cameras would have seen of a recorded episode: one in front of the table, one on the hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.geometry.poses import rotate, transform_points
from fungrasp.hands import Hand
from fungrasp.media import Camera, Renderer, robot_grasp_scene, robot_scene_states
from fungrasp.objects import ObjectModel

CameraName = Literal["front", "wrist"]
"""A fixed camera that looks over the table to where the object stood, and one that moves with the palm."""

FRONT = (0.68, 0.32, 0.4)
"""The fixed camera, seen from where the object stood: on the far side of the table, off to a side [m]."""
FRONT_ABOVE = 0.12
"""The middle of its picture is so far above where the object stood [m]: a lift goes 10 cm up and more."""
WRIST = (-0.16, 0.1)
"""The hand's camera, from the palm's origin along the fingers and out of the palm [m]: on a bracket at the
wrist, beside the fingers' way."""
WRIST_TARGET = (0.12, 0.05)
"""The middle of its picture, likewise: where the fingertips meet [m]."""
WRIST_FOV = 65.0
"""Vertical field of view of the hand's camera, which is near [degrees]; small cameras have 60 to 90."""


def episode_pictures(
    episode: Trajectory,
    hand: Hand,
    thing: ObjectModel,
    camera: CameraName,
    size: tuple[int, int] = (320, 240),
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """A picture of each state of an episode of ``hand`` and ``thing``.

    Args:
        camera: from where.
        size: width and height [pixels].
        threads: 0 means all CPUs; pictures do not depend on it.

    Yields:
        sRGB, shape [height, width, 3] uint8.

    Raises:
        FungraspError: a state is not finite (the simulation diverged), or there is no such camera.
    """
    wrist, joints, things = episode.palm_pose, episode.joint_positions, episode.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], thing, things[0])
    states = robot_scene_states(model, hand, wrist, joints, things)
    width, height = size
    if camera == "front":
        foot = np.array([*things[0, :2], 0.0], dtype=float)
        at, target = foot + FRONT, foot + np.array([0.0, 0.0, FRONT_ABOVE])
        views = Camera(_three(at), _three(target), width=width, height=height)
    elif camera == "wrist":
        across = np.stack([hand.palm_fingers, hand.palm_normal])
        places = transform_points(wrist, np.array([WRIST, WRIST_TARGET]) @ across)
        ups = rotate(wrist[:, 3:], np.tile(hand.palm_normal, (len(wrist), 1)))
        views = [
            Camera(_three(at), _three(target), _three(up), WRIST_FOV, width, height)
            for (at, target), up in zip(places, ups, strict=True)
        ]
    else:
        raise FungraspError(f"there is no camera '{camera}'; there are front and wrist")
    return Renderer(model, threads=threads).stream(states, views)


def _three(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
