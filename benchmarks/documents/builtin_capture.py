"""``python -m benchmarks.documents.builtin_capture``: renders the image that comes with the package."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.perception.capture_files import TRUTH_FILE, write_capture
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.depth_noise import ColorNoise
from benchmarks.synthetic_captures.render_capture import render_capture
from fungrasp.core.files import atomic_path
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE, COLOR_FILE, DEPTH_FILE, LENS_FILE

FILES = (COLOR_FILE, DEPTH_FILE, LENS_FILE, TRUTH_FILE)

ROW, SEED = 71, 0
"""The built-in grasp that is shown, and the dice of camera, room and noise."""

SETTINGS = CaptureSettings(
    distance=(0.42, 0.62), elevation=(22.0, 48.0), clutter=(1, 3), color_noise=ColorNoise(noise=1.0)
)
"""A person's own view of a table, less grainy than usual, to be a small file."""


def make_builtin_capture(folder: str | Path = BUILTIN_CAPTURE) -> None:
    """Render the image anew. Another machine's rounding may change single pixels.

    Raises:
        FungraspError: the folder can't be written to.
    """
    grasp = builtin_grasps()[ROW]
    rng = np.random.default_rng([4, ROW, SEED])
    synthetic = render_capture(grasp, builtin_object(grasp.object_name), rng, SETTINGS)
    with TemporaryDirectory() as name:
        write_capture(synthetic, name)
        for file in FILES:
            with atomic_path(Path(folder) / file) as path:
                shutil.copyfile(Path(name) / file, path)


if __name__ == "__main__":
    make_builtin_capture()
