"""``fungrasp retarget``: human grasps become grasps of a robot hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar, table, write_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.objects import ObjectModel


QUALITY_UNITS = ("mm", "deg", "rad")
"""Units at the end of the names of quality numbers."""

DRAWN_GRASPS = 12
"""Largest number of grasps in a picture."""

WIDTH, HEIGHT = 400, 320
"""Size of each grasp in a picture [pixels]."""


@dataclass(frozen=True)
class Retarget:
    """Turn human grasps into grasps of a robot hand, and measure how good they are."""

    out: Path
    """Grasp file to write (.npz). Of many grasps, finished parts lie in <out>.parts until all are done: the
    same command goes on where an interrupted one was."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    mirror: bool = False
    """Mirror the grasps and their objects first: grasps of right hands for a left hand, or the other way
    round. Mirrored objects are named <name>_mirrored."""
    method: str = "ours"
    """Retargeting method: ours, angle-copy or dexgraspnet."""
    quality: Path | None = None
    """Write a summary of the quality of the grasps here (.json)."""
    picture: Path | None = None
    """Draw some of the grasps, human and robot side by side, to this PNG file."""
    threads: int = 0
    """Number of threads, 0 for all processors; the result does not depend on it."""
    ray: tuple[str, ...] | None = None
    """Work on a Ray cluster: on that of this address ("auto": the one that this machine is part of), or on
    all processors of this machine where none is given. Same grasps."""

    def run(self) -> None:
        from fungrasp.cli.on_cluster import retarget_on_cluster
        from fungrasp.evaluation.results import finite
        from fungrasp.evaluation.retarget_in_parts import remove_parts, retarget_in_parts
        from fungrasp.grasps import load_human_grasps, load_objects, mirrored_grasps, save_robot_grasps
        from fungrasp.grasps.alternatives import alternative_rows, join_alternatives
        from fungrasp.hands import load_hand
        from fungrasp.hands.self_contacts import self_contact_words

        hand = load_hand(self.hand)
        human = load_human_grasps(self.grasps)
        if self.mirror:
            human = mirrored_grasps(human)
        objects = load_objects(human, self.objects)
        for model in objects.values():
            _ = model.signed_distance
        parts, done = self.out.with_name(f"{self.out.name}.parts"), 0
        if self.ray is not None:
            retarget_on_cluster(self, human, objects, hand, parts)
        with progress_bar(f"retargeting to {hand.name} ({self.method})", len(human)) as show:

            def finished(count: int) -> None:
                nonlocal done
                done += count
                show(done)

            result = retarget_in_parts(human, objects, hand, self.method, self.threads, parts, finished)
        robot, quality = result.robot, result.quality
        if human.probability is not None:
            robot = join_alternatives(robot, human.probability)
        save_robot_grasps(self.out, robot)
        touching = self_contact_words(hand.model, robot.joint_positions)
        remove_parts(parts)
        rate = result.solved / max(result.seconds, 1e-9)
        if self.quality is not None:
            numbers = {"grasps_per_second": rate, "self_penetration_reasons": touching}
            write_json(self.quality, finite(quality.summary()) | numbers)
        if self.picture is not None:
            shown = human
            if human.probability is not None:
                shown = human.select([int(rows[0]) for rows in alternative_rows(human.probability)])
            draw_grasps(self.picture, robot, objects, hand, shown)
        print(static_quality_table(quality.summary()))
        for words in touching:
            print(f"warning: {words}")
        print(f"{self.out}: {len(robot)} grasps of {len(objects)} objects, {rate:.0f} grasps/s")


COMMAND = Retarget


def retargeted(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand, method: str, threads: int
) -> tuple[RobotGraspSet, float]:
    """Robot grasps, and how many a second were solved; with a progress bar."""
    from threading import Lock
    from time import perf_counter

    from fungrasp.grasps.alternatives import join_alternatives
    from fungrasp.retargeting import retarget

    for model in objects.values():
        _ = model.signed_distance
    done, lock = 0, Lock()
    with progress_bar(f"retargeting to {hand.name} ({method})", len(human)) as show:

        def finished(count: int) -> None:
            nonlocal done
            with lock:
                done += count
                show(done)

        start = perf_counter()
        robot = retarget(human, objects, hand, method, threads=threads, progress=finished)
        if human.probability is not None:
            robot = join_alternatives(robot, human.probability)
        return robot, len(human) / (perf_counter() - start)


def static_quality_table(summary: Mapping[str, Mapping[str, float]]) -> str:
    """``StaticQuality.summary`` as a table of text."""
    rows: list[tuple[str, ...]] = [("quality", "mean", "p95", "max", "unit")]
    for name, numbers in summary.items():
        what, _, unit = name.rpartition("_")
        if unit not in QUALITY_UNITS:
            what, unit = name, ""
        rows.append((what.replace("_", " "), *(f"{numbers[k]:.2f}" for k in ("mean", "p95", "max")), unit))
    return table(rows)


def draw_grasps(
    path: Path,
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    human: HumanGraspSet | None = None,
    captions: Sequence[str] | None = None,
) -> None:
    """A sheet of grasps spread over the set, of different objects where there are as many.

    Args:
        path: of the PNG file.
        robot: N grasps of ``hand``.
        objects: by name.
        hand: the robot hand.
        human: the N grasps they imitate, drawn to their left.
        captions: text for each grasp after the name of its object.
    """
    import numpy as np
    from PIL import Image

    from fungrasp.files import atomic_path
    from fungrasp.rendering import human_grasp_scene, robot_grasp_scene
    from fungrasp.rendering.render import render
    from fungrasp.rendering.viewpoints import look_at_grasp
    from fungrasp.report.pictures import grid

    _, first = np.unique(robot.object_name, return_index=True)
    others = np.setdiff1d(np.arange(len(robot)), first)
    rows = np.concatenate([first, others])[:DRAWN_GRASPS]
    images, labels = [], []
    with progress_bar("drawing", len(rows)) as show:
        for done, row in enumerate(rows.tolist()):
            thing = objects[str(robot.object_name[row])]
            shape = (thing.vertices, thing.faces, robot.object_pose[row], robot.link_contacts[row])
            model, qpos = robot_grasp_scene(hand, robot.wrist_pose[row], robot.joint_positions[row], *shape)
            camera = look_at_grasp(model, qpos, width=WIDTH, height=HEIGHT)
            caption = (
                f"{thing.name}: {captions[row]}" if captions is not None else f"{thing.name}: {hand.name}"
            )
            if human is not None:
                shape = (thing.vertices, thing.faces, human.object_pose[row], human.link_contacts[row])
                person = human_grasp_scene(human.hand_joints[row], *shape)
                images += [render(person, person.qpos0, camera)[0]]
                labels += [f"{thing.name}: human"]
            images += [render(model, qpos, camera)[0]]
            labels += [caption]
            show(done + 1)
    with atomic_path(path) as temporary:
        Image.fromarray(grid(images, labels, columns=4)).save(temporary, format="PNG")
