"""``fungrasp evaluate``: measure success rates of grasps in simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from fungrasp.cli.console import CommandResult, option, progress_bar, suggestion
from fungrasp.cli.options import (
    ClusterOption,
    GraspsOption,
    JsonOut,
    MirrorOption,
    ThreadsOption,
    device_and_buffers,
    json_path,
    print_use,
)
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import check_suffix
from fungrasp.evaluation import LiftTestSpec
from fungrasp.evaluation.lift_test_spec import WorldDifferences
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.sim2real import NOMINAL, Randomization
from fungrasp.simulation import SceneSettings
from fungrasp.task import LiftProtocol


@dataclass(frozen=True)
class Evaluate(GraspsOption, MirrorOption, ThreadsOption, ClusterOption, LiftTestSpec):
    """Test grasps in simulation (reach, grasp, lift, hold) and measure success rates."""

    seeds: Annotated[tuple[int, ...], tyro.conf.arg(name="seed")] = (0,)
    """Random seeds; each grasp is tested once with each."""
    randomization: tyro.conf.Suppress[tyro.conf.Fixed[Randomization]] = NOMINAL
    """Set by ``differs``."""
    lift: tyro.conf.Suppress[tyro.conf.Fixed[LiftProtocol]] = field(default_factory=LiftProtocol)
    """Set in Python only."""
    physics: tyro.conf.Suppress[tyro.conf.Fixed[SceneSettings]] = field(default_factory=SceneSettings)
    """Set by ``noslip``, ``device`` and ``buffers``."""
    selection: tyro.conf.Suppress[tyro.conf.Fixed[SelectionSettings | None]] = None
    """Set in Python only."""

    differs: WorldDifferences = field(default_factory=WorldDifferences)
    """Differences of worlds from the estimate, instead of a protocol."""
    hand: str | None = None
    """Name of a hand, or the path of its TOML file. Default: the hand of robot grasps; allegro for human
    grasps."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`). Default: the model's."""
    method: str = "contact"
    """Retargeting method: contact, angle-copy or dexgraspnet."""
    json: JsonOut = None
    """Write all numbers to this file (.json); without a file, print them. If interrupted, run the same
    command again to continue."""
    out: Path | None = None
    """Write a compact result: a JSON file with settings and summary, and a CSV file with one row per episode
    beside it."""
    record: Path | None = None
    """Record each episode to this folder (.npz)."""
    picture: Path | None = None
    """Draw some grasps with their outcomes to this PNG file."""
    noslip: int = 0
    """Number of solver iterations that reduce slip in contacts; 5 make physics 1.6 times slower."""
    device: Literal["cuda", "cpu-warp", "cpu"] | None = None
    """Where to simulate: on an NVIDIA GPU, with the GPU code on the CPU (slow), or on the CPU. Default: a
    GPU if one is found and the extra "gpu" is installed."""
    buffers: tuple[int, int] | None = None
    """GPU buffers per world: contacts (mean) and constraint rows (maximum). Default: measured in a probe."""

    def __post_init__(self) -> None:
        """Skip the checks of ``LiftTestSpec``: ``_spec`` creates a checked one."""

    def run(self) -> CommandResult:
        from contextlib import nullcontext

        from fungrasp.core.jobs import PartStore
        from fungrasp.evaluation import evaluate
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects, mirrored_grasps
        from fungrasp.retargeting import RetargetSpec, method_name, retarget
        from fungrasp.sim2real.joint_dynamics import identified_hand

        spec, cluster, path = self._spec(), self.cluster, json_path(self.json)
        for written in filter(None, (path, self.out)):
            check_suffix(written, "a result", ".json")
        file = path or self.out
        if cluster is not None and file is None:
            raise FungraspError("--ray stores finished parts next to the result: give --json or --out too")
        grasps, method = load_grasps(self.grasps), method_name(self.method)
        robot = grasps if isinstance(grasps, RobotGraspSet) else None
        human = None if isinstance(grasps, RobotGraspSet) else grasps
        if robot is not None and (self.mirror or method != RetargetSpec.method):
            what = "--mirror" if self.mirror else f"--method {self.method}"
            raise FungraspError(f"{what} needs human grasps, but {self.grasps} has robot grasps")
        name = self.hand or (RetargetSpec.hand if robot is None else robot.hand_file or robot.hand)
        hand = identified_hand(name, self.hand_dynamics)
        if human is not None and self.mirror:
            human = mirrored_grasps(human)
        objects = load_objects(grasps if human is None else human, self.objects)
        if robot is None:
            assert human is not None
            with progress_bar(f"retargeting to {hand.name} ({method})", 1.0) as show:
                robot = retarget(human, objects, hand, method, threads=self.threads, progress=show)
        with nullcontext() if file is None else PartStore.beside(file) as store:
            options: Any = {"record": self.record, "threads": self.threads, "store": store, "ray": cluster}
            with progress_bar(f"lifting with {hand.name}", 1.0) as show:
                result = evaluate(robot, objects, spec=spec, hand=hand, human=human, progress=show, **options)
            if path is not None:
                result.save(path)
            if self.out is not None:
                result.save(self.out, compact=True)
        print_use(cluster)
        if self.picture is not None:
            from fungrasp.media.pictures import draw_grasps

            o, held = result.outcomes, "held as shown" if result.knows_places else "held"
            reasons = zip(o.reason.tolist(), o.not_as_shown.tolist(), strict=True)
            captions = [failed or (f"held, but {why}" if why else held) for failed, why in reasons]
            with progress_bar("drawing", 1.0) as show:
                draw_grasps(self.picture, robot, objects, captions=captions, progress=show)
        lines = [result.table(), f"{result.episodes} episodes in {result.seconds:.1f} s"]
        if path is not None:
            lines.append(suggestion("view", path, *self._where_from(human is None)))
        return CommandResult(result.json(), "\n".join(lines))

    def _where_from(self, robot: bool) -> tuple[str, ...]:
        """Return the options of ``view`` that name the grasps. robot: whether --grasps has robot grasps."""
        if not robot:
            return ()
        return option("--grasps", self.grasps), option("--objects", self.objects)

    def _spec(self) -> LiftTestSpec:
        device, buffers = device_and_buffers(self.device, self.buffers)
        if self.noslip and self.device is None:
            device = "cpu"
        asked = {each.name: getattr(self, each.name) for each in fields(LiftTestSpec)}
        asked["physics"] = SceneSettings(noslip_iterations=self.noslip, device=device, buffers=buffers)
        return LiftTestSpec(**{**asked, "randomization": self.differs.randomization})


COMMAND = Evaluate
