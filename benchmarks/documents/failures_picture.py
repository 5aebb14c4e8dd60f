"""Makes the picture of lab/failures.md: a failed episode of each class, of built-in grasps
in the reality protocol.

Run it: ``python -m benchmarks.documents.failures_picture``. It takes some minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from fungrasp.evaluation import Trajectory, evaluate, replay
from fungrasp.geometry.poses import (
    quaternion_conjugate,
    quaternion_multiply,
    rotate,
    rotation_vector,
)
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.media import look_at_grasp, render, robot_grasp_scene
from fungrasp.media.grasp_scenes import robot_scene_states
from fungrasp.media.pictures import grid
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget

LAB = Path(__file__).parents[2] / "lab"

HAND = "allegro"
TIPPED = np.deg2rad(30.0)
"""An object that has turned by more before the lift was tipped over [rad]."""
LONG = 2.5
"""Something this many times as long as it is wide rolls about its length."""
LIFTED = 0.03
"""One that was higher than this left the table [m]: fingers that slide off tilt it by as much as 2 cm."""
CLASSES = {
    "tipped over": "tipped over by the closing hand",
    "stays on the table": "stays on the table: the fingers close above or beside it",
    "slides out": "slides out of the fingers as they lift",
    "hangs too low": "hangs too low: it has slid or turned down in the hand",
    "dropped": "dropped during the hold",
}
"""Classes of failures, in the order of the page, and the words beside their pictures."""
EXAMPLES = {
    "stays on the table": "scissors",
    "slides out": "box",
    "hangs too low": "teapot",
    "dropped": "hammer",
}
"""Objects that show a class well; the first that is found of others."""
FRAMES = ("the hand closes", "the lift begins", "1 s later", "at the end")
FARTHEST = 0.4
"""What has travelled farther is out of the pictures [m]."""
SIZE = {"width": 340, "height": 280, "margin": 1.15}


def failure_class(episode: Trajectory, thing: ObjectModel) -> str:
    """One of ``CLASSES`` for a failed episode; "" for one that diverged."""
    lying = episode.object_pose[episode.phase == 0]
    turned = rotation_vector(quaternion_multiply(lying[:, 3:], quaternion_conjugate(lying[:1, 3:])))
    # Turning about the vertical is no tipping, nor is rolling, about the length of something long.
    turned = rotate(quaternion_conjugate(lying[:1, 3:]), turned * [1.0, 1.0, 0.0])
    *_, second, longest = np.sort(thing.size)
    if longest > LONG * second:
        turned = turned * (thing.size < longest)
    if np.linalg.norm(turned, axis=1).max() > TIPPED:
        return "tipped over"
    lifted = episode.object_pose[:, 2].max() - lying[0, 2]
    reasons = {
        "lost before the hold": "slides out" if lifted > LIFTED else "stays on the table",
        "held too low": "hangs too low",
        "dropped during the hold": "dropped",
    }
    return reasons.get(episode.reason, "")


def moments(episode: Trajectory) -> list[int]:
    """States of the frames."""
    touching = np.flatnonzero(episode.link_contacts.any(axis=1))
    lift = int(np.argmax(episode.phase > 0)) if (episode.phase > 0).any() else len(episode.times) - 1
    close = min(int(touching[0]), lift) if len(touching) else lift
    later = int(np.searchsorted(episode.times, episode.times[lift] + 1.0))
    last = len(episode.times) - 1
    return [close, lift, min(later, last), last]


def pictures(episode: Trajectory, hand: Hand, thing: ObjectModel) -> list[np.ndarray]:
    """Frames of an episode, all from one side."""
    states, place = moments(episode), episode.object_pose[:, :3]
    # The view is chosen for the lift, and frames whatever stays near.
    near = [i for i in (*states, states[1]) if np.linalg.norm(place[i] - place[0]) < FARTHEST]
    return frames_of(episode, hand, thing, states, near)


def frames_of(
    episode: Trajectory, hand: Hand, thing: ObjectModel, states: list[int], framed: list[int]
) -> list[np.ndarray]:
    """Pictures of some states, from the side that suits those of ``framed``."""
    wrist, joints, things = episode.palm_pose, episode.joint_positions, episode.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], thing, things[0])
    camera = look_at_grasp(model, robot_scene_states(model, hand, wrist, joints, things)[framed], **SIZE)
    frames: list[np.ndarray] = []
    for i in states:
        model, qpos = robot_grasp_scene(hand, wrist[i], joints[i], thing, things[i], episode.link_contacts[i])
        frames.append(render(model, qpos, camera)[0])
    return frames


def main() -> None:
    human = builtin_grasps()
    objects, hand = load_objects(human), load_hand(HAND)
    robot = retarget(human, objects, hand)
    with TemporaryDirectory() as folder:
        evaluate(robot, objects, protocol="reality", record=Path(folder))
        episodes = [replay(file) for file in sorted(Path(folder).iterdir())]
    failed = [(failure_class(e, objects[e.object_name]), e) for e in episodes if not e.success]
    shown, labels = [], []
    for name, words in CLASSES.items():
        found = [episode for label, episode in failed if label == name]
        things = ", ".join(episode.object_name for episode in found)
        sys.stdout.write(f"{words}: {len(found)} of {len(episodes)} {things}\n")
        if not found:
            continue
        wanted = EXAMPLES.get(name, found[0].object_name)
        episode = next((e for e in found if e.object_name == wanted), found[0])
        title = episode.object_name.replace("_", " ")
        shown += pictures(episode, hand, objects[episode.object_name])
        labels += [f"{title}, {name}: {FRAMES[0]}", *FRAMES[1:]]
    sheet = grid(shown, labels, columns=len(FRAMES), size=15)
    Image.fromarray(sheet).save(LAB / "failures.jpg", quality=86, optimize=True)


if __name__ == "__main__":
    main()
