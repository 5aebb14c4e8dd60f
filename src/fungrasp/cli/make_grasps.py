"""``fungrasp grasps make``: human grasps are synthesized."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import Answer, Answering, progress_bar, write_human_grasps
from fungrasp.cli.options import on_cluster, print_use
from fungrasp.core.errors import FungraspError, UnknownNameError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fungrasp.objects import ObjectModel
    from fungrasp.synthesis import GraspSpecification, SynthesisSettings


@dataclass(frozen=True)
class MakeGrasps(Answering):
    """Synthesize human grasps: those of the built-in objects again, or of any mesh."""

    out: Path
    """Grasp file to write (.npz). Finished parts lie in <out>.partial until all are done: the same command
    goes on where an interrupted one was."""
    objects: tuple[str, ...] = ()
    """Only grasps of these built-in objects."""
    mesh: Path | None = None
    """Make grasps of this mesh, or of a shape like box:60x28x30, instead: around the whole, from above, at
    handles and thin parts."""
    mass: float | None = None
    """Mass of the mesh's object [kg]."""
    parts: Path | None = None
    """JSON file of the mesh's parts to hold: {"handle": [[x, y, z], [x, y, z]]}, boxes in its frame [m]."""
    seed: tuple[int, ...] = (0,)
    """Seed of the random starts; with several, each grasp is sought with each, and those that differ are
    kept."""
    ray: tuple[str, ...] | None = None
    """Work on a Ray cluster: on that of this address ("auto": the one that this machine is part of), or on
    all processors of this machine where none is given. Same grasps."""

    def run(self) -> Answer:
        from fungrasp.core.jobs import PartStore
        from fungrasp.objects import is_plain_shape
        from fungrasp.synthesis import synthesize_grasps

        if not self.seed or len(set(self.seed)) < len(self.seed) or min(self.seed) < 0:
            raise FungraspError("--seed needs at least one number, none negative, and each once")
        specs, models, settings = self._specifications()
        sought, cluster = len(specs) * len(self.seed), on_cluster(self.ray)
        with PartStore.beside(self.out) as store:
            with progress_bar("synthesizing grasps", 1.0) as show:
                grasps = synthesize_grasps(
                    specs, self.seed, settings, models, store=store, ray=cluster, progress=show
                )
            answer = write_human_grasps(self.out, grasps)
        print_use(cluster)
        lines = [answer.text]
        if len(grasps) < sought:
            words = "could not be met" if len(self.seed) == 1 else "could not be met, or are like another"
            lines.append(f"left out: {sought - len(grasps)} of {sought} grasp specifications, which {words}")
        if self.mesh is not None:
            (name,) = models or {}
            folder = "" if is_plain_shape(name) else f" --objects {self.mesh.parent}"
            lines.append(f"use them with: --grasps {self.out}{folder}")
        return Answer({**answer.value, "left_out": sought - len(grasps)}, "\n".join(lines))

    def _specifications(
        self,
    ) -> tuple[Sequence[GraspSpecification], dict[str, ObjectModel] | None, SynthesisSettings]:
        """What to make, of which objects (None: built-in ones), and how."""
        from fungrasp.objects import is_plain_shape, load_object, object_from_file
        from fungrasp.synthesis import SynthesisSettings
        from fungrasp.synthesis.automatic_specifications import automatic_specifications, parts_from_boxes
        from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS

        if self.mesh is None:
            if self.mass is not None or self.parts is not None:
                raise FungraspError("--mass and --parts are those of a mesh: give --mesh too")
            known = {spec.object for spec in BUILTIN_SPECIFICATIONS}
            for name in self.objects:
                if name not in known:
                    raise UnknownNameError("object", name, sorted(known))
            some = [s for s in BUILTIN_SPECIFICATIONS if not self.objects or s.object in self.objects]
            return some, None, SynthesisSettings()
        shape = is_plain_shape(str(self.mesh)) and not self.mesh.is_file()
        model = load_object(str(self.mesh), self.mass) if shape else object_from_file(self.mesh, self.mass)
        if self.parts is not None:
            model = parts_from_boxes(model, self.parts)
        specs = automatic_specifications(model)
        if not specs:
            raise FungraspError(f"{self.mesh}: a hand can't reach around any part of it")
        return specs, {model.name: model}, SynthesisSettings(starts=3)
