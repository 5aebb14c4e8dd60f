"""What a variant makes of the grasps: lifted or not, and how like the person's.

``python -m benchmarks.choose.measurement`` measures with the package of another checkout, and keeps the parts
where the comparison finds them.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import fungrasp
from benchmarks.choose.variant import Variant
from benchmarks.grasp_set.parts import SetPart, load_part
from benchmarks.peers.comparison import PEERS
from benchmarks.peers.problem import PeerProblem
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, part_key, run_job
from fungrasp.evaluation import evaluate
from fungrasp.evaluation.grasp_quality import static_quality
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import make_planner
from fungrasp.retargeting import METHODS, retarget

ROOT = Path(__file__).resolve().parents[2]

OBJECTS_TOGETHER = 8
"""Objects whose grasps are measured together: a simulation of all would be slow, and much would be lost where
it is interrupted."""

OUTCOMES = ("success", "contact_ratio", "pushed_m", "sim_distance_hand_mm_s")
QUALITY = (
    "contact_error_mm",
    "link_direction_error_deg",
    "object_penetration_mm",
    "table_penetration_mm",
    "self_penetration_mm",
)
"""Fields of ``Outcomes`` and ``StaticQuality`` that are kept."""


@dataclass(frozen=True, eq=False)
class Measurement(Job[tuple[int, ...]]):
    """A variant on a part of the set; a part of the work is some objects' grasps, by their rows."""

    variant: Variant
    """What is measured."""
    part: SetPart
    """On what."""
    rows: tuple[int, ...]
    """The rows of the part that are measured."""
    hand: Hand
    """The robot hand."""
    threads: int = 0
    """0 means all processors."""

    @cached_property
    def code(self) -> str:
        """Digest of the program, as what it gives depends on it."""
        return code_digest()

    def parts(self) -> list[tuple[int, ...]]:
        """The rows of ``OBJECTS_TOGETHER`` objects each."""
        rows = np.array(self.rows)
        names = self.part.grasps.object_name[rows]
        number = np.unique(names, return_inverse=True)[1] // OBJECTS_TOGETHER
        return [tuple(rows[number == k].tolist()) for k in range(int(number.max()) + 1)]

    def key(self, part: tuple[int, ...]) -> str:
        """Digest of grasps, objects, hand, settings and program."""
        human, objects = self._some(part)
        v = self.variant
        return part_key(
            "choose", human, objects, self.hand, v.method, v.retarget, v.motion, v.lift, self.code
        )

    def size(self, part: tuple[int, ...]) -> float:
        """Number of grasps."""
        return len(part)

    def run(self, parts: Sequence[tuple[int, ...]], progress: Callable[[float], None]) -> list[Arrays]:
        """Retarget, judge and lift; the fields above of each part's grasps."""
        return [self._measured(part) for part in parts]

    def _measured(self, part: tuple[int, ...]) -> Arrays:
        human, objects = self._some(part)
        robot = self._retargeted(human, objects)
        quality = static_quality(robot, human, objects, self.hand)
        lift, motion = self.variant.lift, self.variant.motion
        motion = replace(motion, for_use=lift.use, adapt=motion.adapt if lift.adapt else None)
        selection = lift.selection_settings
        planner = make_planner(lift.policy, self.hand, objects, selection, lift.lift, self.threads, motion)
        result = evaluate(
            robot, objects, spec=lift, hand=self.hand, human=human, plans=planner, threads=self.threads
        )
        return {name: getattr(result.outcomes, name) for name in OUTCOMES} | {
            name: getattr(quality, name) for name in QUALITY
        }

    def _retargeted(self, human: HumanGraspSet, objects: dict[str, ObjectModel]) -> RobotGraspSet:
        method = self.variant.method
        if method in METHODS:
            return retarget(human, objects, self.hand, method, self.variant.retarget, threads=self.threads)
        return PEERS[method][1](PeerProblem.of(human, objects, self.hand))[0]

    def _some(self, part: tuple[int, ...]) -> tuple[HumanGraspSet, dict[str, ObjectModel]]:
        human = self.part.grasps.select(np.array(part))
        return human, {name: self.part.objects[name] for name in np.unique(human.object_name).tolist()}


@dataclass(frozen=True)
class MeasurementRequest:
    """What the process of a checkout is asked."""

    variant: str
    """Without the checkout."""
    folder: str
    """Of the set."""
    part: str
    """Of the set."""
    every: int
    """Every so manieth grasp."""
    hand: str
    """Its name."""
    threads: int
    """0 means all processors."""
    kept: str
    """Folder of finished parts."""

    def measure(self, progress: Callable[[float], None] = lambda done: None) -> Arrays:
        """The fields above for each grasp, in their order.

        Raises:
            FungraspError: bad options, or a file can't be read or written.
        """
        variant = Variant.parse(self.variant)
        if variant.checkout is not None:
            return self._elsewhere(variant.checkout)
        part = load_part(Path(self.folder), self.part)
        rows = tuple(range(0, len(part.grasps), self.every))
        job = Measurement(variant, part, rows, load_hand(self.hand), self.threads)
        found = run_job(job, PartStore(self.kept), progress=progress)
        order = np.argsort(np.concatenate([np.array(some) for some in job.parts()]))
        return {name: np.concatenate([each[name] for each in found])[order] for name in found[0]}

    def _elsewhere(self, checkout: Path) -> Arrays:
        """Measured by a process that imports the package of a checkout."""
        request = {**vars(self), "variant": self.variant.rpartition("::")[2]}
        folder = Path(self.kept) / f"{os.getpid()}.checkout"
        result = PartStore(folder)
        with result:
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.choose.measurement", str(folder)],
                input=json.dumps(request),
                env={**os.environ, "PYTHONPATH": f"{checkout / 'src'}{os.pathsep}{ROOT}"},
                stdout=subprocess.PIPE,
                text=True,
            )
            arrays = result.load("result")
            if done.returncode or arrays is None:
                raise FungraspError(f"{checkout}: measuring '{request['variant']}' failed: see above")
            return arrays


def code_digest() -> str:
    """SHA-256 of the package that is imported, and of the benchmarks that measure with it."""
    total = hashlib.sha256()
    package = Path(str(fungrasp.__file__)).parent
    for folder in (package, ROOT / "benchmarks" / "peers"):
        for path in sorted(folder.rglob("*.py")):
            total.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    total.update(Path(__file__).read_bytes())
    return total.hexdigest()


if __name__ == "__main__":
    try:
        measured = MeasurementRequest(**json.load(sys.stdin)).measure()
        PartStore(sys.argv[1]).save("result", measured)
    except FungraspError as error:
        sys.exit(f"fungrasp: error: {error}")
