"""Makes the picture of docs/perceive.md: the demo's image, what was seen in it, and the grasp in 3D.

Run it, after ``fungrasp setup perception``: ``python -m benchmarks.documents.perception_picture``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from fungrasp.media.perception_pictures import drawn_over, grasp_from_four_sides
from fungrasp.media.pictures import grid
from fungrasp.objects import builtin_object
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import builtin_truth, read_folder
from fungrasp.perception.pipeline import perceive

IMAGES = Path(__file__).parents[2] / "docs" / "images"

SIZE = (480, 360)


def main() -> None:
    truth, capture = builtin_truth(), read_folder(FOLDER)
    model = builtin_object(truth.object_name)
    seen = perceive(capture, model, task=truth.task)
    over = drawn_over(capture, seen.hand, model, seen.object.pose_camera_object, seen.object.accepted)
    sides = grasp_from_four_sides(seen.grasp, model, seen.pose_world_camera, mirrored=False)
    pictures = [np.asarray(Image.fromarray(image).resize(SIZE)) for image in (capture.color, over, sides[0])]
    labels = ["the image, rendered", "hand and object found in it", "the human grasp, contacts orange"]
    sheet = grid(pictures, labels, columns=3, size=19)
    Image.fromarray(sheet).save(IMAGES / "perception.jpg", quality=86, optimize=True)


if __name__ == "__main__":
    main()
