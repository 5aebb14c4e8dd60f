"""Many worlds in which a policy learns: episodes that begin anew, each with another plan."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.arrays import is_numpy, moved_to
from fungrasp.geometry.poses import Array, array_namespace
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel, with_sizes
from fungrasp.policies.plan_tracking import PlanTracker
from fungrasp.sim2real import draw
from fungrasp.simulation import SceneSettings, build_scene, make_engine
from fungrasp.task import LiftEnvironment, LiftProtocol
from fungrasp.task.features import (
    contact_features,
    encoder_parts,
    layout,
    limited,
    network_input,
    network_parts,
    value_features,
)
from fungrasp.task.reward import total
from fungrasp.training.rewards import LiftReward
from fungrasp.training.settings import EnvironmentSettings
from fungrasp.training.training_sets import PlanLibrary

_log = logging.getLogger(__name__)

HISTORY = 10
"""Control steps that the encoder looks back on, the present one included."""

Layout = tuple[tuple[str, int], ...]


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """What the networks get, W worlds, in single precision."""

    robot: Array
    """What a robot has, shape [W, O]."""
    privileged: Array
    """Contacts that only a simulation knows, shape [W, P]."""
    value: Array
    """What only the value network gets besides, shape [W, C]."""
    history: Array | None = None
    """What a student's encoder sees, if kept, shape [W, HISTORY, H]."""


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step in W worlds, on the device of the worlds."""

    reward: Array
    """Weighted sum of the reward terms, shape [W]."""
    done: Array
    """Episodes that ended, shape [W] bool."""
    success: Array
    """Whether an episode that ended succeeded, shape [W] bool."""
    diverged: Array
    """Episodes whose physics broke down, shape [W] bool."""
    terms: dict[str, Array]
    """Mean of each reward term over the worlds, by name."""


@dataclass(frozen=True, eq=False)
class EndedEpisodes:
    """The I episodes that ended in a step; NumPy arrays."""

    worlds: np.ndarray
    """Where, shape [I] int."""
    success: np.ndarray
    """Whether they succeeded, shape [I] bool."""


class History:
    """The last observations of W worlds, zeros before an episode's first."""

    def __init__(self, worlds: int, size: int, on: Array):
        """
        Args:
            size: H, numbers of a control step.
            on: an array of the library and the device of what is seen.
        """
        xp = array_namespace(on)
        self.window = xp.zeros((worlds, HISTORY, size), dtype=xp.float32, device=on.device)

    def push(self, seen: Array, begun: np.ndarray) -> Array:
        """The windows with one more control step, shape [W, HISTORY, H].

        Args:
            seen: what the encoder gets of it, shape [W, H].
        """
        self.window[moved_to(self.window, begun)] = 0.0
        self.window = array_namespace(seen).concat([self.window[:, 1:], seen[:, None]], axis=1)
        return self.window


class DeviceJitter:
    """Jitter of sensors whose worlds are torch tensors (``fungrasp.task.sensors.Jitter``), from torch's
    generator of the device, whose state is part of checkpoints."""

    def __init__(self, on: Array, seed: int):
        """on: a tensor of the device and the number type."""
        import torch

        torch.manual_seed(seed)
        self._on = on

    def normal(self, *, size: tuple[int, int]) -> Array:
        """Standard normal numbers."""
        return self._on.new_empty(size).normal_()

    def random(self, count: int, /) -> Array:
        """Numbers from 0 to 1."""
        return self._on.new_empty(count).uniform_()


class TrainingEnvironment:
    """W worlds in which one episode follows another.

    All that a control step is made of is on the device of the worlds: NumPy arrays, or torch tensors that
    share memory with the physics. Episodes begin on the processor, which has to be told where one ended: that
    is what comes from the device once in each ``step``.
    """

    def __init__(
        self,
        library: PlanLibrary,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        settings: EnvironmentSettings | None = None,
        seed: int = 0,
        threads: int = 0,
        physics: SceneSettings | None = None,
    ):
        """
        Args:
            library: of plans of ``hand``.
            physics: device and buffers of the worlds; their timestep is that of the settings.
        """
        s = self.settings = settings or EnvironmentSettings()
        self.library, self.hand = library, hand
        self.rng = np.random.default_rng(seed)
        names = sorted(set(library.plans.object_name.tolist()))
        sizes = with_sizes({name: objects[name] for name in names}, s.randomization.object_scales)
        scene = build_scene(hand, sizes, replace(physics or SceneSettings(), timestep=s.timestep))
        self.protocol = replace(LiftProtocol(), hold_time=s.hold_time)
        engine = make_engine(scene, s.worlds, threads, tensors=True)
        self.on: Array = engine.object_pose
        """An array of the library and the device that actions, observations and rewards are on."""
        jitter = self.rng if is_numpy(self.on) else DeviceJitter(self.on, seed)
        self.episodes = LiftEnvironment(
            scene, s.worlds, s.randomization, self.protocol, jitter, engine=engine
        )
        self.tracker = PlanTracker(hand, objects, library.plans, s.worlds, s.residual, self.on)
        self._rows = np.zeros(s.worlds, dtype=int)
        """The plan that each world follows, shape [W]."""
        distance = None if s.residual.base == "plan" else self.protocol.start_distance
        self.reward = LiftReward(hand, self.protocol.control_period, s.lift_goal, distance)
        self.success_of_group = np.full(int(library.group.max()) + 1, 0.5)
        """Running success rate of each grasp, shape [G]."""
        self.steps = 0
        """Control steps of the training so far, of all worlds; they move the starts (``settings.widen``)."""
        self.processes = 1
        """How many learn together, each in as many worlds of its own."""
        self.diverged = 0
        """Episodes whose physics broke down so far."""
        everyone = np.arange(s.worlds)
        self.ended = EndedEpisodes(everyone[:0], everyone[:0] > 0)
        """What ended in the last step."""
        self.begin(everyone)
        features, contacts, more = self._parts()
        self.layout = layout(network_parts(features, s.layout, encoder=False))
        self.privileged_layout, self.value_layout = layout(contacts), layout(more)
        self.encoder_layout = layout(encoder_parts(features, s.layout))
        """Of what a student's encoder gets of a control step."""
        self.student_layout = layout(network_parts(features, s.layout, encoder=True))
        """Of what a student with an encoder gets."""
        encoded = sum(n for _, n in self.encoder_layout)
        self._history = History(s.worlds, encoded, self.on) if s.history else None
        self.observations = self._observe(everyone)

    @property
    def actions(self) -> int:
        """Numbers in an action."""
        return self.tracker.size

    def step(self, action: Array) -> Step:
        """One control period in all worlds; where an episode ends, the next one begins, and ``observations``
        are of its beginning. action: shape [W, A]."""
        step = self.advance(action)
        ended = self.end(step).worlds
        self.begin(ended)
        self.observations = self._observe(ended)
        return step

    def advance(self, action: Array) -> Step:
        """One control period in all worlds, no more: what has to ``end`` does so next, and ``begin``
        anew; ``observations`` stay as they are. Nothing waits for the device. action: shape [W, A]."""
        episodes, tracker, s = self.episodes, self.tracker, self.settings
        self.steps += s.worlds * self.processes
        task, before = episodes.task, tracker.action
        episodes.step(tracker.act(action))
        tracker.update(episodes.observe())
        self._privileged = episodes.privileged()
        terms = self.reward.terms(tracker.state(), self._privileged, before)
        diverged, lost, xp = task.engine.diverged, task.lost, array_namespace(task.time)
        done = task.done | lost
        success = task.done & ~lost & task.measurements.success
        once = {"success": success, "drop": done & ~success}
        once = {name: xp.astype(flags, task.time.dtype) for name, flags in once.items()}
        once["shown"] = once["success"] * terms["shown"]
        reward = total(terms | once, s.reward)
        reward = xp.where(xp.isfinite(reward), reward, 0.0)
        reward = xp.where(diverged, s.reward.drop, reward)
        return Step(reward, done, success, diverged, {name: _mean(v) for name, v in terms.items()})

    def end(self, step: Step) -> EndedEpisodes:
        """Episodes that ended in a step, kept as ``ended``; what is begun depends on their success."""
        flags = array_namespace(step.done).stack([step.done, step.success, step.diverged])
        done, success, diverged = np.asarray(flags if is_numpy(flags) else flags.cpu())
        self._report(np.flatnonzero(diverged))
        self.ended = EndedEpisodes(np.flatnonzero(done), success[done])
        for g, won in zip(self.library.group[self._rows[done]], self.ended.success, strict=True):
            self.success_of_group[g] += 0.1 * (float(won) - self.success_of_group[g])
        return self.ended

    def begin(self, ids: np.ndarray) -> None:
        """New episodes in some worlds. ids: shape [I]; nothing happens if there is none."""
        if len(ids):
            self.tracker.begin(ids, self._begin(ids), self.episodes.observe())
            self._privileged = self.episodes.privileged()

    def named_observations(self, privileged: bool) -> dict[str, Array]:
        """What the networks get of the worlds as they are now, without a history: by name of each part, of
        shape [W, number] float32. privileged: the contacts, too."""
        features, contacts, _ = self._parts()
        parts = network_parts(features, self.settings.layout, encoder=False)
        parts |= contacts if privileged else {}
        return {name: limited(part) for name, part in parts.items()}

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
        rows = self._rows[diverged]
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
        self._rows[ids] = rows
        return rows

    @property
    def _widened(self) -> float:
        """Share of the starts near the grasp that have given way by now."""
        if self.settings.widen is None:
            return 0.0
        first, last = self.settings.widen
        return float(np.clip((self.steps - first) / max(last - first, 1), 0.0, 1.0))

    def _parts(self) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
        state, p = self.tracker.state(), self._privileged
        return (
            state.robot_features(),
            contact_features(p.contacts, p.forces, state.target.contacts),
            value_features(p, state.now.palm_pose),
        )

    def _observe(self, begun: np.ndarray) -> NetworkInputs:
        features, *others = self._parts()
        robot = network_parts(features, self.settings.layout, encoder=False)
        seen = NetworkInputs(*(network_input(part) for part in (robot, *others)))
        if self._history is None:
            return seen
        encoded = network_input(encoder_parts(features, self.settings.layout))
        return replace(seen, history=self._history.push(encoded, begun))


def _mean(values: Array) -> Array:
    """Of the numbers that are finite."""
    xp = array_namespace(values)
    known = xp.isfinite(values)
    return xp.sum(xp.where(known, values, 0.0)) / xp.sum(xp.astype(known, values.dtype))


def columns(layout: Layout, names: tuple[str, ...]) -> np.ndarray:
    """Where some parts lie in a flat observation."""
    starts = dict(
        zip([name for name, _ in layout], np.cumsum([0, *(n for _, n in layout)])[:-1], strict=True)
    )
    sizes = dict(layout)
    return np.concatenate([starts[name] + np.arange(sizes[name]) for name in names])
