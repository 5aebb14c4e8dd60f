"""Synthesis of any number of grasps, a batch of specifications at a time, so that an interrupted run goes on
where it was."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np

from fungrasp.files import digest
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.jobs import PartStore
from fungrasp.objects import ObjectModel
from fungrasp.synthesis import GraspSpecification, SynthesisSettings
from fungrasp.synthesis.grasp_candidates import GraspCandidates, join_candidates
from fungrasp.synthesis.synthesize import HAND, choose_grasps, solve_batch, specification_batches
from fungrasp.version import __version__


@dataclass(frozen=True)
class SynthesisPart:
    """Specifications that are solved together."""

    seed: int
    """Of the random starts."""
    specifications: tuple[GraspSpecification, ...]
    """One of ``specification_batches``."""


@dataclass(frozen=True, eq=False)
class Synthesis:
    """Grasps to be made, and how."""

    specifications: tuple[GraspSpecification, ...]
    """What to make."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    settings: SynthesisSettings
    """Of the solver, and what a good grasp is."""
    seeds: tuple[int, ...]
    """Each specification is solved with each."""

    @property
    def parts(self) -> list[SynthesisPart]:
        """All batches of all seeds."""
        batches = specification_batches(self.specifications)
        return [SynthesisPart(seed, tuple(batch)) for seed in self.seeds for batch in batches]

    def key(self, part: SynthesisPart) -> str:
        """Digest of all that the candidates of a part depend on."""
        hand = load_hand(HAND)
        models = [self.objects[name] for name in sorted({spec.object for spec in part.specifications})]
        return digest(
            __version__,
            hand.path.read_bytes(),
            hand.model_path.read_bytes(),
            [(model.digest, model.mass, digest(model.parts)) for model in models],
            self.settings,
            part,
        )

    def solve(self, part: SynthesisPart) -> dict[str, np.ndarray]:
        """Fields of the good ones of its ``GraspCandidates``."""
        s = self.settings
        found = solve_batch(part.specifications, self.objects, part.seed, s)
        good = found.good(s.max_penetration, s.max_cost)
        return {f.name: getattr(found, f.name)[good] for f in fields(GraspCandidates)}


def synthesize_in_parts(
    synthesis: Synthesis, store: PartStore, progress: Callable[[int], None] = lambda count: None
) -> HumanGraspSet:
    """Make grasps, all of the first seed before those of the next. No two are alike, whatever their seed.

    Args:
        synthesis: what to make.
        store: for finished parts, where there are several; the caller removes it.
        progress: called with the number of specifications that have just been worked on.

    Raises:
        FungraspError: none of the specifications can be met, or a part can't be written.
    """
    parts, batches = synthesis.parts, []
    for part in parts:
        key = synthesis.key(part)
        arrays = store.load(key)
        if arrays is None:
            arrays = synthesis.solve(part)
            if len(parts) > 1:
                store.save(key, arrays)
        batches.append(GraspCandidates(**arrays))
        progress(len(part.specifications))
    candidates = join_candidates(batches, [len(part.specifications) for part in parts])
    specs = synthesis.specifications * len(synthesis.seeds)
    return choose_grasps(candidates, specs, synthesis.settings, synthesis.objects)
