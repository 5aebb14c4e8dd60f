"""Parallel training worlds, in which episodes restart with new plans."""

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
"""Control steps in the encoder's window, including the current one."""

Layout = tuple[tuple[str, int], ...]


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """Network inputs in W worlds, single precision."""

    robot: Array
    """Inputs from robot sensors, shape [W, O]."""
    privileged: Array
    """True contacts, shape [W, P]."""
    value: Array
    """Additional inputs of the value network, shape [W, C]."""
    history: Array | None = None
    """Inputs of a student's encoder, shape [W, HISTORY, H]; None without history."""


@dataclass(frozen=True, eq=False)
class Step:
    """Outcome of a step in W worlds, on the device of the worlds."""

    reward: Array
    """Weighted sum of the reward terms, shape [W]."""
    done: Array
    """Whether each episode ended, shape [W] bool."""
    success: Array
    """Whether an episode ended with success, shape [W] bool."""
    diverged: Array
    """Whether the simulation diverged, shape [W] bool."""
    terms: dict[str, Array]
    """Mean of each reward term over the worlds, by name."""


@dataclass(frozen=True, eq=False)
class EndedEpisodes:
    """The I episodes that ended in a step; NumPy arrays."""

    worlds: np.ndarray
    """Worlds of the episodes, shape [I] int."""
    success: np.ndarray
    """Whether each episode succeeded, shape [I] bool."""


class History:
    """The last observations of W worlds; zeros before an episode's first observation."""

    def __init__(self, worlds: int, size: int, on: Array):
        """
        Args:
            size: H, number of values per control step.
            on: array whose library and device are used.
        """
        xp = array_namespace(on)
        self.window = xp.zeros((worlds, HISTORY, size), dtype=xp.float32, device=on.device)

    def push(self, seen: Array, begun: np.ndarray) -> Array:
        """Add a control step and return the windows, shape [W, HISTORY, H].

        Args:
            seen: encoder inputs of the step, shape [W, H].
            begun: worlds whose episodes begin.
        """
        self.window[moved_to(self.window, begun)] = 0.0
        self.window = array_namespace(seen).concat([self.window[:, 1:], seen[:, None]], axis=1)
        return self.window


class DeviceJitter:
    """Sensor noise for torch tensors (``fungrasp.task.sensors.Jitter``), from torch's generator of the
    device, whose state is part of checkpoints."""

    def __init__(self, on: Array, seed: int):
        """on: tensor whose device and dtype are used."""
        import torch

        torch.manual_seed(seed)
        self._on = on

    def normal(self, *, size: tuple[int, int]) -> Array:
        """Draw standard normal numbers."""
        return self._on.new_empty(size).normal_()

    def random(self, count: int, /) -> Array:
        """Draw numbers from 0 to 1."""
        return self._on.new_empty(count).uniform_()


class TrainingEnvironment:
    """W worlds with successive episodes.

    All quantities of a control step are on the device of the worlds: NumPy arrays, or torch tensors that
    share memory with the physics. Episodes begin on the CPU, so the flags of ended episodes are copied from
    the device once per ``step``.
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
            library: plans of ``hand``.
            physics: device and buffers of the worlds; the timestep is that of ``settings``.
        """
        s = self.settings = EnvironmentSettings.given(settings)
        self.library, self.hand = library, hand
        self.rng = np.random.default_rng(seed)
        names = sorted(set(library.plans.object_name.tolist()))
        sizes = with_sizes({name: objects[name] for name in names}, s.randomization.object_scales)
        scene = build_scene(hand, sizes, replace(SceneSettings.given(physics), timestep=s.timestep))
        self.protocol = replace(LiftProtocol(), hold_time=s.hold_time)
        engine = make_engine(scene, s.worlds, threads, tensors=True)
        self.on: Array = engine.object_pose
        """Array with the library and device of actions, observations and rewards."""
        jitter = self.rng if is_numpy(self.on) else DeviceJitter(self.on, seed)
        self.episodes = LiftEnvironment(
            scene, s.worlds, s.randomization, self.protocol, jitter, engine=engine
        )
        self.tracker = PlanTracker(hand, objects, library.plans, s.worlds, s.residual, self.on)
        self._rows = np.zeros(s.worlds, dtype=int)
        """Index of each world's plan, shape [W]."""
        distance = None if s.residual.base == "plan" else self.protocol.start_distance
        self.reward = LiftReward(hand, self.protocol.control_period, s.lift_goal, distance)
        self.success_of_group = np.full(int(library.group.max()) + 1, 0.5)
        """Running success rate of each grasp, shape [G]."""
        self.steps = 0
        """Control steps of the training so far, of all worlds; used by ``settings.widen``."""
        self.processes = 1
        """Number of training processes, each with its own worlds."""
        self.diverged = 0
        """Number of diverged episodes so far."""
        everyone = np.arange(s.worlds)
        self.ended = EndedEpisodes(everyone[:0], everyone[:0] > 0)
        """Episodes that ended in the last step."""
        self.begin(everyone)
        features, contacts, more = self._parts()
        self.layout = layout(network_parts(features, s.layout, encoder=False))
        self.privileged_layout, self.value_layout = layout(contacts), layout(more)
        self.encoder_layout = layout(encoder_parts(features, s.layout))
        """Layout of the encoder inputs of one control step."""
        self.student_layout = layout(network_parts(features, s.layout, encoder=True))
        """Layout of the inputs of a student with an encoder."""
        encoded = sum(n for _, n in self.encoder_layout)
        self._history = History(s.worlds, encoded, self.on) if s.history else None
        self.observations = self._observe(everyone)

    @property
    def actions(self) -> int:
        """Size of an action."""
        return self.tracker.size

    def step(self, action: Array) -> Step:
        """Advance all worlds by one control period. Ended episodes restart, and ``observations`` are those of
        the new ones. action: shape [W, A]."""
        step = self.advance(action)
        ended = self.end(step).worlds
        self.begin(ended)
        self.observations = self._observe(ended)
        return step

    def advance(self, action: Array) -> Step:
        """Advance all worlds by one control period without ending episodes or updating ``observations``; call
        ``end`` and ``begin`` next. This does not synchronize with the device. action: shape [W, A]."""
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
        """Return the episodes that ended in a step, store them as ``ended``, and update success rates."""
        flags = array_namespace(step.done).stack([step.done, step.success, step.diverged])
        done, success, diverged = np.asarray(flags if is_numpy(flags) else flags.cpu())
        self._report(np.flatnonzero(diverged))
        self.ended = EndedEpisodes(np.flatnonzero(done), success[done])
        for g, won in zip(self.library.group[self._rows[done]], self.ended.success, strict=True):
            self.success_of_group[g] += 0.1 * (float(won) - self.success_of_group[g])
        return self.ended

    def begin(self, ids: np.ndarray) -> None:
        """Begin new episodes in some worlds. ids: shape [I]; may be empty."""
        if len(ids):
            self.tracker.begin(ids, self._begin(ids), self.episodes.observe())
            self._privileged = self.episodes.privileged()

    def named_observations(self, privileged: bool) -> dict[str, Array]:
        """Return the current network inputs without history, by name, each of shape [W, number] float32.
        privileged: whether to include contacts."""
        features, contacts, _ = self._parts()
        parts = network_parts(features, self.settings.layout, encoder=False)
        parts |= contacts if privileged else {}
        return {name: limited(part) for name, part in parts.items()}

    def reseed(self, seed: int) -> None:
        """Reset the random state as in the constructor, with another seed; call ``begin`` next."""
        self.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        self.success_of_group[:] = 0.5

    def restart(self) -> None:
        """Begin new episodes in all worlds. The following steps then depend only on random state, success
        rates and actions, so that they can be reproduced from a checkpoint."""
        everyone = np.arange(self.settings.worlds)
        self.begin(everyone)
        self.observations = self._observe(everyone)

    def _report(self, diverged: np.ndarray) -> None:
        self.diverged += len(diverged)
        rows = self._rows[diverged]
        for row, name in zip(rows.tolist(), self.library.plans.object_name[rows].tolist(), strict=True):
            grasp = self.library.group[row]
            _log.warning("physics broke down: object '%s', grasp %d, plan %d", name, grasp, row)

    def _begin(self, ids: np.ndarray) -> np.ndarray:
        """Begin new episodes in some worlds, and return the indices of their plans, shape [I]."""
        s, plans, rng = self.settings, self.library.plans, self.rng
        # Plans that hold only sometimes are the most informative.
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
        """Fraction of the starts near the grasp that are replaced by starts from the beginning."""
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
    """Return the mean of the finite values."""
    xp = array_namespace(values)
    known = xp.isfinite(values)
    return xp.sum(xp.where(known, values, 0.0)) / xp.sum(xp.astype(known, values.dtype))


def columns(layout: Layout, names: tuple[str, ...]) -> np.ndarray:
    """Return the columns of some parts in a flat observation."""
    starts = dict(
        zip([name for name, _ in layout], np.cumsum([0, *(n for _, n in layout)])[:-1], strict=True)
    )
    sizes = dict(layout)
    return np.concatenate([starts[name] + np.arange(sizes[name]) for name in names])
