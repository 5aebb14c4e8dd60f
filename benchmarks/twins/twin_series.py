"""The lift test on twins, without a clock: what identification and gravity compensation are worth (Table VI
of the paper), and what perceived grasps do (Table II)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from benchmarks.twins.twin_episode import (
    PlacedGrasp,
    RememberingPlanner,
    TwinEpisode,
    TwinSetup,
    TwinVariant,
)
from benchmarks.twins.twin_identification import identify_on_twin
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import digest
from fungrasp.core.jobs import PartStore
from fungrasp.core.provenance import run_record
from fungrasp.core.records import record_to_json
from fungrasp.core.text_table import table
from fungrasp.deployment.deploy import deployable_policy, robot_planner
from fungrasp.evaluation.result_files import write_result
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.policies import policy_source
from fungrasp.robots.assembly import limited_hand
from fungrasp.robots.cell import load_cell
from fungrasp.robots.twin.parameters import TwinParameters, cell_twin
from fungrasp.sim2real.joint_dynamics import HandDynamics

if TYPE_CHECKING:
    from benchmarks.synthetic_captures.perceived_grasps import PerceivedGrasps

Identify = Callable[[TwinParameters], HandDynamics]
"""What is known of the hand's dynamics of a twin."""

VARIANTS = {
    variant.name: variant
    for variant in (
        TwinVariant("full"),
        TwinVariant("no identification", identified=False),
        TwinVariant("no gravity compensation", compensate=False),
        TwinVariant("full, two attempts", attempts=2),
    )
}
"""The columns of Table VI, and what a second attempt adds, by name."""


@dataclass(frozen=True)
class TwinSeriesSpec:
    """What is asked of a series on twins, as JSON by ``fungrasp.core.records``."""

    cell: Annotated[str, tyro.conf.arg(name="robot")] = "ur5e-allegro"
    """A robot cell that is a twin: one that comes with the package, or a TOML file."""
    policy: str = "plan"
    """What moves the hand (``DeploymentSpec.policy``)."""
    variants: tuple[str, ...] = ("no identification", "no gravity compensation", "full")
    """Ways to deploy: "no identification", "no gravity compensation", "full", "full, two attempts" (of a
    student)."""
    twins: tuple[int, ...] = (0, 1, 2)
    """Seeds of the twins' true parameters."""
    in_turn: bool = False
    """Try each grasp on one of the twins, in turn, in place of all."""
    grasps_per_object: int | None = None
    """Of each object the first so many grasps that the arm can reach; all if not given."""

    def check(self) -> None:
        """
        Raises:
            FungraspError: a number that can't be, an unknown variant, or one that the policy is not for.
        """
        for name in self.variants:
            if name not in VARIANTS:
                raise UnknownNameError("variant", name, sorted(VARIANTS))
        for name in ("variants", "twins"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise FungraspError(f"--{name} needs at least one value, and each once")
        if min(self.twins) < 0:
            raise FungraspError("--twins must not be negative")
        count = self.grasps_per_object
        if count is not None and count < 1:
            raise FungraspError(f"--grasps-per-object must be at least 1, not {count}")
        again = [name for name in self.variants if VARIANTS[name].attempts > 1]
        if again and policy_source(self.policy, load_hand(load_cell(self.cell).hand).name).network is None:
            raise FungraspError(
                f"the variant '{again[0]}' needs a policy that watches, and '{self.policy}' plays its plan "
                "blindly: take --policy student, or leave the variant out"
            )


@dataclass(frozen=True, eq=False)
class KnownGrasps:
    """Grasps that are known already, as ``PerceivedGrasps`` are not."""

    grasps: RobotGraspSet
    """N of them."""
    numbers: Sequence[int]
    """Of each in results, N."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What the header of a result says of those that were taken so far."""

    @property
    def hand(self) -> str:
        """Name of the hand that they are of."""
        return self.grasps.hand

    @property
    def names(self) -> Sequence[str]:
        """Name of the object of each."""
        return self.grasps.object_name.tolist()

    def take(self, row: int) -> RobotGraspSet | None:
        """One grasp; None where it turns out to be none."""
        return self.grasps.select(np.array([row]))


@dataclass(frozen=True, eq=False)
class TwinSeriesResult:
    """Outcome of a series on twins."""

    spec: TwinSeriesSpec
    """What was asked."""
    episodes: tuple[TwinEpisode, ...]
    """In the order in which they were done."""
    reached: tuple[int, ...] = ()
    """Numbers of the grasps for which the arm reaches a placement, of those that were looked at."""
    out_of_reach: tuple[int, ...] = ()
    """Numbers of the others that were looked at."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What else a file of the result says in its header."""

    def table(self) -> str:
        """By variant: episodes, those in which the motion began, rates of success, and medians of the hand's
        errors where it began (``TwinEpisode``), as text."""
        head = "variant", "episodes", "begun", "lifted", "95 % interval", "as shown", "tracking [rad]"
        rows: list[tuple[str, ...]] = [(*head, "sag [deg]")]
        for name in self.spec.variants:
            mine = [e for e in self.episodes if e.variant == name]
            begun = [e for e in mine if e.tracking_rad >= 0]
            if not mine:
                continue
            tracking, sag = (
                float(np.median([getattr(e, part) for e in begun])) if begun else float("nan")
                for part in ("tracking_rad", "sag_rad")
            )
            lifted = sum(e.success for e in mine)
            low, high = wilson_interval(lifted, len(mine))
            rows.append(
                (
                    name,
                    str(len(mine)),
                    str(len(begun)),
                    f"{lifted / len(mine):.0%}",
                    f"{low:.0%} to {high:.0%}",
                    f"{sum(e.held_as_shown for e in mine) / len(mine):.0%}",
                    f"{tracking:.3f}",
                    f"{np.rad2deg(sag):.1f}",
                )
            )
        return table(rows, left=None)

    def save(self, path: str | Path) -> None:
        """Write a header and a row for each episode; ``fungrasp.evaluation.read_result`` reads them.

        Raises:
            FungraspError: a file can't be written.
        """
        header = {
            "robot": self.spec.cell,
            "policy": self.spec.policy,
            **self.about,
            "spec": record_to_json(self.spec),
            "out_of_reach": " ".join(map(str, self.out_of_reach)),
            "grasps_that_can_be_reached": len(self.reached),
        }
        write_result(path, header, [asdict(episode) for episode in self.episodes])


def evaluate_on_twins(
    spec: TwinSeriesSpec,
    out: str | Path,
    source: KnownGrasps | PerceivedGrasps,
    objects: Mapping[str, ObjectModel],
    about: Mapping[str, Any] | None = None,
    threads: int = 0,
) -> TwinSeriesResult:
    """Try grasps on twins. The result is written anew after every episode; what is finished is kept in
    ``<out>.partial`` until all is done, so that an interrupted series goes on.

    Args:
        spec: what is asked.
        out: JSON file to write, with a CSV file beside it.
        source: of grasps of the cell's hand, each made as its turn comes.
        objects: theirs, by name.
        about: what else the header of the file says.
        threads: of planning; 0 means all processors.

    Raises:
        FungraspError: grasps of another hand, no such cell or policy, none of the grasps can be reached, or a
            file can't be written.
    """
    spec.check()
    cell = load_cell(spec.cell)
    hand = load_hand(cell.hand)
    if source.hand != hand.name:
        raise FungraspError(
            f"robot cell '{cell.name}' carries the hand '{hand.name}', and the grasps are of '{source.hand}'"
        )
    check_objects(list(source.names), objects)
    about = {**(about or {}), **run_record(0)}
    placed: list[PlacedGrasp] = []
    result = None
    with PartStore.beside(out) as store:
        planner = robot_planner(spec.policy, limited_hand(cell, hand), objects, threads)
        files = policy_source(spec.policy, hand.name)
        setup = TwinSetup(
            objects,
            hand,
            cell,
            deployable_policy(spec.policy, hand, objects),
            planner,
            store,
            digest(spec.policy, files.digest, getattr(planner, "key", "")),
        )

        def watched() -> Iterator[PlacedGrasp]:
            for one in placed_grasps(setup, source, spec.grasps_per_object):
                placed.append(one)
                yield one

        identify = _identified(setup, source.names[0])
        variants = [VARIANTS[name] for name in spec.variants]
        episodes: list[TwinEpisode] = []
        for episode in try_on_twins(setup, watched(), spec.twins, variants, identify, spec.in_turn):
            episodes.append(episode)
            reached, beyond = (
                tuple(sorted({one.number for one in placed if bool(len(one.placements)) is within}))
                for within in (True, False)
            )
            said = {**about, **source.about}
            result = TwinSeriesResult(spec, tuple(episodes), reached, beyond, said)
            result.save(out)
        if result is None:
            raise FungraspError(
                "the arm reaches none of these grasps: take others with --rows, or another --robot"
            )
    return result


def placed_grasps(
    setup: TwinSetup, source: KnownGrasps | PerceivedGrasps, per_object: int | None = None
) -> Iterator[PlacedGrasp]:
    """Look for a placement of the object of every grasp, as they are asked for: the first grasp of every
    object that can be reached comes before the second of any.

    Args:
        setup: of the test.
        source: of grasps of its hand.
        per_object: of each object the first so many that can be reached; all if None.

    Yields:
        the grasps that were tried, those out of reach included.
    """
    waiting: dict[str, deque[int]] = {}
    for row, name in enumerate(source.names):
        waiting.setdefault(name, deque()).append(row)
    for _ in range(len(source.names) if per_object is None else per_object):
        for rows in waiting.values():
            while rows:
                row = rows.popleft()
                grasp = source.take(row)
                if grasp is None:
                    continue
                placed = setup.place(source.numbers[row], grasp)
                yield placed
                if len(placed.placements):
                    break


def try_on_twins(
    setup: TwinSetup,
    placed: Iterable[PlacedGrasp],
    twins: Sequence[int],
    variants: Sequence[TwinVariant],
    identify: Identify,
    in_turn: bool = False,
) -> Iterator[TwinEpisode]:
    """Try each grasp once on each twin in each variant.

    Every grasp is tried on one of the twins, in turn, before any is tried on its next one, so that what a
    stopped run has done is balanced. The object is not put down afterwards; all else is as on a robot.

    Args:
        setup: of the test.
        placed: grasps, and where the objects are put; those out of reach are passed over.
        twins: seeds of their true parameters.
        variants: ways to deploy.
        identify: what is known of the dynamics of a twin.
        in_turn: each grasp on one of the twins, in turn, in place of all.
    """
    known: dict[int, HandDynamics] = {}
    for one, twin in _turns(placed, twins, 1 if in_turn else len(twins)):
        truth = cell_twin(setup.cell, setup.hand, twin)
        planner = RememberingPlanner(setup.planner)
        for variant in variants:
            if variant.identified and twin not in known:
                known[twin] = identify(truth)
            dynamics = known[twin] if variant.identified else None
            yield setup.run(one, twin, truth, variant, dynamics, planner)


def _turns(
    placed: Iterable[PlacedGrasp], twins: Sequence[int], turns: int
) -> Iterator[tuple[PlacedGrasp, int]]:
    """Grasps within reach, each with a twin: in every turn each grasp with another one."""
    reached: list[PlacedGrasp] = []
    for one in placed:
        if len(one.placements):
            yield one, twins[len(reached) % len(twins)]
            reached.append(one)
    for turn in range(1, turns):
        for row, one in enumerate(reached):
            yield one, twins[(row + turn) % len(twins)]


def _identified(setup: TwinSetup, aside: str) -> Identify:
    """The hand of each twin is identified, as it would be on a robot. aside: object that lies in the twin's
    world meanwhile."""

    def identify(truth: TwinParameters) -> HandDynamics:
        def fit() -> HandDynamics:
            found = identify_on_twin(setup.cell, setup.hand, setup.objects[aside], truth).found
            return HandDynamics.of(setup.hand, found.dynamics)

        return setup.identified(truth, fit)

    return identify
