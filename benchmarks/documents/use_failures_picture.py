"""Makes the picture of docs/lab/failures.md of use tests that failed: one of each motion, of recorded ones.

Run it: ``python -m benchmarks.documents.use_failures_picture FOLDER``, a folder of ``fungrasp evaluate --use
--record FOLDER`` of built-in grasps.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.documents.failures_picture import LAB, SIZE
from fungrasp.evaluation import Trajectory, replay
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.rendering import look_at_grasp, render, robot_grasp_scene
from fungrasp.rendering.grasp_scenes import robot_scene_states
from fungrasp.report import grid
from fungrasp.task.use import load_use_motions, motion_of

MOMENTS = (0.0, 0.33, 0.67, 1.0)
"""Of the frames, as shares of the time until the test ends."""


def pictures(episode: Trajectory, hand: Hand, thing: ObjectModel) -> list[np.ndarray]:
    """Frames of a use test, all from one side."""
    states = [round(share * (len(episode.times) - 1)) for share in MOMENTS]
    wrist, joints, things = episode.palm_pose, episode.joint_positions, episode.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], thing, things[0])
    camera = look_at_grasp(model, robot_scene_states(model, hand, wrist, joints, things)[states], **SIZE)
    frames: list[np.ndarray] = []
    for i in states:
        model, qpos = robot_grasp_scene(hand, wrist[i], joints[i], thing, things[i], episode.link_contacts[i])
        frames.append(render(model, qpos, camera)[0])
    return frames


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
    frames, labels = [], []
    for name, episode in shown.items():
        thing = objects[episode.object_name]
        frames += pictures(episode, load_hand(episode.hand), thing)
        labels.append(f"{name.replace('_', ' ')}, {thing.name.replace('_', ' ')}: {episode.reason}")
        labels += [f"{share * episode.times[-1]:.1f} s" for share in MOMENTS[1:]]
    sheet = grid(frames, labels, columns=len(MOMENTS), size=13)
    Image.fromarray(sheet).save(LAB / "use-failures.jpg", quality=84, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
