"""``fungrasp evaluate``: how many grasps lift the object, in simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fungrasp.cli.console import progress_bar, write_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fungrasp.evaluation import LiftTestResult
    from fungrasp.evaluation.lift_test_chunks import LiftTest, Refinement
    from fungrasp.grasps import HumanGraspSet, RobotGraspSet
    from fungrasp.hands import Hand
    from fungrasp.jobs import PartStore
    from fungrasp.objects import ObjectModel
    from fungrasp.sim2real import Randomization

CHUNKS = (8, 32)
"""Fewest and most grasps that are kept together, and one job on a cluster: 5 s of work at most, beside which
what a job costs is little, and many enough jobs for many processors."""

SEARCHED_CHUNKS = (2, 32)
"""The same where grasps are refined, or plans are searched for, which takes ten times as long and more."""

TOGETHER = 128
"""Most grasps tried together by one process, whose threads have more to share in this way: what it may lose
where it is interrupted."""

WITHOUT = "without adaptation"
"""Condition in which methods of retargeting are compared a second time."""

PARTS = 8
"""Parts of the work of which an interrupted run loses one at most, where the numbers above allow it."""


@dataclass(frozen=True)
class Evaluate:
    """Try grasps in simulation: reach, grasp, lift, hold; measure how many succeed."""

    grasps: str = "builtin"
    """A file of human grasps (they are retargeted first) or of robot grasps of --hand, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); the model's if not given."""
    policy: str = "reference"
    """What moves the hand: "reference" (one planned motion, open loop), "student", "teacher", "plan" (the
    student's plan, open loop), one of `fungrasp policies list`, or a policy file (.onnx)."""
    refine: int = 0
    """First try this many variations of each grasp in simulation, and keep the best."""
    method: tuple[str, ...] = ("contact",)
    """How human grasps are retargeted: contact, angle-copy, dexgraspnet; several are compared, with and
    without adaptation of the grasps to the settled object."""
    adapt: bool = True
    """Fit the grasps to the object as it has settled: a little optimization by the planner, which also
    repairs grasps that were retargeted badly."""
    seed: tuple[int, ...] = (0,)
    """Seed of all random numbers; with several, each grasp is tried with each."""
    json: Path | None = None
    """Write every number here (.json). Given again after an interruption, the command goes on."""
    out: Path | None = None
    """Write a compact result: this JSON file with settings and summary, and beside it a CSV file with one row
    per episode."""
    record: Path | None = None
    """Folder to which each episode is recorded (.npz)."""
    picture: Path | None = None
    """Draw some of the grasps, and whether they held, to this PNG file."""
    static: bool = False
    """Measure the static quality too (of retargeted human grasps), and run the six-direction test."""
    use: bool = False
    """After the hold, play the motion that the grasp's task needs (tilt, strike, stroke, press, hand over),
    and say how many objects stay in the hand and how many fingers lie where the person's did."""
    protocol: Literal["nominal", "reality", "robustness"] = "nominal"
    """How the world differs from what planner and policy believe: not at all; in everything at once, as a
    robot's does, drawn anew for each episode; or in one thing at a time."""
    mass_scale: float = 1.0
    """The object weighs this many times its nominal mass, which the policy assumes."""
    friction: float | None = None
    """Sliding friction of hand, object and table; 0.9 by default."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Difference of the object's true pose from the estimated one: shift [m] and turn [degrees]."""
    table_height: float = 0.0
    """Height of the table top above the nominal one, which the policy assumes [m]."""
    latency: float = 0.0
    """Actions take effect this late [s], up to 0.1."""
    push: tuple[float, float] = (0.0, 0.2)
    """During the hold, three pushes in random directions: force [times the object's weight], duration [s]."""
    object_shift: float = 0.0
    """The object is moved this far on the table [m] after the policy has planned."""
    rollouts: bool = True
    """Policies that choose among candidate plans try the most promising in simulated rollouts first, in
    worlds that differ from the nominal one, and search further where none holds: 33 to 189 episodes for each
    grasp."""
    attempts: int = 1
    """Most attempts of an episode. A policy that watches (a student) sees that the object is not held, lets
    go, withdraws, looks where the object lies, plans anew and tries again. The published protocol is one
    attempt; with more, the result says how many objects the first one held."""
    noslip: int = 0
    """Iterations that take the creep out of the solver's friction; 5 make physics 1.6 times as slow."""
    threads: int = 0
    """0 means all processors; the result does not depend on it."""
    ray: tuple[str, ...] | None = None
    """Plan and play on a Ray cluster: on that of this address ("auto": the one that this machine is part of),
    or on all processors of this machine where none is given. Same results. Every machine must see the files
    under the same names."""

    def run(self) -> None:
        from time import perf_counter

        from fungrasp.cli.episode_tables import (
            comparison,
            result_table,
            robustness_table,
            static_words,
            use_table,
        )
        from fungrasp.cli.hand_choice import chosen_hand
        from fungrasp.cli.on_cluster import test_on_cluster
        from fungrasp.errors import FungraspError
        from fungrasp.evaluation.lift_test_chunks import check_hand
        from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
        from fungrasp.jobs import PartStore
        from fungrasp.policies import check_attempts, policy_files
        from fungrasp.report.grasp_pictures import draw_grasps

        randomization = self._randomization()
        hand = chosen_hand(self.hand, self.hand_dynamics)
        files = policy_files(self.policy, hand.name)
        files.digests()
        check_attempts(self.attempts, files.network is not None)
        grasps = load_grasps(self.grasps)
        self._check(isinstance(grasps, RobotGraspSet), randomization, hand)
        if isinstance(grasps, RobotGraspSet):
            check_hand(grasps, hand)
        objects = load_objects(grasps, self.objects)
        file = self.json or self.out
        store = None if file is None else PartStore(file.with_name(f"{file.name}.partial"))
        if self.ray is not None and store is None:
            raise FungraspError("--ray keeps finished parts beside the result: give --json or --out too")
        start = perf_counter()
        sets = self._robot_grasps(grasps, objects, hand)
        tests = self.lift_tests(grasps, sets, objects)
        if self.ray is not None and store is not None:
            test_on_cluster(self, grasps, sets, objects, tests, store)
        done = {names: self._run(names, test, store) for names, test in tests.items()}
        without = {method: each for (method, other), each in done.items() if other == WITHOUT}
        tried = {
            method: {other: done[m, other] for m, other in done if m == method and other != WITHOUT}
            for method in sets
        }
        results = {name: next(iter(those.values())) for name, those in tried.items()}
        seconds = perf_counter() - start
        static = {
            name: self._static(robot, None if robot is grasps else grasps, objects, hand)
            for name, robot in sets.items()
            if self.static
        }
        if store is not None:
            self._write(tried, without, static, seconds)
            store.remove()
        if self.picture is not None:
            name, robot = next(iter(sets.items()))
            outcome = results[name].outcomes.reason[: len(robot)].tolist()
            draw_grasps(self.picture, robot, objects, captions=[reason or "success" for reason in outcome])
        for name, result in results.items():
            if len(results) > 1:
                print(f"{name}:")
            print(result_table(result) if len(tried[name]) == 1 else robustness_table(tried[name]))
            if self.use:
                print(use_table(result))
            if name in static:
                print(static_words(static[name]))
        if len(results) > 1:
            print(comparison(results))
            if without:
                print("without adaptation to the settled object:")
                print(comparison(without))
        count = sum(len(result.index) for result in done.values())
        print(f"{count} episodes in {seconds:.1f} s")

    def lift_tests(
        self,
        grasps: HumanGraspSet | RobotGraspSet,
        sets: Mapping[str, RobotGraspSet],
        objects: Mapping[str, ObjectModel],
    ) -> dict[tuple[str, str], LiftTest]:
        """All tests by the names of retargeting method and condition.

        Args:
            grasps: that were given.
            sets: robot grasps by the name of the method.
            objects: by name.
        """
        from functools import partial

        from fungrasp.cli.hand_choice import chosen_hand
        from fungrasp.evaluation.lift_test import make_lift_test
        from fungrasp.evaluation.use_test import UseTest
        from fungrasp.grasps import RobotGraspSet
        from fungrasp.planning import MotionSettings
        from fungrasp.planning.selection import SelectionSettings
        from fungrasp.policies import make_planner
        from fungrasp.sim2real import NOMINAL, protocol_conditions
        from fungrasp.simulation import SceneSettings

        hand = chosen_hand(self.hand, self.hand_dynamics)
        randomization = self._randomization()
        conditions = {"": randomization}
        if randomization == NOMINAL:
            conditions = protocol_conditions(self.protocol)
        selection = SelectionSettings.for_protocol(self.protocol, self.rollouts, self.use)
        # One planner for all conditions: what it has planned for one it knows for the others.
        make = partial(make_planner, self.policy, hand, objects, selection, threads=self.threads)
        unadapted = MotionSettings(adapt=None, for_use=self.use)
        planner = make(motions=MotionSettings(for_use=self.use) if self.adapt else unadapted)
        each = [(method, name, other, planner) for method in sets for name, other in conditions.items()]
        if len(sets) > 1 and self.adapt and len(conditions) == 1:
            plain = make(motions=unadapted)
            each += [(method, WITHOUT, next(iter(conditions.values())), plain) for method in sets]
        human = None if isinstance(grasps, RobotGraspSet) else grasps
        uses = {
            method: UseTest.of(human, robot, objects, hand) if self.use else None
            for method, robot in sets.items()
        }
        refinement = self._refinement(objects, hand)
        return {
            (method, name): make_lift_test(
                sets[method],
                objects,
                hand,
                self.policy,
                seeds=self.seed if self._is_random(other, hand) else self.seed[:1],
                threads=self.threads,
                physics=SceneSettings(noslip_iterations=self.noslip),
                randomization=other,
                refine=refinement,
                planner=its,
                use=uses[method],
                attempts=self.attempts,
                record=self._record_folder(method, name),
            )
            for method, name, other, its in each
        }

    def chunk_size(self, test: LiftTest) -> int:
        """Grasps to keep together. The result does not depend on it."""
        fewest, most = SEARCHED_CHUNKS if self._takes_long(test) else CHUNKS
        return min(max(math.ceil(len(test.grasps) / PARTS), fewest), most)

    def _together(self, test: LiftTest) -> int:
        """Grasps to try together in this process."""
        size = self.chunk_size(test)
        return (
            size if self._takes_long(test) else min(max(math.ceil(len(test.grasps) / PARTS), size), TOGETHER)
        )

    def _takes_long(self, test: LiftTest) -> bool:
        return bool(self.refine) or self._searches(test.scene.hand)

    def _run(self, names: tuple[str, str], test: LiftTest, store: PartStore | None) -> LiftTestResult:
        from fungrasp.evaluation.lift_test import run_lift_test

        words = ", ".join(word for word in (test.scene.hand.name, *names) if word)
        with progress_bar(words, len(test.grasps) * len(test.seeds)) as show:
            return run_lift_test(test, store, self.chunk_size(test), show, self._together(test))

    def _record_folder(self, method: str, condition: str) -> Path | None:
        folder = self.record
        if folder is not None and len(self.method) > 1:
            folder = folder / method
        if folder is not None and condition:
            folder = folder / condition.replace(",", "").replace(" ", "-")
        return folder

    def _write(
        self,
        tried: Mapping[str, Mapping[str, LiftTestResult]],
        without: Mapping[str, LiftTestResult],
        static: Mapping[str, dict[str, Any]],
        seconds: float,
    ) -> None:
        """All results to --json and --out."""
        from fungrasp.evaluation import result_json, write_result
        from fungrasp.evaluation.result_files import split_rows
        from fungrasp.evaluation.results import robustness_json, summary
        from fungrasp.provenance import run_record

        jsons: dict[str, dict[str, Any]] = {}
        for name, those in tried.items():
            jsons[name] = result_json(next(iter(those.values()))) | static.get(name, {})
            if name in without:
                jsons[name]["without_adaptation"] = summary(without[name])
            if len(those) > 1:
                jsons[name] |= {"protocol": self.protocol, "robustness": robustness_json(those)}
        whole: dict[str, Any] = next(iter(jsons.values())) if len(jsons) == 1 else {"methods": jsons}
        whole = run_record(whole.get("seed", self.seed)) | whole | {"seconds": seconds}
        if self.json is not None:
            write_json(self.json, whole)
        if self.out is not None:
            write_result(self.out, *split_rows(whole))

    def _randomization(self) -> Randomization:
        from math import radians

        from fungrasp.sim2real import THREE_PUSHES, MeasurementError, Randomization

        distance, angle = self.pose_noise
        weights, duration = self.push
        return Randomization(
            mass=(self.mass_scale, self.mass_scale),
            friction=None if self.friction is None else (self.friction, self.friction),
            object_position_error=MeasurementError(offset=distance),
            object_rotation_error=MeasurementError(offset=radians(angle)),
            table_height=(self.table_height, self.table_height),
            action_delay=(self.latency, self.latency),
            push_times=THREE_PUSHES if weights else (),
            push_weights=(weights, weights),
            push_duration=duration,
            object_shift=(self.object_shift, self.object_shift),
        )

    def _check(self, robot: bool, randomization: Randomization, hand: Hand) -> None:
        """Complain about options that do not go together."""
        from fungrasp.errors import FungraspError
        from fungrasp.retargeting import method_name
        from fungrasp.sim2real import NOMINAL

        for name in self.method:
            method_name(name)
        if robot and tuple(map(method_name, self.method)) != ("contact",):
            raise FungraspError(f"--method {' '.join(self.method)}: {self.grasps} holds robot grasps already")
        for name, values in (("method", self.method), ("seed", self.seed)):
            if not values or len(set(values)) < len(values):
                raise FungraspError(f"--{name} needs at least one value, and each once")
        if self.attempts > 1 and self.record is not None:
            raise FungraspError("--record keeps one attempt: leave --attempts or --record out")
        if min(*self.seed, self.refine, self.threads, self.noslip) < 0:
            raise FungraspError("--seed, --refine, --noslip and --threads must not be negative")
        if self.protocol != "nominal" and randomization != NOMINAL:
            raise FungraspError(
                f"--protocol {self.protocol} says how worlds differ: give it or single options"
            )
        random = self.protocol != "nominal" or self._is_random(randomization, hand)
        if len(self.seed) > 1 and not random:
            raise FungraspError(
                "nothing is random here, so several seeds would only repeat the same episodes: give one "
                "--seed, or something random (--protocol, --pose-noise, --push, --object-shift, --refine, "
                "a learned policy that chooses plans)"
            )

    def _is_random(self, randomization: Randomization, hand: Hand) -> bool:
        """Whether episodes depend on the seed."""
        return bool(self.refine or randomization.is_random or self._searches(hand))

    def _searches(self, hand: Hand) -> bool:
        """Whether plans are chosen among candidates."""
        from fungrasp.policies import policy_files

        return policy_files(self.policy, hand.name).predictor is not None

    def _robot_grasps(
        self, grasps: HumanGraspSet | RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
    ) -> dict[str, RobotGraspSet]:
        from fungrasp.grasps import RobotGraspSet
        from fungrasp.retargeting import retarget

        if isinstance(grasps, RobotGraspSet):
            return {hand.name: grasps}
        sets = {}
        for method in self.method:
            with progress_bar(f"retargeting to {hand.name} ({method})", len(grasps)) as show:
                sets[method] = retarget(grasps, objects, hand, method, threads=self.threads, progress=show)
        return sets

    def _static(
        self,
        robot: RobotGraspSet,
        human: HumanGraspSet | RobotGraspSet | None,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
    ) -> dict[str, Any]:
        from fungrasp.evaluation import six_direction_test, static_quality
        from fungrasp.evaluation.results import finite, static_json
        from fungrasp.grasps import HumanGraspSet

        with progress_bar("six directions", len(robot)) as show:
            six = six_direction_test(robot, objects, hand, threads=self.threads, progress=show)
        numbers: dict[str, Any] = {"six_directions": static_json(six)}
        if isinstance(human, HumanGraspSet):
            numbers["quality"] = finite(static_quality(robot, human, objects, hand).summary())
        return numbers

    def _refinement(self, objects: Mapping[str, ObjectModel], hand: Hand) -> Refinement | None:
        if not self.refine:
            return None
        from fungrasp.evaluation.lift_test_chunks import Refinement
        from fungrasp.files import digest
        from fungrasp.planning.selection.refinement import refine_grasps
        from fungrasp.policies import OpenLoopPolicy

        done: dict[str, RobotGraspSet] = {}

        def improve(grasps: RobotGraspSet, seed: int) -> RobotGraspSet:
            """Once for all conditions."""
            key = digest({name: getattr(grasps, name) for name in grasps.FIELDS}, grasps.extra, seed)
            if key not in done:
                done[key] = refine_grasps(
                    grasps,
                    objects,
                    hand,
                    OpenLoopPolicy(),
                    tries=self.refine,
                    seed=seed,
                    threads=self.threads,
                )
            return done[key]

        return Refinement(improve, f"{self.refine} tries")


COMMAND = Evaluate
