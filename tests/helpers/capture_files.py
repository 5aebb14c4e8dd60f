"""Image files of a small made-up scene, for the tests of this folder."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 320, 240
OURS = {
    "width": WIDTH,
    "height": HEIGHT,
    "fx": 300.0,
    "fy": 301.0,
    "cx": 160.0,
    "cy": 119.0,
    "depth_unit": 0.001,
}


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A box in front of a wall: RGB, and depth [m]; steps in depth are edges in color."""
    color = np.full((HEIGHT, WIDTH, 3), (40, 90, 60), np.uint8)
    depth = np.full((HEIGHT, WIDTH), 0.9, np.float32)
    color[80:180, 100:220], depth[80:180, 100:220] = (210, 160, 130), 0.6
    depth[5:9, 5:9] = 0.0
    return color, depth


def write_scene(folder: Path, lens=OURS, unit: float = 0.001) -> tuple[Path, Path, Path]:
    """Color, depth and intrinsics as files."""
    folder.mkdir(parents=True, exist_ok=True)
    color, depth = scene()
    paths = folder / "rgb.png", folder / "depth.png", folder / "K.json"
    Image.fromarray(color).save(paths[0])
    Image.fromarray(np.round(depth / unit).astype(np.uint16)).save(paths[1])
    paths[2].write_text(json.dumps(lens))
    return paths
