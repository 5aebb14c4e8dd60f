"""The grasp of a run, from a file or an image, and how long it took to get it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.synthetic_captures.render_capture import render_capture
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.spec import GraspChoice, why_not_tried
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.perception.pipeline import perceive
from fungrasp.retargeting import retarget

MOST_IMAGES = 5
"""Images that are rendered before the grasp counts as one that can't be seen; a person would hardly take
more."""


@dataclass(frozen=True, eq=False)
class TimedGrasp:
    """A grasp for a robot."""

    robot: RobotGraspSet
    """One."""
    objects: Mapping[str, ObjectModel]
    """Its object, by name."""
    images: int
    """Images that were looked at, those of low confidence included; 0 where the grasp is not from one."""
    seconds: float
    """From the image, or the file, to the robot grasp, rendering not included [s]."""


def timed_grasp(choice: GraspChoice, hand: Hand, seed: int) -> TimedGrasp:
    """The grasp as it was chosen.

    Raises:
        FungraspError: as ``GraspChoice.robot``.
    """
    began = time.monotonic()
    robot, objects = choice.robot(hand, seed)
    return TimedGrasp(robot, objects, int(choice.image is not None), time.monotonic() - began)


def rendered_grasp(choice: GraspChoice, hand: Hand, seed: int, taken: int = 0) -> TimedGrasp:
    """The chosen grasp as it is seen in an image that is rendered for this, as if a person took images until
    one is good enough.

    Args:
        choice: a grasp of a file.
        hand: of the robot.
        seed: of the images.
        taken: how many were taken before, of which the robot could reach none.

    Raises:
        FungraspError: no such grasp, or ``MOST_IMAGES`` images were not good enough.
    """
    if choice.image is not None:
        raise FungraspError("--rendered makes an image of the grasp: give no --image beside it")
    human, objects = choice.human()
    true = human[0]
    model, said = objects[true.object_name], "the robot can reach none"
    for attempt in range(taken, MOST_IMAGES):
        capture = render_capture(true, model, np.random.default_rng([seed, attempt])).capture
        began = time.monotonic()
        try:
            seen = perceive(capture, model, task=true.task, seed=seed)
        except FungraspError as error:
            # No hand is seen: another image, as where the confidence is low.
            said = str(error)
            continue
        said = why_not_tried(seen)
        if not said:
            robot = retarget(seen.grasps, seen.objects, hand, threads=choice.threads)
            return TimedGrasp(robot, seen.objects, attempt + 1, time.monotonic() - began)
    raise FungraspError(f"{MOST_IMAGES} rendered images of '{model.name}' were not good enough: {said}")
