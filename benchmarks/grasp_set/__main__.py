"""``python -m benchmarks.grasp_set``: make the set of human grasps on which variants are compared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.command import check_positive, main


@dataclass(frozen=True)
class MakeGraspSet:
    """Make human grasps of many objects, in three parts that share no object: train, validation, test.

    The objects are the built-in ones in random sizes and masses, shapes of random dimensions of the kinds
    that are hard to hold (flat, heavy, thin, round, with a handle), and meshes of the YCB set where they are
    given. Given again, the command goes on where it was interrupted."""

    out: Path
    """Folder to write: train.npz, validation.npz, test.npz, objects/<name>.obj, set.json."""
    objects: Path | None = None
    """Folder of meshes of the YCB set, 002_master_chef_can.obj and so on; without it they are left out."""
    dexycb: Path | None = None
    """File of grasps of DexYCB, as 'fungrasp grasps import dexycb' writes it: one more stratum, on the meshes
    of --objects."""
    sizes: int = 3
    """Sizes of each built-in object."""
    shapes: int = 6
    """Objects of each family of drawn shapes."""
    count: int = 8
    """Largest number of grasps of an object; of a YCB mesh twice as many."""
    seed: int = 0
    """Of everything that is random."""

    def run(self) -> None:
        from time import process_time

        import numpy as np

        from benchmarks.grasp_set.generation import made_grasps
        from benchmarks.grasp_set.objects import (
            MASSES,
            builtin_objects,
            drawn_objects,
            written_meshes,
            ycb_objects,
        )
        from benchmarks.grasp_set.parts import OBJECTS, save_set, split_objects
        from fungrasp.cli.console import progress_bar
        from fungrasp.core.errors import FungraspError
        from fungrasp.core.jobs import PartStore
        from fungrasp.core.provenance import run_record
        from fungrasp.grasps import HumanGraspSet, load_human_grasps

        check_positive(sizes=self.sizes, shapes=self.shapes, count=self.count)
        if self.dexycb is not None and self.objects is None:
            raise FungraspError("--dexycb needs the meshes of its objects: give --objects too")
        shown = None if self.dexycb is None else load_human_grasps(self.dexycb)
        masses = dict(MASSES)
        if shown is not None:
            masses |= dict(zip(shown.object_name.tolist(), shown.object_mass.tolist(), strict=True))
        given = [] if self.objects is None else ycb_objects(self.objects, masses)
        made = [*builtin_objects(self.sizes, self.seed), *drawn_objects(self.shapes, self.seed)]
        things = [*made, *given]
        start = process_time()
        with PartStore.beside(self.out / "grasps") as store, progress_bar("making grasps", 1.0) as show:
            things = written_meshes(things, self.out / OBJECTS)
            grasps = made_grasps(things, self.count, self.seed, store, show)
            kind = {obj.model.name: obj.stratum for obj in things}
            stratum = np.array([kind[name] for name in grasps.object_name.tolist()])
            if shown is not None:
                known = shown.select(np.isin(shown.object_name, list(kind)))
                grasps = HumanGraspSet.concatenate([grasps, known])
                stratum = np.append(stratum, ["dexycb"] * len(known))
            parts = split_objects(
                [(obj.stratum, obj.family) for obj in things],
                [obj.model.name for obj in things],
                self.seed,
            )
            save_set(self.out, grasps, stratum, parts, run_record(self.seed))
        seconds = process_time() - start
        print(f"{self.out}: {_counts(grasps.object_name.tolist(), stratum.tolist(), parts)}")
        print(f"{seconds:.0f} s of a processor for {len(grasps)} grasps of {len(things)} objects")


def _counts(names: list[str], strata: list[str], parts: dict[str, str]) -> str:
    """Grasps and objects of each stratum and part, as a table."""
    from benchmarks.grasp_set.parts import PARTS
    from fungrasp.cli.console import table

    rows = [("grasps (objects)", *PARTS)]
    for stratum in [*sorted(set(strata)), "all"]:
        cells = []
        for part in PARTS:
            some = [
                name
                for name, kind in zip(names, strata, strict=True)
                if parts[name] == part and stratum in (kind, "all")
            ]
            cells.append(f"{len(some)} ({len(set(some))})")
        rows.append((stratum, *cells))
    return "\n" + table(rows)


COMMAND = MakeGraspSet


if __name__ == "__main__":
    main("grasp_set", COMMAND)
