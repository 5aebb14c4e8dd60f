"""``python -m benchmarks.twins``: grasps on twins, for Tables VI and II of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class EvaluateOnTwins:
    """Try grasps on twins, without a clock: what identification and gravity compensation are worth."""

    out: Path
    """Result to write, .json; it is written anew after every episode. What is finished is kept in the folder
    OUT.partial until all is done: the same command goes on where it was stopped."""
    robot: str = "ur5e-allegro"
    """A cell that is a twin."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    rows: tuple[int, ...] = ()
    """Rows of the grasps; all if none are given."""
    grasps_per_object: int | None = None
    """Of each object the first so many grasps that the arm can reach; all if not given."""
    images_per_grasp: int = 0
    """Try what perception sees in so many rendered images of each grasp in place of the grasp itself (Table
    II of the paper). Rows of the result are then numbered row times images plus image."""
    image_seed: int = 0
    """Of the images."""
    twins: tuple[int, ...] = (0, 1, 2)
    """Which twins."""
    in_turn: bool = False
    """Each grasp on one of the twins, in turn, in place of all."""
    placements: int = 1
    """Placements of the object in which each grasp is tried."""
    variants: tuple[str, ...] = ("no identification", "no gravity compensation", "full")
    """Ways to deploy: "no identification", "no gravity compensation", "full", "full, two attempts" (of a
    student)."""
    policy: str = "plan"
    """What acts."""
    given_dynamics: bool = False
    """Give the dynamics of the twins' hands in place of identifying them: what identification could give."""
    threads: int = 0
    """Of planning; 0 means all processors."""

    def run(self) -> None:
        from benchmarks.synthetic_captures.perceived_grasps import PerceivedGrasps
        from benchmarks.twins.twin_series import TwinSeriesSpec, evaluate_on_twins
        from fungrasp.core.jobs import PartStore
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import retarget
        from fungrasp.robots.cell import load_cell

        spec = TwinSeriesSpec(
            self.robot,
            self.policy,
            self.variants,
            self.twins,
            in_turn=self.in_turn,
            placements=self.placements,
            grasps_per_object=self.grasps_per_object,
            given_dynamics=self.given_dynamics,
        )
        hand = load_hand(load_cell(self.robot).hand)
        human = load_human_grasps(self.grasps)
        numbers = list(self.rows) or list(range(len(human)))
        human = human.select(numbers)
        objects = load_objects(human, self.objects)
        images = None
        if self.images_per_grasp:
            images = PerceivedGrasps(
                human,
                objects,
                hand,
                self.images_per_grasp,
                self.image_seed,
                PartStore.beside(self.out),
                numbers,
                self.threads,
            )
        result = evaluate_on_twins(
            spec,
            self.out,
            images or retarget(human, objects, hand, threads=self.threads),
            objects,
            numbers=numbers,
            about={"grasps": self.grasps},
            threads=self.threads,
        )
        print(result.table())
        if images is not None:
            print(
                f"{images.about['images']} images: {len(images.refused)} refused; of the others "
                f"{len(result.out_of_reach)} were found out of reach, {len(result.reached)} tried"
            )
