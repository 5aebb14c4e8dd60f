"""Learning curves: performance of a policy on fixed grasps during training, as its exported file would
act."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes
from fungrasp.core.plots import PlotLine, PlotPanel, panels_svg
from fungrasp.objects import ObjectModel, with_sizes
from fungrasp.policies.checkpoint.checkpoint_file import PolicyNetwork
from fungrasp.policies.residual_policy import residual_policy
from fungrasp.sim2real import draw
from fungrasp.simulation import SceneSettings, build_scene
from fungrasp.task import GraspPlan, LiftEnvironment, play
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.training_sets import PlanLibrary

CURVE, DRAWING = "curve.csv", "curve.svg"
GRASPS = 48
"""Largest number of grasps of a curve: about 4,000 control steps."""
LARGEST = 100_000_000
"""Largest size of a curve file that is read [bytes]."""


class CurvePoint(NamedTuple):
    """Performance of a policy at one time of the training."""

    steps: int
    """Control steps of the training."""
    seconds: float
    """Duration of the training [s], including earlier points of the curve."""
    success: float
    """Success rate."""
    held_as_shown: float
    """Share of the grasps held as shown; NaN in files of earlier versions."""
    contact_ratio: float
    """Share of the target links in contact, mean over the hold; zero for objects lost before."""
    slip_mm_s: float
    """Mean slip of the held objects [mm/s]; NaN if there are none."""


class LearningCurve:
    """The learning curve of one training, in its folder."""

    def __init__(
        self,
        folder: Path,
        library: PlanLibrary,
        objects: Mapping[str, ObjectModel],
        environment: TrainingEnvironment,
        every: int,
        seed: int,
        threads: int = 0,
    ):
        """
        Args:
            library: plans; the curve uses the first plan of each grasp, and ``GRASPS`` random grasps if there
                are more.
            environment: training environment, which is not changed. Its randomization is sampled once: all
                points are measured in the same worlds.
        """
        self._path, self._every, self._seed, self._threads = folder / CURVE, every, seed, threads
        self._hand, self._objects = environment.hand, objects
        self._randomization, self._protocol = environment.settings.randomization, environment.protocol
        first = np.unique(library.group, return_index=True)[1]
        if len(first) > GRASPS:
            first = np.sort(np.random.default_rng(seed).choice(first, GRASPS, replace=False))
        self.plans: GraspPlan = library.plans.select(first)
        names = sorted(set(self.plans.object_name.tolist()))
        sizes = with_sizes({name: objects[name] for name in names}, self._randomization.object_scales)
        timestep = environment.settings.timestep
        self._scene = build_scene(self._hand, sizes, SceneSettings(timestep=timestep))
        self.points: list[CurvePoint] = []
        """Points in the order of their steps."""

    def resume(self, steps: int) -> None:
        """Continue from a checkpoint. steps: steps of the training so far; later points are removed.

        Raises:
            FungraspError: the file is damaged or can't be written.
        """
        if self._path.is_file():
            self.points = [point for point in read_curve(self._path) if point.steps <= steps]
            self._write()

    def update(
        self, steps: int, seconds: float, network: Callable[[], PolicyNetwork], finished: bool
    ) -> None:
        """Measure a point if it is due: after the first and the last update of the training, and otherwise
        once every ``every`` steps.

        Args:
            network: returns the current policy network.

        Raises:
            FungraspError: a file can't be written.
        """
        if self.points and not finished and steps // self._every == self.points[-1].steps // self._every:
            return
        count, rng = len(self.plans), np.random.default_rng(self._seed)
        environment = LiftEnvironment(
            self._scene, count, self._randomization, self._protocol, rng, self._threads
        )
        sample = draw(self._randomization, count, len(self._hand.joint_names), rng)
        beginning = np.zeros(count, dtype=int)
        environment.begin(np.arange(count), self.plans, beginning, sample, hand_followed=True)
        policy = residual_policy(network(), self._hand, self._objects)
        outcomes = play(environment, policy, self.plans, end_lost=True)
        held = outcomes.sim_distance_hand_mm_s[outcomes.success]
        self.points.append(
            CurvePoint(
                steps,
                seconds,
                float(outcomes.success.mean()),
                float(outcomes.held_as_shown.mean()),
                float(np.nan_to_num(outcomes.contact_ratio).mean()),
                float(held.mean()) if len(held) else float("nan"),
            )
        )
        self._write()

    def _write(self) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([CurvePoint._fields, *self.points])
        with atomic_path(self._path) as part:
            part.write_text(text.getvalue())
        drawing = curve_svg(np.array(self.points, dtype=float).reshape(-1, len(CurvePoint._fields)))
        with atomic_path(self._path.with_name(DRAWING)) as part:
            part.write_text(drawing)


def read_curve(path: Path) -> list[CurvePoint]:
    """Read a ``curve.csv``.

    Raises:
        FungraspError: the file can't be read or is not a learning curve.
    """
    rows = list(csv.reader(read_bytes(path, "learning curve", LARGEST).decode(errors="replace").splitlines()))
    try:
        known = [dict(zip(rows[0], map(float, row), strict=True)) for row in rows[1:]]
        older = {"held_as_shown": float("nan")}
        return [CurvePoint(int(point.pop("steps")), **older | point) for point in known]
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise FungraspError(f"{path} is damaged, or not a learning curve") from error


ACROSS = ((0, 1e-6, "control steps [millions]"), (1, 1 / 60, "time [min]"))
"""Column, factor and title of the horizontal axis of each panel column."""
DOWN = (
    (2, "success", (0.0, 1.0)),
    (3, "held as shown", (0.0, 1.0)),
    (4, "contact ratio", (0.0, 1.0)),
    (5, "slip [mm/s]", None),
)
"""Column, title and limits of the vertical axis of each panel row."""


def curve_svg(points: np.ndarray) -> str:
    """Plot success, share held as shown, contact ratio and slip over control steps and time.

    Args:
        points: columns of ``CurvePoint``, shape [N, 6].
    """
    panels = []
    for measure, title, limits in DOWN:
        for column, (over, factor, across) in enumerate(ACROSS):
            line = PlotLine(factor * points[:, over], points[:, measure], "")
            panels.append(PlotPanel(title if column == 0 else "", across, title, [line], limits=limits))
    return panels_svg(panels, columns=2) + "\n"
