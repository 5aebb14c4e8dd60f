"""Rendered captures, each measured as a part of long work that can be interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from benchmarks.perception.capture_files import (
    TRUTH_FILE,
    painted_mesh,
    read_synthetic_capture,
    write_capture,
)
from benchmarks.perception.measurements import CaptureResult, measure_absent, measure_perception
from benchmarks.perception.true_landmarks import TrueLandmarks
from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.render_capture import SyntheticCapture, capture_at
from fungrasp.formats.record_json import record_from_json
from fungrasp.grasps import HumanGraspSet
from fungrasp.jobs import Arrays, Job, part_key
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture
from fungrasp.perception.hand.detected_hand import HandDetector


@dataclass(frozen=True, eq=False)
class MeasuredCapture:
    """A capture's numbers, and grasps to be tried."""

    result: CaptureResult
    """The numbers."""
    true: HumanGraspSet
    """The one true grasp."""
    perceived: HumanGraspSet | None
    """The grasp that ``perceive`` gave, in a world of its own; None where there is none that could be
    tried."""

    def arrays(self) -> Arrays:
        """To be kept in a file."""
        found = {"result": np.array(json.dumps(asdict(self.result)))}
        for kind, grasps in (("true", self.true), ("perceived", self.perceived)):
            if grasps is not None:
                values = {name: getattr(grasps, name) for name in grasps.FIELDS}
                found |= {f"{kind}.{name}": value for name, value in values.items() if value is not None}
        return found

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """What ``arrays`` gave."""

        def grasps(kind: str) -> HumanGraspSet:
            given = {
                name: arrays[f"{kind}.{name}"] for name in HumanGraspSet.FIELDS if f"{kind}.{name}" in arrays
            }
            return HumanGraspSet(**given)

        result = record_from_json(CaptureResult, json.loads(str(arrays["result"])), "a finished part")
        return cls(result, grasps("true"), grasps("perceived") if "perceived.object_name" in arrays else None)


@dataclass(frozen=True)
class CaptureTrial:
    """What is rendered and measured."""

    seed: int = 1000
    """Decides the captures."""
    proportions: float = 0.0
    """Standard deviation of the sizes of hands and of the lengths of their fingers, as a part."""
    colored: bool = False
    """Whether perception knows the colors of the mesh."""
    wrong: bool = False
    """Whether another object's mesh is tried on each capture."""
    absent: bool = False
    """Whether each capture is tried without its hand and without its object."""
    landmarks_noise: float | None = None
    """Standard deviation of the true landmarks that are given in place of a detector's [pixels of an image
    640 wide]."""


@dataclass(frozen=True, eq=False)
class CaptureJob(Job[int]):
    """Captures rendered of human grasps, and measured; a part is the number of a capture."""

    human: HumanGraspSet
    """Grasps that are shown."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    trial: CaptureTrial
    """What is measured."""
    count: int
    """Captures."""
    keep: Path | None = None
    """Folder for the rendered captures; those that are there already are not rendered again."""

    def parts(self) -> list[int]:
        return list(range(self.count))

    def key(self, part: int) -> str:
        return part_key(self.human, dict(self.objects), self.trial, part)

    def run(self, parts: Sequence[int], progress: Callable[[float], None]) -> list[Arrays]:
        return [self._measured(part).arrays() for part in parts]

    @cached_property
    def _detector(self) -> HandDetector:
        from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector

        return MediaPipeHandDetector()

    def _measured(self, index: int) -> MeasuredCapture:
        trial, known = self.trial, self._capture(index)
        if trial.landmarks_noise is None:
            detector = self._detector
        else:
            rng, lens = np.random.default_rng([trial.seed, index]), known.capture.intrinsics
            detector = TrueLandmarks(known.joints_camera, lens, trial.landmarks_noise, rng)
        model = self.objects[known.grasp.object_name]
        others = [name for name in sorted(self.objects) if name != model.name]
        other = self.objects[others[index % len(others)]] if trial.wrong and others else None
        mesh = painted_mesh(known.painted) if trial.colored else None
        absent = None
        if trial.absent:
            no_hand, no_object = (self._lacking(index, part) for part in (Label.HAND, Label.OBJECT))
            absent = measure_absent(no_hand, no_object, model, detector)
        result, perceived = measure_perception(known, model, detector, other, mesh, absent)
        return MeasuredCapture(result, HumanGraspSet.of([known.grasp]), perceived)

    def _lacking(self, index: int, part: Label) -> Capture:
        """The same capture without the hand or the object."""
        settings = CaptureSettings(missing=(part,), proportions=self.trial.proportions)
        return capture_at(index, self.human, self.objects, self.trial.seed, settings).capture

    def _capture(self, index: int) -> SyntheticCapture:
        """Read if it was kept, else rendered."""
        trial = self.trial
        kind = f"_{trial.proportions:g}" if trial.proportions else ""
        folder = None if self.keep is None else self.keep / f"{trial.seed}{kind}_{index:04d}"
        if folder is not None and (folder / TRUTH_FILE).is_file():
            return read_synthetic_capture(folder)
        settings = CaptureSettings(proportions=trial.proportions)
        known = capture_at(index, self.human, self.objects, trial.seed, settings)
        if folder is not None:
            write_capture(known, folder)
        return known
