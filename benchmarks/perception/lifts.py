"""``python -m benchmarks.perception lifts``: from captures of known truth to lifts of the true object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar, table


@dataclass(frozen=True)
class Lifts:
    """Perceive the grasp of each capture whose truth is known, retarget it, and try it on the true object in
    its true place."""

    folder: Annotated[Path, tyro.conf.Positional]
    """One folder each, such as `varied` makes and `recorded` reads."""
    unknown: bool = False
    """Fit a box, cylinder or sphere to the object in place of its mesh."""
    first: int = 20
    """Captures that are tried, in the order of their names; 0 takes all."""
    told: str = "none"
    """What is said of the object's place: none, click or mask."""
    hand: str = "allegro"
    """Robot hand."""
    policy: str = "reference"
    """What moves it."""
    threads: int = 1
    """Of the simulation."""
    json: Path | None = None
    """Write the figures here."""

    def run(self) -> None:
        import numpy as np
        from scipy.spatial import KDTree

        from benchmarks.perception.measurements import rate_of
        from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
        from benchmarks.perception.recorded_figures import hinted_captures
        from fungrasp.core.errors import FungraspError
        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation import evaluate, write_result
        from fungrasp.geometry.poses import transform_points
        from fungrasp.grasps.human_hand import mirror_pose
        from fungrasp.hands import load_hand
        from fungrasp.objects import ResolvedObject, mirrored_object
        from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
        from fungrasp.perception.object_pose.pose_error import add_s
        from fungrasp.perception.pipeline import UNKNOWN, perceive
        from fungrasp.perception.scene.table import in_world, put_down
        from fungrasp.retargeting import retarget

        check_positive(threads=self.threads)
        folders = [path for path in recorded_folders(self.folder) if not path.name.endswith("no_hand")]
        folders = folders[: self.first or None]
        hand, detector = load_hand(self.hand), MediaPipeHandDetector(threads=1)
        rows: list[dict[str, Any]] = []
        with progress_bar("trying", max(len(folders), 1)) as show:
            for i, path in enumerate(folders):
                recorded = read_recorded(path)
                show(i + 1)
                if recorded.model is None or recorded.pose_camera_object is None:
                    continue
                row: dict[str, Any] = {
                    "capture": path.name,
                    "lifted": False,
                    "sure": False,
                    "add_s_mm": None,
                    "shape": "",
                    "why": "",
                }
                rows.append(row)
                try:
                    thing = UNKNOWN if self.unknown else ResolvedObject(recorded.model)
                    seen = perceive(hinted_captures(recorded)[self.told], thing, detector=detector)
                    robot = retarget(seen.grasps, seen.objects, hand, threads=self.threads)
                except FungraspError as error:
                    row["why"] = str(error)
                    continue
                row["sure"] = seen.confident
                if seen.fitted is not None:
                    row |= {"shape": seen.fitted.name, "explained": seen.fitted.quality}
                shape = transform_points(
                    seen.object.pose_camera_object, np.asarray(seen.object_model.mesh.sample(1000, seed=0))
                )
                surface = np.asarray(recorded.model.mesh.sample(1000, seed=0))
                surface = transform_points(recorded.pose_camera_object, surface)
                off = KDTree(shape).query(surface)[0].mean() + KDTree(surface).query(shape)[0].mean()
                row["surface_mm"] = 500 * float(off)
                if not self.unknown:
                    there = seen.object.pose_camera_object, recorded.pose_camera_object
                    points = np.asarray(recorded.model.mesh.sample(1000, seed=0))
                    row["add_s_mm"] = 1000 * float(add_s(points, *there))
                # The same grasp in the same world, with the true object in its true place.
                model = replace(recorded.model, name="true")
                pose = in_world(seen.pose_world_camera, recorded.pose_camera_object)
                rest = put_down(model, pose)
                if seen.hand.side == "left":
                    model, pose, rest = mirrored_object(model), mirror_pose(pose), mirror_pose(rest)
                robot = replace(
                    robot,
                    object_name=np.array([model.name]),
                    object_pose=pose[None],
                    object_rest_pose=rest[None],
                )
                tried = evaluate(robot, {model.name: model}, self.policy, threads=self.threads)
                row["lifted"] = bool(tried.outcomes.success[0])
        right = [row for row in rows if (row["add_s_mm"] or 99.0) < 10.0]
        figures = {
            "captures": len(rows),
            "unknown": self.unknown,
            "told": self.told,
            "hand": self.hand,
            "policy": self.policy,
            "lifted": rate_of([row["lifted"] for row in rows]),
            "lifted_of_sure": rate_of([row["lifted"] for row in rows if row["sure"]]),
            "lifted_of_right_poses": rate_of([row["lifted"] for row in right]),
            "sure": rate_of([row["sure"] for row in rows]),
        }
        head = ("capture", "shape", "explained", "surface [mm]", "sure", "lifted", "")
        print(
            table(
                [
                    head,
                    *(
                        (
                            row["capture"],
                            row["shape"],
                            f"{row.get('explained', 0):.2f}",
                            f"{row.get('surface_mm', float('nan')):.1f}",
                            "yes" if row["sure"] else "no",
                            "yes" if row["lifted"] else "no",
                            row["why"][:60],
                        )
                        for row in rows
                    ),
                ],
                left=(0, 1, 6),
            )
        )
        for name in ("lifted", "lifted_of_right_poses", "lifted_of_sure"):
            rate = figures[name]
            if rate is not None:
                print(f"{name.replace('_', ' ')}: {round(rate['rate'] * rate['count'])} of {rate['count']}")
        if self.json is not None:
            write_result(self.json, run_record(0) | figures, rows)
