"""Many worlds in which a policy learns: episodes that begin anew, each with another plan."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel, with_sizes
from fungrasp.policies.plan_tracking import PlanTracker
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import MODERATE, Randomization, draw
from fungrasp.simulation import BufferSizes, Device, SceneSettings, build_scene
from fungrasp.task import LiftEnvironment, LiftProtocol
from fungrasp.task.features import contact_features, flatten, layout, value_features
from fungrasp.task.observation_layouts import LayoutName, encoder_parts, network_parts
from fungrasp.task.reward import RewardWeights, total
from fungrasp.training.history import History
from fungrasp.training.plan_library import PlanLibrary
from fungrasp.training.rewards import LiftReward

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EnvironmentSettings:
    """How training episodes run."""

    worlds: int = 512
    """Episodes that run at once."""
    timestep: float = 0.01
    """Physics step [s]; the lift test has 0.005."""
    hold_time: float = 1.5
    """Time that the object has to be held [s]; the lift test has 3."""
    early: tuple[int, int] = (4, 14)
    """Fewest and most control steps before the fingers close at which episodes begin, on the planned path:
    with an open hand, a few centimeters from the grasp."""
    whole: float = 0.1
    """Share of episodes that begin where the lift test does."""
    widen: tuple[int, int] | None = None
    """Control steps of the training between which this share grows to all; it stays if not given."""
    lift_goal: float = 0.14
    """Height of the object that is paid in full [m]; above the test's 0.1, as what swings hangs lower."""
    randomization: Randomization = MODERATE
    """How worlds differ from the nominal ones, drawn anew in each episode."""
    layout: LayoutName = "full"
    """What networks get of what a robot has. "paper": what the paper names (section IV.B.1); "full": besides,
    distances from the object's surface, errors of servos and joints, the plan's phase, size and mass of the
    object."""
    history: bool = False
    """Whether observations hold a student's history."""
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    """How far actions may depart from the plan."""
    reward: RewardWeights = field(default_factory=RewardWeights)
    """Weights of the reward's terms."""

    def check(self) -> None:
        """Complain about impossible values.

        Raises:
            FungraspError: there is one.
        """
        if self.worlds < 1:
            raise FungraspError(f"a training needs at least one world, not {self.worlds}")
        if self.early[0] > self.early[1]:
            raise FungraspError("episodes begin FEWEST to MOST steps early, not {} to {}".format(*self.early))
        if not 0 <= self.whole <= 1:
            raise FungraspError(f"the share of whole episodes is from 0 to 1, not {self.whole:g}")
        if self.widen is not None and not 0 <= self.widen[0] <= self.widen[1]:
            raise FungraspError(
                "starts widen from one control step to a later one, not {} to {}".format(*self.widen)
            )


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """What the networks get, W worlds."""

    robot: np.ndarray
    """What a robot has, shape [W, O]."""
    privileged: np.ndarray
    """Contacts that only a simulation knows, shape [W, P]."""
    value: np.ndarray
    """What only the value network gets besides, shape [W, C]."""
    history: np.ndarray | None = None
    """What a student's encoder sees, if kept, shape [W, HISTORY, H]."""


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step in W worlds."""

    reward: np.ndarray
    """Weighted sum of the reward terms, shape [W]."""
    done: np.ndarray
    """Episodes that ended, shape [W] bool."""
    success: np.ndarray
    """Whether an episode that ended succeeded, shape [W] bool."""
    terms: dict[str, float]
    """Mean of each reward term over the worlds, by name."""


class TrainingEnvironment:
    """W worlds in which one episode follows another."""

    def __init__(
        self,
        library: PlanLibrary,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        settings: EnvironmentSettings | None = None,
        seed: int = 0,
        threads: int = 0,
        device: Device = "cpu",
        buffers: BufferSizes | None = None,
    ):
        """
        Args:
            library: of plans of ``hand``.
            objects: by name.
            hand: the robot hand.
            settings: the defaults if None.
            seed: of everything random here.
            threads: 0 means all processors. Results do not depend on it.
            device: where the worlds are simulated.
            buffers: room for contacts on a GPU; found by a probe if None.
        """
        s = self.settings = settings or EnvironmentSettings()
        self.library, self.hand = library, hand
        self.rng = np.random.default_rng(seed)
        names = sorted(set(library.plans.object_name.tolist()))
        sizes = with_sizes({name: objects[name] for name in names}, s.randomization.object_scales)
        scene = build_scene(hand, sizes, SceneSettings(timestep=s.timestep, device=device, buffers=buffers))
        self.protocol = replace(LiftProtocol(), hold_time=s.hold_time)
        self.episodes = LiftEnvironment(scene, s.worlds, s.randomization, self.protocol, self.rng, threads)
        self.tracker = PlanTracker(hand, objects, library.plans, s.worlds, s.residual)
        distance = None if s.residual.base == "plan" else self.protocol.start_distance
        self.reward = LiftReward(hand, self.protocol.control_period, s.lift_goal, distance)
        self.success_of_group = np.full(int(library.group.max()) + 1, 0.5)
        """Running success rate of each grasp, shape [G]."""
        self.steps = 0
        """Control steps of the training so far, of all worlds; they move the starts (``settings.widen``)."""
        self.diverged = 0
        """Episodes whose physics broke down so far."""
        everyone = np.arange(s.worlds)
        self.begin(everyone)
        features, contacts, more = self._parts()
        self.layout = layout(network_parts(features, s.layout, encoder=False))
        self.privileged_layout, self.value_layout = layout(contacts), layout(more)
        self.encoder_layout = layout(encoder_parts(features, s.layout))
        """Of what a student's encoder gets of a control step."""
        self.student_layout = layout(network_parts(features, s.layout, encoder=True))
        """Of what a student with an encoder gets."""
        self._history = History(s.worlds, sum(n for _, n in self.encoder_layout)) if s.history else None
        self.observations = self._observe(everyone)

    @property
    def actions(self) -> int:
        """Numbers in an action."""
        return self.tracker.size

    def step(self, action: np.ndarray) -> Step:
        """One control period in all worlds; where an episode ends, the next one begins, and ``observations``
        are of its beginning. action: shape [W, A]."""
        step = self.advance(action)
        ended = np.flatnonzero(step.done)
        self.begin(ended)
        self.observations = self._observe(ended)
        return step

    def advance(self, action: np.ndarray) -> Step:
        """One control period in all worlds, no more: what ended has to ``begin`` anew, and ``observations``
        stay as they are. action: shape [W, A]."""
        episodes, tracker, s = self.episodes, self.tracker, self.settings
        self.steps += s.worlds
        task, before = episodes.task, tracker.action
        episodes.step(tracker.act(action))
        tracker.update(episodes.observe())
        self._privileged = episodes.privileged()
        terms = self.reward.terms(tracker.state(), self._privileged, before)
        diverged, lost = task.engine.diverged, task.lost
        done = task.done | lost
        success = task.done & ~lost & task.outcomes().success
        reward = total(
            terms | {"success": success.astype(float), "drop": (done & ~success).astype(float)}, s.reward
        )
        reward = np.where(diverged, s.reward.drop, np.nan_to_num(reward))
        self._report(np.flatnonzero(diverged))
        for g, won in zip(self.library.group[tracker.rows[done]], success[done], strict=True):
            self.success_of_group[g] += 0.1 * (float(won) - self.success_of_group[g])
        return Step(reward, done, success, {name: float(np.nanmean(v)) for name, v in terms.items()})

    def begin(self, ids: np.ndarray) -> None:
        """New episodes in some worlds. ids: shape [I]; nothing happens if there is none."""
        if len(ids):
            self.tracker.begin(ids, self._begin(ids), self.episodes.observe())
            self._privileged = self.episodes.privileged()

    def named_observations(self, privileged: bool) -> dict[str, np.ndarray]:
        """What the networks get of the worlds as they are now, without a history: by name of each part, of
        shape [W, number] float32. privileged: the contacts, too."""
        features, contacts, _ = self._parts()
        parts = network_parts(features, self.settings.layout, encoder=False)
        parts |= contacts if privileged else {}
        return {name: part.astype(np.float32) for name, part in parts.items()}

    def reseed(self, seed: int) -> None:
        """Draw everything that is random here from another seed, as after construction; ``begin`` comes
        next."""
        self.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        self.success_of_group[:] = 0.5

    def restart(self) -> None:
        """Begin new episodes in all worlds: what follows depends on the random numbers, the success rates and
        the actions alone, so that it can be repeated from a checkpoint."""
        everyone = np.arange(self.settings.worlds)
        self.begin(everyone)
        self.observations = self._observe(everyone)

    def _report(self, diverged: np.ndarray) -> None:
        """Count and name worlds whose physics broke down."""
        self.diverged += len(diverged)
        rows = self.tracker.rows[diverged]
        for row, name in zip(rows.tolist(), self.library.plans.object_name[rows].tolist(), strict=True):
            grasp = self.library.group[row]
            _log.warning("physics broke down: object '%s', grasp %d, plan %d", name, grasp, row)

    def _begin(self, ids: np.ndarray) -> np.ndarray:
        """New episodes in some worlds; the plans they follow, shape [I]."""
        s, plans, rng = self.settings, self.library.plans, self.rng
        # Plans that sometimes hold teach most.
        rate = self.success_of_group[self.library.group]
        chance = rate * (1 - rate) + 0.05
        rows = rng.choice(len(plans), size=len(ids), p=chance / chance.sum())
        early = rng.integers(s.early[0], s.early[1] + 1, size=len(ids))
        first = np.maximum(plans.closing_step[rows] - early, 0)
        whole = s.whole + (1.0 - s.whole) * self._widened
        first[rng.random(len(ids)) < whole] = 0
        sample = draw(s.randomization, len(ids), len(self.hand.joint_names), rng)
        self.episodes.begin(ids, plans.select(rows), first, sample, hand_followed=True)
        return rows

    @property
    def _widened(self) -> float:
        """Share of the starts near the grasp that have given way by now."""
        if self.settings.widen is None:
            return 0.0
        first, last = self.settings.widen
        return float(np.clip((self.steps - first) / max(last - first, 1), 0.0, 1.0))

    def _parts(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
        state, p = self.tracker.state(), self._privileged
        return (
            state.robot_features(),
            contact_features(p.contacts, p.forces, state.target.contacts),
            value_features(p, state.now.palm_pose),
        )

    def _observe(self, begun: np.ndarray) -> NetworkInputs:
        features, *others = self._parts()
        robot = network_parts(features, self.settings.layout, encoder=False)
        seen = NetworkInputs(*(flatten(part).astype(np.float32) for part in (robot, *others)))
        if self._history is None:
            return seen
        encoded = flatten(encoder_parts(features, self.settings.layout)).astype(np.float32)
        return replace(seen, history=self._history.push(encoded, begun))
