"""``python -m benchmarks.twins``: grasps on twins, for Tables VI and II of the paper."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.command import main
from benchmarks.twins.twin_series import TwinSeriesSpec


@dataclass(frozen=True)
class EvaluateOnTwins:
    """Try grasps on twins, without a clock: what identification and gravity compensation are worth."""

    out: Path
    """Result to write, .json; it is written anew after every episode. What is finished is kept in the folder
    OUT.partial until all is done: the same command goes on where it was stopped."""
    spec: TwinSeriesSpec = field(default_factory=TwinSeriesSpec)
    """What is asked."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    rows: tuple[int, ...] = ()
    """Rows of the grasps; all if none are given."""
    images_per_grasp: int = 0
    """Try what perception sees in so many rendered images of each grasp in place of the grasp itself (Table
    II of the paper). Rows of the result are then numbered row times images plus image."""
    image_seed: int = 0
    """Of the images."""
    threads: int = 0
    """Of planning; 0 means all processors."""

    def run(self) -> None:
        from benchmarks.synthetic_captures.perceived_grasps import PerceivedGrasps
        from benchmarks.twins.twin_series import KnownGrasps, evaluate_on_twins
        from fungrasp.core.jobs import PartStore
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.retargeting import retarget
        from fungrasp.robots.cell import load_cell

        self.spec.check()
        hand = load_hand(load_cell(self.spec.cell).hand)
        human = load_human_grasps(self.grasps)
        numbers = list(self.rows) or list(range(len(human)))
        human = human.select(numbers)
        objects = load_objects(human, self.objects)
        count = self.images_per_grasp
        if count:
            store = PartStore.beside(self.out)
            source = PerceivedGrasps(
                human, objects, hand, count, self.image_seed, store, numbers, self.threads
            )
        else:
            source = KnownGrasps(retarget(human, objects, hand, threads=self.threads), numbers)
        about = {"grasps": self.grasps}
        result = evaluate_on_twins(self.spec, self.out, source, objects, about, self.threads)
        print(result.table())
        if isinstance(source, PerceivedGrasps):
            print(
                f"{source.about['images']} images: {len(source.refused)} refused; of the others "
                f"{len(result.out_of_reach)} were found out of reach, {len(result.reached)} tried"
            )


if __name__ == "__main__":
    main("twins", EvaluateOnTwins)
