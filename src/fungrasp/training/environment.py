"""Many worlds in which a policy learns: trials that begin anew, each with another reference."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import begin_on_way
from fungrasp.policies.plan_tracking import Tracker
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.simulation import SceneSettings, Worlds, build_scene
from fungrasp.task import LiftTask, Protocol
from fungrasp.task.observation import critic, flatten, layout, observe, privileged
from fungrasp.task.reward import RewardWeights, total
from fungrasp.training.history import History
from fungrasp.training.library import Library
from fungrasp.training.rewards import LiftReward
from fungrasp.transfer import MILD, Differences, Randomisation

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EnvironmentSettings:
    """Of training trials."""

    worlds: int = 512
    """Trials that run at once."""
    timestep: float = 0.01
    """Of physics [s]; the dynamic test has 0.005."""
    hold_time: float = 1.5
    """[s]; the dynamic test has 3."""
    early: tuple[int, int] = (4, 14)
    """Trials begin this many control steps before the fingers close, on the reference's way."""
    whole: float = 0.1
    """Share of trials that begin where the dynamic test does."""
    dropped_height: float = 0.03
    """An object lower than this a while after the lift began is lost [m]."""
    dropped_after: float = 1.2
    """[s]."""
    lift_goal: float = 0.14
    """Height of the object that is paid in full [m]; above the test's 0.1, as what swings hangs lower."""
    randomisation: Randomisation = MILD
    """What differs from what the policy is told, anew in each trial."""
    history: bool = False
    """Whether observations hold a student's history."""
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    reward: RewardWeights = field(
        default_factory=lambda: RewardWeights(
            position=0.3, contact=0.5, posture=0.1, lift=1.0, success=10.0, drop=-3.0
        )
    )


@dataclass(frozen=True, eq=False)
class Observations:
    """What the networks get, W worlds."""

    robot: np.ndarray
    """What a robot has, shape [W, O]."""
    privileged: np.ndarray
    """Contacts, shape [W, P]."""
    critic: np.ndarray
    """What only the critic sees besides, shape [W, C]."""
    history: np.ndarray | None = None
    """What a student's encoder sees, if kept, shape [W, HISTORY, H]."""


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step in W worlds."""

    observations: Observations
    reward: np.ndarray
    """Shape [W]."""
    done: np.ndarray
    """Trials that ended, shape [W] bool; their observations are those of the next trial's beginning."""
    success: np.ndarray
    """Shape [W] bool, where done."""
    terms: dict[str, float]
    """Mean of each reward term."""


class LiftEnvironment:
    """W worlds that never stop."""

    def __init__(
        self,
        library: Library,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        settings: EnvironmentSettings | None = None,
        seed: int = 0,
        threads: int = 0,
    ):
        """
        Args:
            library: of references of ``hand``.
            objects: by name.
            hand: the robot hand.
            settings: the defaults if None.
            seed: of everything random here.
            threads: 0 means all processors. Results do not depend on it.
        """
        s = self.settings = settings or EnvironmentSettings()
        self.library, self.hand = library, hand
        self.rng = np.random.default_rng(seed)
        refs = library.references
        names = sorted(set(refs.object_name.tolist()))
        scene = build_scene(hand, {name: objects[name] for name in names}, SceneSettings(timestep=s.timestep))
        self._object_index = scene.indices(refs.object_name.tolist())
        rows = np.arange(s.worlds) % len(refs)
        self.protocol = replace(Protocol(), hold_time=s.hold_time)
        worlds = Worlds(scene, self._object_index[rows], refs.mass[rows], threads=threads)
        placeholder = refs.select(rows).grasps(hand)
        self.task = LiftTask(scene, placeholder, worlds, self.protocol)
        self.differences = Differences(s.randomisation, worlds, self.rng)
        self.tracker = Tracker(self.task, objects, refs, s.residual, self.differences)
        self.reward = LiftReward(hand, self.protocol.control_period, s.lift_goal)
        self.success_of_group = np.full(int(library.group.max()) + 1, 0.5)
        """Running success rate of each grasp, shape [G]."""
        self.diverged = 0
        """Trials whose physics broke down so far."""
        worlds.reset()
        self._begin(np.arange(s.worlds))
        parts, contacts, more = self._parts()
        self.layout, self.privileged_layout = layout(parts), layout(contacts)
        self.critic_layout = layout(more)
        self._history = History(s.worlds, self.layout) if s.history else None
        self.observations = self._observe(np.arange(s.worlds))

    @property
    def actions(self) -> int:
        """Numbers in an action."""
        return self.tracker.size

    def step(self, action: np.ndarray) -> Step:
        """One control period in all worlds. action: shape [W, A]."""
        task, tracker, s = self.task, self.tracker, self.settings
        before = tracker.action
        self.differences.push(task.time - task.lift_time)
        task.step(tracker.act(action))
        tracker.advance()
        view, sensed = tracker.view(), tracker.sensed()
        height = task.worlds.center_of_mass[:, 2] - task.settled_height
        broken = task.worlds.broken | ~np.isfinite(height)
        terms = self.reward.terms(view, sensed, np.nan_to_num(height, nan=-1.0), before)
        since_lift = task.time - task.lift_time
        dropped = (since_lift > s.dropped_after) & (height < s.dropped_height)
        lost = dropped | broken | (np.linalg.norm(view.now.object_pose[:, :2], axis=1) > 10.0)
        done = task.done | lost
        success = task.done & ~lost & task.trials().success
        reward = total(
            terms | {"success": success.astype(float), "drop": (done & ~success).astype(float)}, s.reward
        )
        reward = np.where(broken, s.reward.drop, np.nan_to_num(reward))
        self._report(np.flatnonzero(broken))
        ids = np.flatnonzero(done)
        if len(ids):
            group = self.library.group[tracker.rows[ids]]
            for g, won in zip(group, success[ids], strict=True):
                self.success_of_group[g] += 0.1 * (float(won) - self.success_of_group[g])
            self._begin(ids)
        self.observations = self._observe(ids)
        return Step(
            self.observations,
            reward,
            done,
            success,
            {name: float(np.nanmean(v)) for name, v in terms.items()},
        )

    def _report(self, broken: np.ndarray) -> None:
        """Count and name worlds whose physics broke down."""
        self.diverged += len(broken)
        rows = self.tracker.rows[broken]
        for row, name in zip(rows.tolist(), self.library.references.object_name[rows].tolist(), strict=True):
            grasp = self.library.group[row]
            _log.warning("physics broke down: object '%s', grasp %d, reference %d", name, grasp, row)

    def _begin(self, ids: np.ndarray) -> None:
        """New trials in some worlds."""
        s, refs, rng = self.settings, self.library.references, self.rng
        rate = self.success_of_group[self.library.group]
        chance = rate * (1 - rate) + 0.05
        rows = rng.choice(len(refs), size=len(ids), p=chance / chance.sum())
        early = rng.integers(s.early[0], s.early[1] + 1, size=len(ids))
        first = np.maximum(refs.motion.closing[rows] - early, 0)
        first[rng.random(len(ids)) < s.whole] = 0
        task, told = self.task, refs.select(rows)
        task.worlds.reset(ids)
        self.differences.begin(ids, self._object_index[rows], told.mass)
        task.latency[ids] = self.differences.latency(ids, task.protocol.control_period)
        placed = replace(told, settled_pose=self.differences.placed(ids, told.settled_pose))
        begin_on_way(task, ids, placed, np.arange(len(ids)), first)
        self.tracker.begin(ids, rows)

    def _parts(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
        view, sensed, drawn = self.tracker.view(), self.tracker.sensed(), self.differences.drawn
        friction = np.full(len(drawn), 0.9) if drawn.friction is None else drawn.friction
        return (
            observe(view.now, view.before, view.wanted, view.action),
            privileged(sensed.contacts, sensed.forces, view.wanted.contacts),
            critic(sensed, view.now, friction, drawn.mass * view.wanted.mass),
        )

    def _observe(self, begun: np.ndarray) -> Observations:
        seen = Observations(*(flatten(part).astype(np.float32) for part in self._parts()))
        if self._history is None:
            return seen
        return replace(seen, history=self._history.push(seen.robot, begun))
