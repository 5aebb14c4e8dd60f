"""Makes the pictures and the film of README and docs: ``python -m benchmarks.documents.pictures [NAME ...]``.

``grasps`` is a sheet of built-in grasps, human and on every robot hand; ``hands`` the hands themselves;
``film`` grasps by a person and by two robot hands side by side, lifted and used; ``perception`` the demo's
image and what was seen in it, after ``fungrasp setup perception``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from fungrasp.evaluation import LiftTestSpec, evaluate, replay
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects
from fungrasp.grasps.grasp_arguments import picked_rows
from fungrasp.hands import Hand, load_hand
from fungrasp.media import grasp_scene, look_at_grasp, render
from fungrasp.media.episode_film import FilmSettings, episode_film
from fungrasp.media.grasp_pages import grasp_title
from fungrasp.media.perception_pictures import CloseUp, grasp_from_four_sides
from fungrasp.media.pictures import captioned, draw_hand, grid
from fungrasp.media.video import write_video
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.scene_folders import BUILTIN
from fungrasp.perception.pipeline import perceive_folder
from fungrasp.policies import default_policy
from fungrasp.retargeting import retarget

IMAGES = Path(__file__).parents[2] / "docs" / "images"

CHOICE = (
    "mug:drink",
    "hammer:hammer",
    "spray_bottle:spray",
    "scissors:cut",
    "drill:drill",
    "wine_glass:drink",
)
"""Object and task of each row of the sheet."""

HANDS = ("allegro", "shadow", "faive", "inspire", "leap")

FILMED = (0, 72, 21, 79, 102)
"""Rows of the built-in grasps in the film: mug, spray bottle, scissors, teapot, hammer."""

BESIDE = ("allegro", "shadow")
"""Hands in the film."""

PANEL = FilmSettings(fps=8.0, speed=2.5, width=384, height=324)
"""Each hand's part of the film's picture."""

QUALITY = 30.0
"""Constant rate factor: a film in a repository is to be small."""


def grasps() -> None:
    """``grasps.jpg``."""
    everything = builtin_grasps()
    human = everything.select(picked_rows(everything, CHOICE))
    objects = load_objects(human)
    robots = {name: retarget(human, objects, load_hand(name)) for name in HANDS}
    pictures, labels = [], []
    for row, grasp in enumerate(human):
        obj = objects[grasp.object_name]
        model, qpos = grasp_scene(grasp, obj)
        camera = look_at_grasp(model, width=340, height=300, margin=1.2)
        pictures.append(render(model, qpos, camera)[0])
        labels.append(f"{grasp.object_name.replace('_', ' ')}: {grasp.task}")
        for name, robot in robots.items():
            model, qpos = grasp_scene(robot[row], obj, load_hand(name))
            pictures.append(render(model, qpos, camera)[0])
            labels.append(name)
    _save(grid(pictures, labels, columns=1 + len(HANDS), size=17), "grasps.jpg")


def hands() -> None:
    """``hands.jpg``: one view of each hand."""
    pictures = []
    with TemporaryDirectory() as folder:
        for name in HANDS:
            draw_hand(Path(folder) / f"{name}.png", load_hand(name))
            four = Image.open(Path(folder) / f"{name}.png").convert("RGB")
            first = four.crop((0, 0, four.width // 2, four.height // 2))
            pictures.append(np.asarray(first.resize((320, 320 * first.height // first.width))))
    _save(grid(pictures, HANDS, columns=len(HANDS), size=17), "hands.jpg")


def film() -> None:
    """``demo.mp4``, and ``demo.jpg`` that stands for it."""
    human = builtin_grasps().select(np.array(FILMED))
    objects = load_objects(human)
    sides = [_filmed(human, objects, load_hand(name)) for name in BESIDE]
    frames = []
    for row, clips in enumerate(zip(*sides, strict=True)):
        grasp = human[row]
        model, qpos = grasp_scene(grasp, objects[grasp.object_name])
        camera = look_at_grasp(model, width=PANEL.width, height=PANEL.height, margin=1.3)
        person = captioned(render(model, qpos, camera)[0], grasp_title(grasp))
        for at in range(max(map(len, clips))):
            frames.append(np.hstack([person, *(clip[min(at, len(clip) - 1)] for clip in clips)]))
        if row == 1:
            _save(frames[-1], "demo.jpg")
    write_video(IMAGES / "demo.mp4", frames, PANEL.fps, quality=QUALITY)


def _filmed(human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand) -> list[list[np.ndarray]]:
    """Frames of the lift and the use of each grasp by a hand, and how it ended."""
    clips: list[list[np.ndarray]] = [[] for _ in human]
    with TemporaryDirectory() as folder:
        spec = LiftTestSpec(use=True)
        result = evaluate(human, objects, default_policy(hand.name), spec=spec, hand=hand, record=folder)
        episodes = sorted(map(replay, Path(folder).glob("*.npz")), key=lambda e: (e.index, e.is_use_test))
        for each in episodes:
            held, shown = (getattr(result.outcomes, key)[each.index] for key in ("success", "held_as_shown"))
            words = "held as shown" if shown else "held in another way" if held else "not held"
            title = f"{hand.name.title()}, {words}"
            clips[each.index] += episode_film(each, hand, objects[each.object_name], PANEL, title=title)
    return clips


def perception() -> None:
    """``perception.jpg``."""
    seen = perceive_folder(BUILTIN, None)
    capture, model, pose = seen.capture, seen.object_model, seen.object.pose_camera_object
    over = CloseUp(capture, seen.hand, model, pose).found(seen.object.accepted)
    side = grasp_from_four_sides(seen.grasp, model, seen.pose_world_camera, mirrored=False)[0]
    pictures = [
        np.asarray(Image.fromarray(image).resize((480, 360))) for image in (capture.color, over, side)
    ]
    labels = ["the image, rendered", "hand and object found in it", "the human grasp, contacts orange"]
    _save(grid(pictures, labels, columns=3, size=19), "perception.jpg")


def _save(picture: np.ndarray, name: str) -> None:
    Image.fromarray(picture).save(IMAGES / name, quality=87, optimize=True)


MAKERS: dict[str, Callable[[], None]] = {
    "grasps": grasps,
    "hands": hands,
    "film": film,
    "perception": perception,
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pictures", nargs="*", help=f"of {', '.join(MAKERS)}; all by default")
    for wanted in parser.parse_args().pictures or MAKERS:
        MAKERS[wanted]()
