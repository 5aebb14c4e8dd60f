"""Synthesis of any number of grasps as a job: its parts are batches of specifications.

from fungrasp.synthesis import GraspSpecification, synthesize_grasps

spec = GraspSpecification("can", "drink", "body", "wrap", at=(0, 0, 0), palm=(0, 1, 0), fingers=(1, 0, 0))
grasps = synthesize_grasps([spec], seed=0)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.synthesis.grasp_candidates import GraspCandidates, join_candidates
from fungrasp.synthesis.grasp_specification import GraspSpecification
from fungrasp.synthesis.synthesize import (
    HAND,
    SynthesisSettings,
    choose_grasps,
    solve_batch,
    specification_batches,
    specified_objects,
)


@dataclass(frozen=True)
class SpecificationBatch:
    """Specifications that are solved together."""

    seed: int
    """Of the random starts."""
    specifications: tuple[GraspSpecification, ...]
    """One of ``specification_batches``."""


@dataclass(frozen=True, eq=False)
class Synthesis(Job[SpecificationBatch]):
    """Grasps to be made, and how."""

    specifications: tuple[GraspSpecification, ...]
    """What to make."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    settings: SynthesisSettings
    """Of the solver, and what a good grasp is."""
    seeds: tuple[int, ...]
    """Each specification is solved with each."""

    def parts(self) -> list[SpecificationBatch]:
        """All batches of all seeds."""
        batches = specification_batches(self.specifications)
        return [SpecificationBatch(seed, tuple(batch)) for seed in self.seeds for batch in batches]

    def key(self, part: SpecificationBatch) -> str:
        """Digest of all that the candidates depend on."""
        objects = {spec.object: self.objects[spec.object] for spec in part.specifications}
        return part_key("synthesis", load_hand(HAND), objects, self.settings, part)

    def size(self, part: SpecificationBatch) -> float:
        """Number of specifications."""
        return len(part.specifications)

    def run(self, parts: Sequence[SpecificationBatch], progress: Callable[[float], None]) -> list[Arrays]:
        """Fields of the good ones of each part's ``GraspCandidates``."""
        s, results = self.settings, []
        for part in parts:
            found = solve_batch(part.specifications, self.objects, part.seed, s)
            good = found.good(s.max_penetration, s.max_cost)
            results.append({f.name: getattr(found, f.name)[good] for f in fields(GraspCandidates)})
        return results


def synthesize_grasps(
    specs: Sequence[GraspSpecification],
    seed: int | Sequence[int] = 0,
    settings: SynthesisSettings | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
    *,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> HumanGraspSet:
    """Make human grasps of objects at rest on the table; those that cannot be met are left out.

    Every grasp has bones of exactly the human hand's lengths, joints within its limits, no more than 2 mm of
    penetration, nothing below the table, and its links on their parts; no two are alike, whatever their seed.

    Args:
        specs: what to make. The grasps keep their order, all of the first seed before those of the next.
        seed: of the random starts, or several: each specification is solved with each. The same
            specifications and seeds give the same grasps.
        settings: the defaults if None.
        objects: by name; built-in ones that are not in it are found by themselves.
        store: keeps finished parts, and knows those of an interrupted run; who calls removes it.
        ray: solves the parts on a cluster. The result is the same.
        progress: called with the share that is done, 0 to 1.

    Raises:
        FungraspError: an object or part does not exist, none of the specifications can be met, or a part
            can't be written.
    """
    seeds = (seed,) if isinstance(seed, int) else tuple(seed)
    models, settings = specified_objects(specs, objects), settings or SynthesisSettings()
    job = Synthesis(tuple(specs), models, settings, seeds)
    batches = [GraspCandidates(**arrays) for arrays in run_job(job, store, ray=ray, progress=progress)]
    candidates = join_candidates(batches, [len(part.specifications) for part in job.parts()])
    return choose_grasps(candidates, job.specifications * len(seeds), settings, models)
