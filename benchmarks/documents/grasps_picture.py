"""Makes the pictures of README and documentation: built-in grasps, human and on every robot hand.

Run it: ``python -m benchmarks.documents.grasps_picture``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.media import Camera, grasp_scene, look_at_grasp, render
from fungrasp.media.pictures import grid
from fungrasp.retargeting import retarget

IMAGES = Path(__file__).parents[2] / "docs" / "images"

CHOICE = (
    ("mug", "drink"),
    ("hammer", "hammer"),
    ("spray_bottle", "spray"),
    ("scissors", "cut"),
    ("drill", "drill"),
    ("wine_glass", "drink"),
)
"""Object and task of each row."""

HANDS = ("allegro", "shadow", "faive", "inspire", "leap")
SIZE = {"width": 340, "height": 300, "margin": 1.2}


def chosen(grasps: HumanGraspSet) -> HumanGraspSet:
    """The first grasp of each object and task."""
    rows = []
    for name, task in CHOICE:
        found = np.flatnonzero((grasps.object_name == name) & (grasps.task == task))
        rows.extend(found[:1].tolist())
    return grasps.select(np.array(rows))


def main() -> None:
    human = chosen(builtin_grasps())
    objects = load_objects(human)
    robots = {name: retarget(human, objects, load_hand(name)) for name in HANDS}
    pictures, labels = [], []
    for row, grasp in enumerate(human):
        thing = objects[grasp.object_name]
        model, _ = grasp_scene(grasp, thing)
        camera: Camera = look_at_grasp(model, **SIZE)
        pictures.append(render(model, model.qpos0, camera)[0])
        labels.append(f"{grasp.object_name.replace('_', ' ')}: {grasp.task}")
        for name, robot in robots.items():
            model, qpos = grasp_scene(robot[row], thing, load_hand(name))
            pictures.append(render(model, qpos, camera)[0])
            labels.append(name)
    sheet = grid(pictures, labels, columns=1 + len(HANDS), size=17)
    Image.fromarray(sheet).save(IMAGES / "grasps.jpg", quality=88, optimize=True)


if __name__ == "__main__":
    main()
