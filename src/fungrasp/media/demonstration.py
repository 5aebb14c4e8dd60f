"""Demonstration: human grasps are retargeted, tested and used, with a video and a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from fungrasp.core.provenance import page_provenance
from fungrasp.evaluation import LiftTestSpec, Trajectory, evaluate, replay, static_quality
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.grasps.as_shown import place_marks
from fungrasp.hands import Hand
from fungrasp.media.episode_film import FilmSettings, episode_film, film_frames
from fungrasp.media.grasp_pages import (
    SIZE,
    contacts,
    grasp_title,
    outcome,
    quantities,
    use_outcome,
)
from fungrasp.media.grasp_scenes import grasp_scene, look_at_grasp
from fungrasp.media.page import GraspReport, Page, write_page
from fungrasp.media.pictures import MARKS_MEAN, grasp_pictures
from fungrasp.media.render import render
from fungrasp.media.video import write_video
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget

FILM = FilmSettings(fps=8.0, speed=2.5, width=576, height=324)
"""Video settings of the demonstration; rendering takes a third of its time."""

INSET = 0.24
"""Width of the inset with the human grasp, relative to the video's width."""

TITLE = "Human grasps, taken over by a robot hand"

INTRODUCTION = (
    "On the left of each pair, how a person holds the object for the task; on the right, the grasp that "
    "the robot hand makes of it. "
    + MARKS_MEAN
    + " The film is the episode in simulation: reach for the object on the table, "
    "close, lift by 15 cm and hold for 3 s. Where the task has a motion, a second film shows what follows: "
    "the wrist pours, strikes or strokes, a finger presses the trigger, or somebody pulls, and the object is "
    f"to stay in the hand. The films run {FILM.speed:g} times as fast."
)

Stages = Callable[[str, float], AbstractContextManager[Callable[[float], None]]]
"""Context manager of a stage, called with its name and total amount of work; yields a function that reports
the amount done."""


@contextmanager
def no_stages(name: str, total: float) -> Iterator[Callable[[float], None]]:
    """Report nothing."""
    yield lambda done: None


@dataclass(frozen=True, eq=False)
class Demonstration:
    """Results of a demonstration."""

    film: Path
    """Video of all episodes."""
    page: Path
    """Page with all results."""
    grasps: list[GraspReport]
    """The page's report of each grasp."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Grasps to demonstrate."""

    human: HumanGraspSet
    """N grasps."""
    objects: Mapping[str, ObjectModel]
    """Objects of the grasps by name."""
    source: Mapping[str, str]
    """Provenance of the grasps: label and value."""
    before: Mapping[int, Sequence[str]] = field(default_factory=dict)
    """HTML before a grasp's report, by row: about the image that shows the grasp."""


def demonstrate(
    shown: Shown,
    hand: Hand,
    policy: str,
    out: Path,
    *,
    seed: int = 0,
    threads: int = 0,
    stages: Stages = no_stages,
) -> Demonstration:
    """Retarget grasps, test and use them, and write a video and a page.

    Args:
        policy: name or file of the policy.
        out: folder for ``film.mp4`` and ``index.html``, written atomically.
        seed: seed in the page's provenance.
        threads: number of threads; 0 for all processors.

    Raises:
        FungraspError: a verb fails, or a file can't be written.
    """
    start, human, objects = perf_counter(), shown.human, shown.objects
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".demo.", dir=out) as name:
        folder = Path(name)
        with stages("measuring the objects", len(objects)) as show:
            for done, model in enumerate(objects.values()):
                _ = model.signed_distance
                show(done + 1)
        with stages(f"retargeting to {hand.name}", 1.0) as show:
            robot = retarget(human, objects, hand, threads=threads, progress=show)
        quality = static_quality(robot, human, objects, hand)
        with stages("lifting and using", 1.0) as show:
            result = evaluate(
                robot,
                objects,
                policy,
                spec=LiftTestSpec(use=True),
                human=human,
                threads=threads,
                record=folder,
                progress=show,
            )
        episodes = sorted(map(replay, folder.glob("*.npz")), key=lambda each: (each.index, each.is_use_test))
        film, clips = _film(episodes, shown, hand, folder, out / "film.mp4", threads, stages)
        reports = []
        with stages("drawing", len(human)) as show:
            for episode in episodes:
                if episode.is_use_test:
                    continue
                row = episode.index
                marks = place_marks(robot, row, objects, hand=hand)
                pictures = grasp_pictures(robot, row, objects, SIZE, human, marks)
                use_clip = clips.get((row, True))
                use = None if use_clip is None else result.use
                report = GraspReport(
                    grasp_title(human[row]),
                    object_mass=human[row].object_mass,
                    **outcome(result, row),
                    human_picture=pictures[0],
                    robot_picture=pictures[1],
                    film=clips[row, False],
                    use_success=None
                    if use_clip is None or result.use is None
                    else bool(result.use.success[row]),
                    use_outcome="" if use is None else use_outcome(use, row),
                    use_film=use_clip,
                    contacts=contacts(robot[row], episode, hand),
                    quality=quantities(quality, result, row),
                    before=shown.before.get(row, ()),
                )
                reports.append(report)
                show(len(reports))
        made = page_provenance({"Policy": policy, **shown.source}, seed, perf_counter() - start)
        page = Page(TITLE, reports, hand.title, INTRODUCTION, made)
        return Demonstration(film, write_page(out / "index.html", page), reports)


def _film(
    episodes: Sequence[Trajectory],
    shown: Shown,
    hand: Hand,
    folder: Path,
    out: Path,
    threads: int,
    stages: Stages,
) -> tuple[Path, dict[tuple[int, bool], Path]]:
    """Write the video of all episodes, and one for each grasp (row, whether it is the use test)."""
    clips: dict[tuple[int, bool], Path] = {}
    people = [_person(grasp, shown.objects[grasp.object_name]) for grasp in shown.human]

    def frames() -> Iterator[np.ndarray]:
        done = 0
        for each in episodes:
            obj, clip, grasp = shown.objects[each.object_name], [], shown.human[each.index]
            film = episode_film(
                each,
                hand,
                obj,
                FILM,
                title=grasp_title(grasp),
                inset=people[each.index],
                threads=threads,
            )
            for frame in film:
                clip.append(frame)
                yield frame
                done += 1
                show(done)
            file = folder / f"{each.index}{'-use' if each.is_use_test else ''}.mp4"
            clips[each.index, each.is_use_test] = write_video(file, clip, FILM.fps)

    with stages("filming", sum(film_frames(each, FILM) for each in episodes)) as show:
        return write_video(out, frames(), FILM.fps), clips


def _person(grasp: HumanGrasp, obj: ObjectModel) -> np.ndarray:
    """Return the picture of the human grasp for the inset."""
    model, qpos = grasp_scene(grasp, obj)
    width = round(INSET * FILM.width)
    height = round(0.75 * width)
    return render(model, qpos, look_at_grasp(model, width=width, height=height))[0]
