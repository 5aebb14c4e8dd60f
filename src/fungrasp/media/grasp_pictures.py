"""A sheet of some of a set's grasps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from fungrasp.core.files import atomic_path
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.media.grasp_scenes import grasp_scene
from fungrasp.media.pictures import grid
from fungrasp.media.render import render
from fungrasp.media.viewpoints import look_at_grasp
from fungrasp.objects import ObjectModel

DRAWN_GRASPS = 12
"""Largest number of grasps in a picture."""

WIDTH, HEIGHT = 400, 320
"""Size of each grasp in a picture [pixels]."""


def draw_grasps(
    path: Path,
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    human: HumanGraspSet | None = None,
    captions: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Draw grasps spread over the set, of different objects where there are as many.

    Args:
        path: of the PNG file.
        robot: N grasps.
        objects: by name.
        human: what they were retargeted from, drawn to their left.
        captions: text for each grasp after the name of its object; the name of the hand if None.
        progress: called with the share that is drawn, up to 1.
    """
    hand = robot.load_hand()
    rows = spread_rows(robot.object_name)
    images, labels = [], []
    for done, row in enumerate(rows):
        obj = objects[str(robot.object_name[row])]
        model, qpos = grasp_scene(robot[row], obj, hand)
        camera = look_at_grasp(model, qpos, width=WIDTH, height=HEIGHT)
        if human is not None:
            person, still = grasp_scene(human[row], obj)
            images += [render(person, still, camera)[0]]
            labels += [f"{obj.name}: human"]
        images += [render(model, qpos, camera)[0]]
        labels += [f"{obj.name}: {hand.name if captions is None else captions[row]}"]
        progress((done + 1) / len(rows))
    with atomic_path(path) as temporary:
        Image.fromarray(grid(images, labels, columns=4)).save(temporary, format="PNG")


def spread_rows(object_name: np.ndarray, most: int = DRAWN_GRASPS) -> list[int]:
    """Rows spread over a set, of different objects where there are as many. object_name: shape [N] str."""
    _, first = np.unique(object_name, return_index=True)
    others = np.setdiff1d(np.arange(len(object_name)), first)
    return [int(row) for row in np.concatenate([first, others])[:most]]
