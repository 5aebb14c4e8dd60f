"""The lift test in chunks of episodes that are simulated together and do not depend on each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.evaluation.attempts import AttemptSetting, play_attempts
from fungrasp.evaluation.contact_estimate import ContactEstimateMeter, ContactEstimates
from fungrasp.evaluation.trajectory import Recorder
from fungrasp.evaluation.use_recording import UseRecorder
from fungrasp.evaluation.use_test import UseTest
from fungrasp.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.jobs import PartStore
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.planning.selection import SearchPlanner
from fungrasp.policies import StudentPolicy
from fungrasp.sim2real import Randomization, draw_each, random_stream
from fungrasp.simulation import Scene
from fungrasp.task import LiftEnvironment, LiftProtocol, Policy, PrivilegedPolicy, play
from fungrasp.version import __version__

USE_PREFIX = "use."
"""Before the names of the fields of ``UseOutcomes`` where they stand beside those of ``Outcomes``."""

USE_FILE = "{}_use.npz"
"""Name of the file of a recorded use test, from that of the lift test's without its suffix."""

ATTEMPT_PREFIX = "attempts."
"""The same of ``AttemptRecord``."""

CHUNK = 128
"""Episodes simulated together. It bounds the memory, and an episode does not depend on the others of its
chunk."""


@dataclass(frozen=True)
class Refinement:
    """Improves grasps before they are tried."""

    refine: Callable[[RobotGraspSet, int], RobotGraspSet]
    """Function of grasps and a seed that returns refined grasps."""
    name: str
    """Name of the refinement, settings included."""


@dataclass(frozen=True)
class Chunk:
    """Episodes that are simulated together."""

    seed: int
    """Seed of what is random."""
    rows: np.ndarray
    """Rows of the grasps in their set, shape [W]."""

    @classmethod
    def join(cls, chunks: Sequence[Chunk]) -> Chunk:
        """The episodes of several chunks of one seed."""
        return cls(chunks[0].seed, np.concatenate([chunk.rows for chunk in chunks]))


@dataclass(frozen=True, eq=False)
class LiftTest:
    """Grasps to be tried, and how."""

    grasps: RobotGraspSet
    """N grasps."""
    scene: Scene
    """What is simulated."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    policy: Policy | PrivilegedPolicy
    """What moves the hand."""
    planner: Planner
    """Whose plans it follows."""
    policy_key: tuple[str, str, str]
    """Name of the policy, digests of its network and of its success predictor."""
    protocol: LiftProtocol
    """The numbers of the test."""
    randomization: Randomization
    """How worlds differ from the nominal ones."""
    seeds: tuple[int, ...]
    """Each grasp is tried once with each."""
    threads: int
    """0 means all processors."""
    refine: Refinement | None
    """Applied to the grasps before they are tried."""
    use: UseTest | None
    """The use test that follows."""
    record: Path | None
    """Folder for the recorded episodes."""
    attempts: int = 1
    """Most attempts of an episode."""

    def chunks(self, size: int) -> list[Chunk]:
        """All episodes, so many in a chunk at most."""
        count = len(self.grasps)
        starts = range(0, count, size)
        return [Chunk(seed, np.arange(i, min(i + size, count))) for seed in self.seeds for i in starts]

    def key(self, chunk: Chunk) -> str:
        """Digest of all that the outcome of a chunk depends on."""
        hand, grasps = self.scene.hand, self.grasps.select(chunk.rows)
        names = np.unique(grasps.object_name).tolist()
        return digest(
            __version__,
            mujoco.__version__,
            hand.path.read_bytes(),
            hand.model_path.read_bytes(),
            {name: asdict(servo) for name, servo in hand.actuators.items()},
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            {name: self.objects[name].digest for name in names},
            self.policy_key,
            getattr(self.planner, "key", ""),
            self.protocol,
            self.randomization,
            self.scene.settings,
            chunk.rows,
            chunk.seed,
            self.refine.name if self.refine is not None else "",
            [str(file.absolute()) for file in self._files(chunk)],
            "" if self.use is None else self.use.key(chunk.rows),
            self.attempts,
        )

    def finished(self, chunk: Chunk, store: PartStore) -> dict[str, np.ndarray] | None:
        """What ``run`` returned earlier, if it was kept and the recorded episodes are there."""
        recorded = all(file.is_file() for file in self._files(chunk))
        return store.load(self.key(chunk)) if recorded else None

    def run(self, chunk: Chunk, progress: Callable[[float], None]) -> dict[str, np.ndarray]:
        """Plan and play.

        Args:
            chunk: W episodes.
            progress: called with the number of them that are done, fractions included.

        Returns:
            fields of ``Outcomes`` and ``ContactEstimates``, ``refined_tries`` and ``rollouts``, with several
            attempts those of ``AttemptRecord``, each of shape [W].
        """
        rows, seed, files = chunk.rows, chunk.seed, self._files(chunk)
        hand, r, p = self.scene.hand, self.randomization, self.protocol
        grasps = self.grasps.select(rows)
        if self.refine is not None:
            grasps = self.refine.refine(grasps, seed)
        sample = draw_each(r, seed, rows, len(hand.joint_names))
        jitter = [random_stream("sensor jitter", seed, int(row)) for row in rows]
        environment = LiftEnvironment(self.scene, len(rows), r, p, jitter, self.threads)
        belief = environment.settle(grasps, sample)
        # A searching planner takes most of the time: half of the progress is its.
        half = 0.5 if isinstance(self.planner, SearchPlanner) else 0.0
        plan = self.planner.plan(grasps, belief, seed, lambda done: progress(half * done))
        environment.move_objects()
        recorder = Recorder(environment.task, grasps, r) if files else None
        longest, furthest = p.approach_time + p.hold_time + 1.2, 0.0

        def watch() -> None:
            nonlocal furthest
            # A further attempt begins at zero.
            furthest = max(furthest, min(float(environment.task.time.max()) / longest, 1.0))
            progress(len(rows) * (half + (1 - half) * furthest))
            if recorder is not None:
                recorder()

        policy, estimates = self.policy, ContactEstimates.none(len(rows))
        if isinstance(policy, StudentPolicy) and policy.estimates_contacts:
            policy = ContactEstimateMeter(policy, environment)
            estimates = policy.estimates
        tries = {}
        if self.attempts > 1:
            setting = AttemptSetting(self.attempts, self.planner, grasps, self.objects, belief, seed, rows)
            outcomes, made, plan = play_attempts(environment, policy, plan, setting, watch=watch)
            tries = {ATTEMPT_PREFIX + name: values for name, values in made.arrays().items()}
        else:
            outcomes = play(environment, policy, plan, watch=watch)
        if recorder is not None:
            for trajectory, file in zip(recorder.trajectories(rows), files, strict=True):
                trajectory.save(file)
        use = {}
        if self.use is not None:
            assert grasps.task is not None
            tasks = grasps.task.tolist()
            watching = UseRecorder(environment, grasps, self.use.motions_of(tasks)) if files else None
            tried = self.use.run(environment, rows, tasks, outcomes.success, watching or (lambda: None))
            if watching is not None:
                for trajectory, file in zip(watching.trajectories(rows, tried), files, strict=True):
                    if trajectory is not None:
                        trajectory.save(file.with_name(USE_FILE.format(file.stem)))
            use = {USE_PREFIX + name: values for name, values in tried.arrays().items()}
        none = np.zeros(len(rows), dtype=int)
        return (
            outcomes.arrays()
            | estimates.arrays()
            | use
            | tries
            | {
                "refined_tries": grasps.extra.get("refined_tries", none + 1),
                "rollouts": none if plan.rollouts is None else plan.rollouts,
            }
        )

    def _files(self, chunk: Chunk) -> list[Path]:
        """For the recorded episodes of a chunk: none, or W."""
        if self.record is None:
            return []
        label = f"_{chunk.seed}" if len(self.seeds) > 1 else ""
        names = self.grasps.object_name
        return [self.record / f"{row:04d}{label}_{names[row]}.npz" for row in chunk.rows.tolist()]


def check_hand(grasps: RobotGraspSet, hand: Hand) -> None:
    """Complain about grasps of another hand.

    Raises:
        FungraspError: human grasps, another name, other joints or other contact links.
    """
    if not isinstance(grasps, RobotGraspSet):
        raise FungraspError(
            f"expected robot grasps, not a {type(grasps).__name__}: retarget them first "
            "(fungrasp.retargeting.retarget)"
        )
    grasps.check_hand(hand)
