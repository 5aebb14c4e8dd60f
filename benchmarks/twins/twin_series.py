"""The lift test on twins, without a clock: what identification and gravity compensation are worth (Table VI
of the paper)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.twins.twin_episode import PlacedGrasp, TwinEpisode, TwinSetup, TwinVariant
from benchmarks.twins.twin_identification import identify_on_twin
from benchmarks.twins.twin_schedule import (
    GraspSource,
    Identify,
    KnownGrasps,
    given_dynamics,
    placed_grasps,
    try_on_twins,
)
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import digest
from fungrasp.core.jobs import PartStore
from fungrasp.core.provenance import run_record
from fungrasp.core.records import record_to_json
from fungrasp.core.text_table import table
from fungrasp.deployment.deploy import deployable_policy, robot_planner
from fungrasp.deployment.hand_knowledge import HandDynamics
from fungrasp.evaluation.result_files import write_result
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.policies import policy_files
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.torque_limits import limited_hand
from fungrasp.robots.twin.parameters import TwinParameters

VARIANTS = (
    TwinVariant("full"),
    TwinVariant("no identification", identified=False),
    TwinVariant("no gravity compensation", compensate=False),
    TwinVariant("full, two attempts", attempts=2),
)
"""The columns of Table VI, and what a second attempt adds."""


@dataclass(frozen=True)
class TwinSeriesSpec:
    """What is asked of a series on twins, as JSON by ``fungrasp.core.records``."""

    cell: str = "ur5e-allegro"
    """A robot cell that is a twin: one that comes with the package, or a TOML file."""
    policy: str = "plan"
    """What moves the hand (``DeploymentSpec.policy``)."""
    variants: tuple[str, ...] = ("no identification", "no gravity compensation", "full")
    """Names of ``VARIANTS``."""
    twins: tuple[int, ...] = (0, 1, 2)
    """Seeds of the twins' true parameters."""
    in_turn: bool = False
    """Whether each grasp is tried on one of the twins, in turn, in place of all."""
    placements: int = 1
    """Placements of the object in which each grasp is tried."""
    grasps_per_object: int | None = None
    """Of each object the first so many grasps that the arm can reach; all if None."""
    given_dynamics: bool = False
    """Whether the true dynamics of the twins' hands are given in place of identified ones: what an
    identification without error would give."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a number that can't be, an unknown variant, or one that the policy is not for.
        """
        object.__setattr__(self, "variants", tuple(map(variant_name, self.variants)))
        for name in ("variants", "twins"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise FungraspError(f"--{name} needs at least one value, and each once")
        if min(self.twins) < 0:
            raise FungraspError("--twins must not be negative")
        for name in ("placements", "grasps_per_object"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise FungraspError(f"--{name.replace('_', '-')} must be at least 1, not {value}")
        again = [
            variant.name for variant in VARIANTS if variant.attempts > 1 and variant.name in self.variants
        ]
        if again and policy_files(self.policy, load_hand(load_cell(self.cell).hand).name).network is None:
            raise FungraspError(
                f"the variant '{again[0]}' needs a policy that watches, and '{self.policy}' plays its plan "
                "blindly: take --policy student, or leave the variant out"
            )


def variant_name(name: str) -> str:
    """The name of a variant, checked.

    Raises:
        FungraspError: there is none of this name.
    """
    known = {variant.name for variant in VARIANTS}
    if name not in known:
        raise UnknownNameError("variant", name, sorted(known))
    return name


@dataclass(frozen=True)
class VariantSummary:
    """How the episodes of one variant went."""

    episodes: int
    """Number of them."""
    begun: int
    """Of these, those in which the motion began."""
    lifted: int
    """Of these, those in which the object was lifted and held."""
    tracking_rad: float
    """Median of ``TwinEpisode.tracking_rad`` where the motion began [rad]; NaN if it never did."""
    sag_rad: float
    """Median of ``TwinEpisode.sag_rad``, as above [rad]."""


@dataclass(frozen=True, eq=False, repr=False)
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

    @property
    def summary(self) -> dict[str, VariantSummary]:
        """By variant, in the order of ``spec.variants``; variants without an episode are left out."""
        found: dict[str, VariantSummary] = {}
        for name in self.spec.variants:
            mine = [e for e in self.episodes if e.variant == name]
            begun = [e for e in mine if e.tracking_rad >= 0]
            if mine:
                tracking, sag = (
                    float(np.median([getattr(e, part) for e in begun])) if begun else float("nan")
                    for part in ("tracking_rad", "sag_rad")
                )
                lifted = sum(e.success for e in mine)
                found[name] = VariantSummary(len(mine), len(begun), lifted, tracking, sag)
        return found

    def table(self) -> str:
        """Rates of success and errors of the hand's joints by variant, as text."""
        rows = [("variant", "episodes", "begun", "lifted", "95 % interval", "tracking [rad]", "sag [deg]")]
        for name, one in self.summary.items():
            low, high = wilson_interval(one.lifted, one.episodes)
            rows.append(
                (
                    name,
                    str(one.episodes),
                    str(one.begun),
                    f"{one.lifted / one.episodes:.0%}",
                    f"{low:.0%} to {high:.0%}",
                    f"{one.tracking_rad:.3f}",
                    f"{np.rad2deg(one.sag_rad):.1f}",
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

    def __repr__(self) -> str:
        lifted = sum(episode.success for episode in self.episodes)
        return f"<TwinSeriesResult: cell {self.spec.cell!r}, {lifted} of {len(self.episodes)} held>"


def evaluate_on_twins(
    spec: TwinSeriesSpec,
    out: str | Path,
    robot: RobotGraspSet | GraspSource,
    objects: Mapping[str, ObjectModel],
    *,
    numbers: Sequence[int] | None = None,
    about: Mapping[str, Any] | None = None,
    threads: int = 0,
) -> TwinSeriesResult:
    """Try grasps on twins. The result is written anew after every episode; what is finished is kept in
    ``<out>.partial`` until all is done, so that an interrupted series goes on.

    Args:
        spec: what is asked.
        out: JSON file to write, with a CSV file beside it.
        robot: N grasps, of the cell's hand, or a source that makes each as its turn comes.
        objects: theirs, by name.
        numbers: of the grasps in the result, N; 0 to N - 1 if None. A source has its own.
        about: what else the header of the file says.
        threads: of planning; 0 means all processors.

    Raises:
        FungraspError: grasps of another hand, no such cell or policy, none of the grasps can be reached, or a
            file can't be written.
    """
    cell = load_cell(spec.cell)
    hand = load_hand(cell.hand)
    source: GraspSource
    if isinstance(robot, RobotGraspSet):
        source = KnownGrasps(robot, range(len(robot)) if numbers is None else numbers)
    else:
        source = robot
    if source.hand != hand.name:
        raise FungraspError(
            f"robot cell '{cell.name}' carries the hand '{hand.name}', and the grasps are of '{source.hand}'"
        )
    check_objects(list(source.names), objects)
    about = {**(about or {}), **run_record(0)}
    placed: list[PlacedGrasp] = []
    result = None
    with PartStore.beside(out) as store:
        setup = _setup(spec, cell, hand, objects, store, threads)

        def watched() -> Iterator[PlacedGrasp]:
            for one in placed_grasps(setup, source, spec.grasps_per_object):
                placed.append(one)
                yield one

        obj = objects[source.names[0]]
        known = {variant.name: variant for variant in VARIANTS}
        episodes: list[TwinEpisode] = []
        for episode in try_on_twins(
            setup,
            watched(),
            spec.twins,
            [known[name] for name in spec.variants],
            in_turn=spec.in_turn,
            identify=given_dynamics(hand) if spec.given_dynamics else _identification(setup, obj),
        ):
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


def _setup(
    spec: TwinSeriesSpec,
    cell: RobotCell,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    store: PartStore,
    threads: int,
) -> TwinSetup:
    planner = robot_planner(spec.policy, limited_hand(cell, hand), objects, threads)
    files = policy_files("student" if spec.policy == "plan" else spec.policy, hand.name)
    return TwinSetup(
        objects,
        hand,
        cell,
        deployable_policy(spec.policy, hand, objects),
        planner,
        store=store,
        policy_key=digest(spec.policy, files.digests(), getattr(planner, "key", "")),
        places=spec.placements,
    )


def _identification(setup: TwinSetup, obj: ObjectModel) -> Identify:
    """The hand of each twin is identified, as it would be on a robot.

    Args:
        setup: of the test.
        obj: lies in the twin's world meanwhile.
    """

    def identify(truth: TwinParameters) -> HandDynamics:
        def fit() -> HandDynamics:
            found = identify_on_twin(setup.cell, setup.hand, obj, truth).found
            return HandDynamics.of(setup.hand, found.dynamics)

        return setup.identified(truth, fit)

    return identify
