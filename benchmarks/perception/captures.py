"""``python -m benchmarks.perception captures``: perception on captures rendered for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import progress_bar, table, write_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from benchmarks.perception.kept_captures import KeptCaptures
    from benchmarks.perception.measurements import CaptureResult
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.objects import ObjectModel
    from fungrasp.perception import Capture
    from fungrasp.perception.hand.detected_hand import HandDetector
    from fungrasp.synthetic_captures.capture_scene import Label
    from fungrasp.synthetic_captures.render_capture import SyntheticCapture


@dataclass(frozen=True)
class BenchPerception:
    """Measure perception on rendered captures of human grasps: hand, object with and without its mask, all
    together, and against the targets.

    Rendered hands and objects say little about photographs. With --real, captures of a real camera are
    measured instead, and the other options but --json say nothing.
    """

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    only: tuple[str, ...] = ()
    """Names of the objects whose grasps are taken; all by default."""
    captures: int = 20
    """How many to render."""
    seed: int = 1000
    """Decides the captures; the project's settings were chosen on others."""
    keep: Path | None = None
    """Folder for the rendered captures; those that are there already are not rendered again."""
    proportions: float = 0.0
    """Standard deviation of the sizes of hands and of the lengths of their fingers, as a part."""
    coloured: bool = False
    """Give perception the colours of the mesh."""
    wrong: bool = False
    """Try another object's mesh on each capture, too: it must not be accepted."""
    absent: bool = False
    """Render each capture twice more, without the hand and without the object: neither must be found."""
    landmarks_noise: float | None = None
    """Leave the hand detector out: give the true joints' pixels, each shifted at random with this standard
    deviation [pixels of an image 640 wide]."""
    chain: bool = False
    """Retarget true and perceived grasps, and try both in simulation."""
    hand: str = "allegro"
    """Robot hand of --chain."""
    policy: tuple[str, ...] = ()
    """What moves it, see `fungrasp evaluate`; with several, each is tried. By default the freely licensed
    student of the hand, or "reference" if there is none."""
    hands: int = 1
    """Hands that perception is asked for, see `perceive --hands`; with --chain, one and all are compared."""
    threads: int = 0
    """Threads of --chain; 0 means all processors."""
    real: Path | None = None
    """Folder of real captures whose truth is known, one folder each: rgb.png, depth.png, K.json, mask.png,
    truth.json; docs/perceive.md says what is in them."""
    varied: bool = False
    """Render captures with the errors of real cameras, left hands, hands of other sizes, rings, watches,
    faces and hands of other people, and half as many images without a hand, into --keep; measure them like
    --real."""
    track: int = 0
    """Follow the object through so many images of its first grasp that moves, with sharp and with smoothed
    depth, instead of all else."""
    json: Path | None = None
    """Write the numbers here (.json). Given again after an interruption, the command goes on."""

    def run(self) -> None:
        from resource import RUSAGE_SELF, getrusage

        from benchmarks.perception.figures import capture_rows, perception_figures, target_rows
        from benchmarks.perception.kept_captures import KeptCaptures
        from fungrasp import __version__
        from fungrasp.files import digest
        from fungrasp.grasps import load_objects
        from fungrasp.provenance import machine

        if self.real is not None:
            from benchmarks.perception.recorded import bench_recorded

            bench_recorded(self.real, self.json)
            return
        human = self._grasps()
        if self.varied:
            self._varied(human)
            return
        if self.track:
            from benchmarks.perception.tracking import bench_tracking

            bench_tracking(human, load_objects(human, self.objects), self.track, self.json)
            return
        if self.chain:
            self._check_policies()
        objects = load_objects(human, self.objects)
        store = None
        if self.json is not None:
            what = (
                __version__,
                self.seed,
                self.coloured,
                self.wrong,
                self.absent,
                self.landmarks_noise,
                self.hands,
                self.proportions,
            )
            key = digest({name: getattr(human, name) for name in human.FIELDS}, *what)
            store = KeptCaptures(self.json.with_name(f"{self.json.name}.partial"), key)
        results = list(self._measured(human, objects, store))
        figures = perception_figures(results)
        # Kilobytes on Linux.
        figures["peak_memory_gb"] = getrusage(RUSAGE_SELF).ru_maxrss / 1e6
        if self.chain:
            figures["chain"] = self._chain(results, objects)
        about = {
            "grasps": Path(self.grasps).name,
            "objects": sorted(objects),
            "seed": self.seed,
            "coloured": self.coloured,
            "landmarks_noise": self.landmarks_noise,
            "hands": self.hands,
            "proportions": self.proportions,
            "machine": machine(),
        }
        if self.json is not None:
            write_json(self.json, about | figures | {"each": capture_rows(results)})
            if store is not None:
                store.remove()
        print(table([("", "measured", "target", "met"), *target_rows(figures)]))
        rows = [("stage", "median [s]", "longest [s]", "median CPU [s]")]
        for stage, seconds in figures["seconds"].items():
            median, longest, cpu = (f"{seconds[name]:.2f}" for name in ("median", "max", "median_cpu"))
            rows.append((stage.replace("_", " "), median, longest, cpu))
        print(table(rows))
        for words, part in (("with mask", "object_masked"), ("without mask", "object_unmasked")):
            pose = figures[part]
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
        print(f"{len(results)} captures of {len(objects)} objects, seed {self.seed}; {machine()}")

    def _varied(self, human: HumanGraspSet) -> None:
        """Render what is not there yet and measure it."""
        from benchmarks.perception.recorded import bench_recorded
        from benchmarks.perception.varied import render_varied
        from fungrasp.errors import FungraspError
        from fungrasp.grasps import load_objects

        if self.keep is None:
            raise FungraspError("--varied needs --keep FOLDER, where the captures go")
        render_varied(self.keep, human, load_objects(human, self.objects), self.captures, self.seed)
        bench_recorded(self.keep, self.json)

    def _grasps(self) -> HumanGraspSet:
        import numpy as np

        from fungrasp.errors import FungraspError, UnknownNameError
        from fungrasp.grasps import load_human_grasps

        if self.captures < 1 or self.seed < 0:
            raise FungraspError(
                f"--captures must be at least 1 and --seed not negative, not {self.captures} and {self.seed}"
            )
        if self.landmarks_noise is not None and (self.absent or not self.landmarks_noise >= 0):
            raise FungraspError("--landmarks-noise must not be negative, and does not go with --absent")
        human = load_human_grasps(self.grasps)
        names = np.unique(human.object_name).tolist()
        for name in self.only:
            if name not in names:
                raise UnknownNameError("object", name, names)
        return human.select(np.isin(human.object_name, self.only)) if self.only else human

    def _measured(
        self, human: HumanGraspSet, objects: Mapping[str, ObjectModel], store: KeptCaptures | None
    ) -> Iterator[CaptureResult]:
        from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector

        detector = MediaPipeHandDetector() if self.landmarks_noise is None else None
        with progress_bar("perceiving", self.captures) as show:
            for i in range(self.captures):
                result = None if store is None else store.load(i)
                if result is None:
                    result = self._one(i, human, objects, detector)
                    if store is not None:
                        store.save(i, result)
                yield result
                show(i + 1)

    def _one(
        self,
        index: int,
        human: HumanGraspSet,
        objects: Mapping[str, ObjectModel],
        detector: HandDetector | None,
    ) -> CaptureResult:
        """One measured capture. detector: None for the true joints with ``landmarks_noise``."""
        from dataclasses import replace

        import numpy as np

        from benchmarks.perception.measurements import measure_absent, measure_perception
        from benchmarks.perception.true_landmarks import TrueLandmarks
        from fungrasp.synthetic_captures.capture_files import painted_mesh
        from fungrasp.synthetic_captures.capture_scene import Label

        known = self._capture(index, human, objects)
        if detector is None:
            rng = np.random.default_rng([self.seed, index])
            lens = known.capture.intrinsics
            detector = TrueLandmarks(known.joints_camera, lens, self.landmarks_noise or 0.0, rng)
        model = objects[known.grasp.object_name]
        others = [name for name in sorted(objects) if name != model.name]
        other = objects[others[index % len(others)]] if self.wrong and others else None
        mesh = painted_mesh(known.painted) if self.coloured else None
        result = measure_perception(known, model, detector, other, mesh, self.hands)
        if not self.absent:
            return result
        no_hand = self._lacking(index, Label.HAND, human, objects)
        no_object = self._lacking(index, Label.OBJECT, human, objects)
        return replace(result, absent=measure_absent(no_hand, no_object, model, detector))

    def _lacking(
        self, index: int, part: Label, human: HumanGraspSet, objects: Mapping[str, ObjectModel]
    ) -> Capture:
        """The same capture without the hand or the object."""
        from fungrasp.synthetic_captures.capture_settings import CaptureSettings
        from fungrasp.synthetic_captures.render_capture import capture_at

        settings = CaptureSettings(missing=(part,), proportions=self.proportions)
        return capture_at(index, human, objects, self.seed, settings).capture

    def _capture(
        self, index: int, human: HumanGraspSet, objects: Mapping[str, ObjectModel]
    ) -> SyntheticCapture:
        """Read if it was kept, else rendered."""
        from fungrasp.synthetic_captures.capture_files import (
            TRUTH_FILE,
            read_synthetic_capture,
            write_capture,
        )
        from fungrasp.synthetic_captures.render_capture import CaptureSettings, capture_at

        kind = f"_{self.proportions:g}" if self.proportions else ""
        folder = None if self.keep is None else self.keep / f"{self.seed}{kind}_{index:04d}"
        if folder is not None and (folder / TRUTH_FILE).is_file():
            return read_synthetic_capture(folder)
        settings = CaptureSettings(proportions=self.proportions)
        known = capture_at(index, human, objects, self.seed, settings)
        if folder is not None:
            write_capture(known, folder)
        return known

    def _check_policies(self) -> None:
        from fungrasp.hands import load_hand
        from fungrasp.policies import policy_files

        hand = load_hand(self.hand)
        for policy in self.policy:
            policy_files(policy, hand.name).digests()

    def _chain(self, results: list[CaptureResult], objects: Mapping[str, ObjectModel]) -> dict[str, Any]:
        """Figures of the first policy, and of all of them by name where there are several."""
        import numpy as np

        from benchmarks.perception.figures import chain_figures, chain_sets
        from fungrasp.evaluation import evaluate
        from fungrasp.hands import load_hand
        from fungrasp.policies import default_policy
        from fungrasp.retargeting import retarget

        hand = load_hand(self.hand)
        true, perceived, rows = chain_sets(results, objects)
        several = chain_sets(results, objects, several=True)[1] if self.hands > 1 else None
        sets = [
            None if human is None else retarget(human, objects, hand, threads=self.threads)
            for human in (true, perceived, several)
        ]
        sure = np.array([result.sure for result in results])
        each = {}
        policies = self.policy or (default_policy(hand.name),)
        for policy in policies:
            success = []
            for words, robot in zip(("true grasps", "perceived grasps", "all hands"), sets, strict=True):
                if robot is None:
                    success.append(np.zeros(0, dtype=bool))
                    continue
                with progress_bar(f"{policy}, {words}", len(robot)) as show:
                    tried = evaluate(robot, objects, hand, policy, threads=self.threads, progress=show)
                success.append(tried.outcomes.success)
            each[policy] = chain_figures(success[0], success[1], rows, sure)
            if several is not None:
                each[policy]["all_hands"] = chain_figures(success[0], success[2], rows, sure)
        figures = {"hand": hand.name, "policy": policies[0]} | each[policies[0]]
        return figures if len(policies) == 1 else figures | {"policies": each}
