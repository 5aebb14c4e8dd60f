"""Makes the picture of lab/evaluation.md of use tests that failed: one of each motion, of recorded ones.

Run it: ``python -m benchmarks.documents.use_failures_picture FOLDER``, a folder of ``fungrasp evaluate --use
--record FOLDER`` of built-in grasps.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.documents.failures_picture import LAB, frames_of
from fungrasp.evaluation import Trajectory, replay
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.media.pictures import grid
from fungrasp.task.use import load_use_motions, motion_of

MOMENTS = (0.0, 0.33, 0.67, 1.0)
"""Of the frames, as shares of the time until the test ends."""


def main(folder: Path) -> None:
    human = builtin_grasps()
    objects, motions = load_objects(human), load_use_motions().values()
    assert human.task is not None
    shown: dict[str, Trajectory] = {}
    for file in sorted(folder.glob("*_use.npz")):
        episode = replay(file)
        motion = motion_of(str(human.task[episode.index]), motions)
        if not episode.success and motion is not None:
            shown.setdefault(motion.name, episode)
    frames: list[np.ndarray] = []
    labels: list[str] = []
    for name, episode in shown.items():
        thing = objects[episode.object_name]
        states = [round(share * (len(episode.times) - 1)) for share in MOMENTS]
        frames += frames_of(episode, load_hand(episode.hand), thing, states, states)
        labels.append(f"{name.replace('_', ' ')}, {thing.name.replace('_', ' ')}: {episode.reason}")
        labels += [f"{share * episode.times[-1]:.1f} s" for share in MOMENTS[1:]]
    sheet = grid(frames, labels, columns=len(MOMENTS), size=13)
    Image.fromarray(sheet).save(LAB / "use-failures.jpg", quality=84, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
