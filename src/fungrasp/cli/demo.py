"""``fungrasp demo``: a few human grasps, or the one in an image, retargeted, tried and shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar
from fungrasp.cli.demo_from_image import Folder
from fungrasp.cli.provenance import page_provenance

if TYPE_CHECKING:
    import numpy as np

    from fungrasp.cli.demo_from_image import SeenGrasp
    from fungrasp.evaluation import LiftTestResult, Trajectory
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel

FAVOURITES = ("drill:drill", "mug:hand over", "flashlight:light", "bottle:pour")
"""What is shown if nothing is picked, as far as the grasps have it."""

REFERENCE = "reference"

TITLE = "Human grasps, taken over by a robot hand"

FPS, SPEED = 12.0, 2.0
"""Frames per second of the film, and how much faster than the simulation it runs."""

INTRODUCTION = (
    "On the left of each pair, how a person holds the object for the task; on the right, the grasp that "
    "the robot hand makes of it. The film is the episode in simulation: reach for the object on the table, "
    "close, lift by 15 cm and hold for 3 s. Where the task has a motion, a second film shows what follows: "
    "the wrist pours, strikes or strokes, a finger presses the trigger, or somebody pulls, and the object is "
    f"to stay in the hand. The films run {SPEED:g} times as fast."
)


@dataclass(frozen=True)
class Demo:
    """Grasp a few objects as people do, and show it: a film and a page."""

    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    pick: tuple[str, ...] = ()
    """Grasps to show: an object ("mug"), object and task ("mug:drink") or a number; else a varied few."""
    count: int = 3
    """How many to show if none are picked."""
    from_image: Folder = None
    """Start from an image with depth of a person holding an object: the built-in one, or that of a folder
    with rgb.png, depth.png and K.json. It takes the place of --grasps, --objects, --pick and --count."""
    mesh: str | None = None
    """The object in the folder's image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]; a built-in one has its own."""
    task: str = ""
    """What the grasp in the folder's image is for: "drink", "hand over" ..."""
    policy: str | None = None
    """What moves the hand: "reference" (the planned motion, open loop) or a policy (`fungrasp policies
    list`). By default the freely licensed student of the hand, or "reference" if there is none."""
    refine: int = 8
    """Under the reference, try this many variations of a grasp in simulation until one holds; 0: only the
    grasp as it is. A learned policy chooses among candidates by itself, in simulated rollouts."""
    seed: int = 0
    """Seed of the variations."""
    out: Path = Path("demo")
    """Folder for the film and the page."""
    threads: int = 0
    """0 means all processors; the grasps do not depend on it."""

    def run(self) -> None:
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand

        self._check()
        hand = load_hand(self.hand)
        source = {"Policy": self._policy(hand)}
        if self.from_image is not None:
            self._run_from_image(hand, source)
            return
        everything = load_human_grasps(self.grasps)
        rows = chosen_rows(everything, self.pick, self.count)
        human = everything.select(rows)
        objects = load_objects(human, self.objects)
        source["Grasps"] = f"{self.grasps}, rows {', '.join(map(str, rows))}"
        self._show(human, objects, hand, TITLE, INTRODUCTION, source)

    def _run_from_image(self, hand: Hand, source: dict[str, str]) -> None:
        from fungrasp.cli.demo_from_image import image_title, image_words, seen_grasp, write_low_confidence

        assert self.from_image is not None
        with progress_bar("looking at the image", 1) as show:
            seen = seen_grasp(self.from_image, self.mesh, self.mass, self.task, self.seed)
            show(1)
        source["Image"] = seen.source
        for note in seen.perceived.notes:
            print(note)
        if not seen.perceived.confident:
            write_low_confidence(self.out / "index.html", seen, page_provenance(source, self.seed))
        human, objects = seen.perceived.grasps, seen.perceived.objects
        self._show(human, objects, hand, image_title(seen), image_words(seen), source, seen)

    def _show(
        self,
        human: HumanGraspSet,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        title: str,
        introduction: str,
        source: Mapping[str, str],
        seen: SeenGrasp | None = None,
    ) -> None:
        """Retarget and try grasps; write film and page."""
        from tempfile import TemporaryDirectory
        from time import perf_counter

        from fungrasp.evaluation import static_quality
        from fungrasp.report import Page, write_page
        from fungrasp.report.grasp_demo import grasp_report
        from fungrasp.retargeting import retarget

        start = perf_counter()
        self.out.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".demo.", dir=self.out) as name:
            folder = Path(name)
            with progress_bar("measuring the objects", len(objects)) as show:
                for done, model in enumerate(objects.values()):
                    _ = model.signed_distance
                    show(done + 1)
            robot = retarget(human, objects, hand, threads=self.threads)
            quality = static_quality(robot, human, objects, hand)
            result, trajectories, uses = self._tried(human, robot, objects, hand, folder)
            film, clips = self._film(trajectories, uses, human, objects, hand, folder)
            with progress_bar("drawing", len(human)) as show:
                opening = [] if seen is None else seen.opening()
                reports = []
                for row, trajectory in enumerate(trajectories):
                    thing = objects[trajectory.object_name]
                    reports.append(
                        grasp_report(
                            human[row], robot[row], hand, thing, trajectory, quality, result, row, *clips[row]
                        )
                    )
                    show(row + 1)
            made = page_provenance(source, self.seed, perf_counter() - start)
            page = Page(title, reports, hand.title, introduction, made)
            page_path = write_page(self.out / "index.html", page, opening)
        for report in reports:
            print(f"{report.title}: {' '.join(filter(None, (report.outcome, report.use_outcome)))}")
        print(f"film: {film}")
        print(f"page: {page_path}")

    def _check(self) -> None:
        from fungrasp.errors import FungraspError

        least = {"count": 1, "refine": 0, "seed": 0, "threads": 0}
        for name, value in least.items():
            if getattr(self, name) < value:
                raise FungraspError(f"--{name} must be at least {value}, not {getattr(self, name)}")
        if self.from_image is None:
            idle = {"--mesh": self.mesh, "--mass": self.mass, "--task": self.task}
            needs = "--from-image FOLDER"
        else:
            other = self.grasps if self.grasps != "builtin" else None
            idle = {"--grasps": other, "--objects": self.objects, "--pick": self.pick}
            needs = "grasps, not an image"
        for name, value in idle.items():
            if value:
                raise FungraspError(f"{name} needs {needs}")

    def _tried(
        self,
        human: HumanGraspSet,
        robot: RobotGraspSet,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        folder: Path,
    ) -> tuple[LiftTestResult, list[Trajectory], dict[int, Trajectory]]:
        """The outcome of each grasp, refined first, and what moved how: in the lift tests, and in the use
        tests by row."""
        from fungrasp.evaluation import LiftTestSpec, evaluate, replay
        from fungrasp.planning import MotionSettings
        from fungrasp.planning.selection import SelectionSettings
        from fungrasp.planning.selection.refinement import refine_grasps
        from fungrasp.policies import OpenLoopPolicy, make_planner

        policy = self._policy(hand)
        refined = bool(self.refine) and policy == REFERENCE
        if refined:
            with progress_bar("trying variations", len(robot)) as show:
                robot = refine_grasps(
                    robot,
                    objects,
                    hand,
                    OpenLoopPolicy(),
                    tries=self.refine,
                    seed=self.seed,
                    threads=self.threads,
                    progress=show,
                )
        selection = SelectionSettings.for_protocol("nominal", for_use=True)
        # Refined grasps are played as they were tried: with the squeeze for the lift alone.
        motions = MotionSettings(for_use=not refined)
        with progress_bar("lifting and using", 1.0) as show:
            result = evaluate(
                robot,
                objects,
                policy,
                spec=LiftTestSpec(use=True),
                human=human,
                planner=make_planner(policy, hand, objects, selection, threads=self.threads, motions=motions),
                threads=self.threads,
                record=folder / "episodes",
                progress=show,
            )
        episodes = [replay(file) for file in (folder / "episodes").iterdir()]
        episodes.sort(key=lambda episode: episode.index)
        lifts = [episode for episode in episodes if not episode.is_use_test]
        return result, lifts, {episode.index: episode for episode in episodes if episode.is_use_test}

    def _policy(self, hand: Hand) -> str:
        """The name of what moves the hand.

        Raises:
            FungraspError: there is no such policy.
        """
        from fungrasp.policies import default_policy, policy_files

        if self.policy is None:
            return default_policy(hand.name)
        policy_files(self.policy, hand.name)
        return self.policy

    def _film(
        self,
        lifts: Sequence[Trajectory],
        uses: Mapping[int, Trajectory],
        human: HumanGraspSet,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        folder: Path,
    ) -> tuple[Path, list[tuple[Path, Path | None]]]:
        """The whole film, and its parts for each grasp: lift, and use where the object was used."""
        from fungrasp.report import write_video
        from fungrasp.report.episode_film import episode_film, film_frames
        from fungrasp.report.grasp_demo import grasp_title

        clips: dict[tuple[int, bool], Path] = {}
        parts = [(row, False, lift) for row, lift in enumerate(lifts)]
        parts += [(row, True, use) for row, use in uses.items()]
        parts.sort(key=lambda part: part[:2])
        count = sum(film_frames(trajectory, FPS, SPEED) for *_, trajectory in parts)

        def frames() -> Iterator[np.ndarray]:
            done = 0
            for row, used, trajectory in parts:
                thing, clip = objects[trajectory.object_name], []
                for frame in episode_film(
                    trajectory,
                    hand,
                    thing,
                    fps=FPS,
                    speed=SPEED,
                    title=grasp_title(human[row]),
                    threads=self.threads,
                ):
                    clip.append(frame)
                    yield frame
                    done += 1
                    show(done)
                file = folder / f"{row}{'-use' if used else ''}.mp4"
                clips[row, used] = write_video(file, clip, FPS)

        with progress_bar("filming", count) as show:
            film = write_video(self.out / "film.mp4", frames(), FPS)
        return film, [(clips[row, False], clips.get((row, True))) for row in range(len(lifts))]


COMMAND = Demo


def chosen_rows(grasps: HumanGraspSet, picks: Sequence[str], count: int) -> list[int]:
    """Rows of the picked grasps; without picks, of the favourites, then of objects not shown yet.

    Args:
        grasps: N human grasps.
        picks: "object", "object:task" (the first of them) or a row number.
        count: how many if there are no picks.

    Raises:
        FungraspError: there is no such grasp, or one is picked twice.
    """
    from fungrasp.errors import FungraspError, UnknownNameError

    assert grasps.task is not None
    first: dict[str, int] = {}
    for row, (name, task) in enumerate(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True)):
        first.setdefault(name, row)
        first.setdefault(f"{name}:{task}", row)
    if not picks:
        others = [row for name, row in first.items() if ":" not in name]
        rows = [first[name] for name in FAVOURITES if name in first]
        shown = {grasps.object_name[row] for row in rows}
        rows += [row for row in others if grasps.object_name[row] not in shown]
        rows += sorted(set(range(len(grasps))) - set(rows))
        return rows[:count]
    rows = []
    for pick in picks:
        if pick not in first and pick.isdecimal():
            if int(pick) >= len(grasps):
                raise FungraspError(f"--pick {pick}: the grasps are numbered 0 to {len(grasps) - 1}")
            rows.append(int(pick))
        elif pick in first:
            rows.append(first[pick])
        else:
            raise UnknownNameError("grasp", pick, first)
    if len(set(rows)) < len(rows):
        raise FungraspError(f"--pick {' '.join(picks)}: grasp {max(rows, key=rows.count)} is picked twice")
    return rows
