"""``python -m benchmarks.perception captures``: perception on captures rendered for it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.command import check_positive
from benchmarks.perception.capture_job import CaptureJob, CaptureTrial, MeasuredCapture
from fungrasp.cli.console import progress_bar, table, write_json

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet


@dataclass(frozen=True)
class Captures:
    """Measure perception on rendered captures of human grasps: hand, object with and without its mask, all
    together, and against the targets. Rendered hands and objects say little about photographs.
    """

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    only: tuple[str, ...] = ()
    """Names of the objects whose grasps are taken; all by default."""
    captures: int = 20
    """How many to render."""
    keep: Path | None = None
    """Folder for the rendered captures; those that are there already are not rendered again."""
    trial: CaptureTrial = field(default_factory=CaptureTrial)
    """What is rendered and measured; the project's settings were chosen on captures of other seeds."""
    chain: bool = False
    """Retarget true and perceived grasps, and try both in simulation."""
    hand: str = "allegro"
    """Robot hand of --chain."""
    policy: tuple[str, ...] = ()
    """What moves it, see `fungrasp evaluate`; with several, each is tried. By default the freely licensed
    student of the hand, or "reference" if there is none."""
    threads: int = 0
    """Threads of --chain; 0 means all processors."""
    json: Path | None = None
    """Write the numbers here (.json). Given again after an interruption, the command goes on."""

    def run(self) -> None:
        from resource import RUSAGE_SELF, getrusage

        from benchmarks.perception.figures import capture_rows, perception_figures
        from fungrasp.grasps import load_objects
        from fungrasp.jobs import PartStore, run_job
        from fungrasp.provenance import machine

        human = self._grasps()
        if self.chain:
            self._check_policies()
        objects = load_objects(human, self.objects)
        job = CaptureJob(human, objects, self.trial, self.captures, self.keep)
        store = None if self.json is None else PartStore.beside(self.json)
        with progress_bar("perceiving", self.captures) as show:
            measured = [MeasuredCapture.from_arrays(part) for part in run_job(job, store, progress=show)]
        results = [one.result for one in measured]
        figures = perception_figures(results)
        # Kilobytes on Linux.
        figures["peak_memory_gb"] = getrusage(RUSAGE_SELF).ru_maxrss / 1e6
        if self.chain:
            from benchmarks.perception.chain import run_chain
            from fungrasp.hands import load_hand
            from fungrasp.policies import default_policy

            hand = load_hand(self.hand)
            policies = self.policy or (default_policy(hand.name),)
            figures["chain"] = run_chain(measured, objects, hand, policies, self.threads)
        if self.json is not None:
            about = {"grasps": Path(self.grasps).name, "objects": sorted(objects), **asdict(self.trial)}
            about |= {"machine": machine()}
            write_json(self.json, about | figures | {"each": capture_rows(results)})
            if store is not None:
                store.remove()
        _print(figures)
        print(f"{len(results)} captures of {len(objects)} objects, seed {self.trial.seed}; {machine()}")

    def _grasps(self) -> HumanGraspSet:
        import numpy as np

        from fungrasp.errors import FungraspError, UnknownNameError
        from fungrasp.grasps import load_human_grasps

        check_positive(captures=self.captures)
        trial = self.trial
        if trial.seed < 0:
            raise FungraspError(f"--seed must not be negative, not {trial.seed}")
        if trial.landmarks_noise is not None and (trial.absent or not trial.landmarks_noise >= 0):
            raise FungraspError("--landmarks-noise must not be negative, and does not go with --absent")
        human = load_human_grasps(self.grasps)
        names = np.unique(human.object_name).tolist()
        for name in self.only:
            if name not in names:
                raise UnknownNameError("object", name, names)
        return human.select(np.isin(human.object_name, self.only)) if self.only else human

    def _check_policies(self) -> None:
        from fungrasp.hands import load_hand
        from fungrasp.policies import policy_files

        hand = load_hand(self.hand)
        for policy in self.policy:
            policy_files(policy, hand.name).digests()


def _print(figures: dict[str, Any]) -> None:
    from benchmarks.perception.figures import target_rows

    print(table([("", "measured", "target", "met"), *target_rows(figures)]))
    rows = [("stage", "median [s]", "longest [s]", "median CPU [s]")]
    for stage, seconds in figures["seconds"].items():
        median, longest, cpu = (f"{seconds[name]:.2f}" for name in ("median", "max", "median_cpu"))
        rows.append((stage.replace("_", " "), median, longest, cpu))
    print(table(rows))
    for words, part in (("with mask", "object_masked"), ("without mask", "object_unmasked")):
        pose = figures[part]
        if pose["rotation_deg"] is None:
            continue
        print(
            f"object {words}: rotation {pose['rotation_deg']['median']:.1f} deg in the median, "
            f"{pose['rotation_deg']['p90']:.1f} in 90 % of captures; "
            f"{pose['accepted']['rate']:.0%} accepted"
        )
    for words, part, what in (
        ("wrong meshes accepted", "wrong_mesh", "accepted"),
        ("hands seen where there is none", "no_hand", "sure"),
        ("objects seen where there is none", "no_object", "accepted"),
    ):
        if figures[part][what] is not None:
            print(f"{words}: {figures[part][what]['rate']:.1%}")
