"""The lift test as a Gymnasium environment, ``fungrasp/Lift-v0`` (extra ``gymnasium``).

It is registered by importing this module, or by an id with the module's name:
``gymnasium.make_vec("fungrasp.training.gymnasium_env:fungrasp/Lift-v0", num_envs=64, hand="allegro")``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, load_grasps, load_objects
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import retarget
from fungrasp.sim2real import preset
from fungrasp.task.features import INPUT_LIMIT
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.settings import EnvironmentSettings, TrainSpec, Variety
from fungrasp.training.training_sets import build_plan_library

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise FungraspError(
        'environments of Gymnasium need the package gymnasium: pip install ".[gymnasium]" in the clone'
    ) from error

ID = "fungrasp/Lift-v0"
"""Id of the environment."""

Named = dict[str, np.ndarray]
"""Observations, by name of the part."""


def lift_worlds(
    count: int,
    hand: Hand | str = "allegro",
    grasps: str | Path | HumanGraspSet | RobotGraspSet = "builtin",
    objects: str | Path | Mapping[str, ObjectModel] | None = None,
    worlds: str = "moderate",
    settings: EnvironmentSettings | None = None,
    copies: int = 1,
    seed: int = 0,
    threads: int = 0,
) -> TrainingEnvironment:
    """Make the worlds of the environments below, which take the same arguments.

    Args:
        grasps: human grasps, which are retargeted, or robot grasps of ``hand``; or a file of grasps, or
            "builtin".
        objects: objects of the grasps, or a folder of meshes ``<name>.obj``; None for built-in objects.
        worlds: randomization of the worlds: "nominal", "moderate", "wide" or "reality".
        settings: settings of the episodes, except number of worlds, randomization, and history, which is off.

    Raises:
        FungraspError: a file or an object can't be read, the grasps are of another hand, or a name is
            unknown.
    """
    hand = as_hand(hand)
    if not isinstance(grasps, HumanGraspSet | RobotGraspSet):
        grasps = load_grasps(grasps)
    if not isinstance(objects, Mapping):
        objects = load_objects(grasps, objects)
    if isinstance(grasps, HumanGraspSet):
        grasps = retarget(grasps, objects, hand, threads=threads)
    grasps.check_hand(hand)
    spec = TrainSpec(seed=seed, threads=threads, variety=Variety(copies))
    library = build_plan_library(grasps, objects, hand, spec)
    settings = EnvironmentSettings.given(settings)
    settings = replace(settings, worlds=count, randomization=preset(worlds), history=False)
    return TrainingEnvironment(library, objects, hand, settings, seed, threads)


class LiftVectorEnv(VectorEnv[Named, np.ndarray, np.ndarray]):
    """Parallel worlds of the lift test, each with its own grasp.

    Actions are residual actions in [-1, 1] (``ResidualSettings``). Observations are a dictionary of the parts
    of the layout; ``gymnasium.wrappers.vector.FlattenObservation`` concatenates them. When an episode ends,
    the next one begins in the same step, and ``infos`` contains "final_obs" and "success" of the ended one.
    All episodes terminate; none is truncated.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs: int = 1, privileged: bool = False, **arguments: Any):
        """
        Args:
            num_envs: W, number of worlds.
            privileged: whether observations include true contacts and forces.
            arguments: see ``lift_worlds``, without ``count``.
        """
        self.worlds = lift_worlds(num_envs, **arguments)
        self.num_envs, self._privileged = num_envs, privileged
        self.single_observation_space = _observation_space(self.worlds, privileged)
        self.single_action_space = _action_space(self.worlds)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Named, dict[str, Any]]:
        """Begin new episodes in all worlds. seed: new random seed; of a list, the first element is used."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed, options=options)
        if seed is not None:
            self.worlds.reseed(seed)
        self.worlds.begin(np.arange(self.num_envs))
        return _observe(self.worlds, self._privileged), {}

    def step(self, actions: np.ndarray) -> tuple[Named, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance by one control period of 0.1 s. actions: shape [W, A]."""
        step = self.worlds.advance(np.asarray(actions, dtype=np.float64))
        ended, infos = self.worlds.end(step).worlds, {}
        if len(ended):
            final = _observe(self.worlds, self._privileged)
            kept = np.full(self.num_envs, None, dtype=object)
            for w in ended:
                kept[w] = {name: value[w] for name, value in final.items()}
            infos = {"final_obs": kept, "success": step.success}
            infos |= {f"_{name}": step.done.copy() for name in tuple(infos)}
            self.worlds.begin(ended)
        seen = _observe(self.worlds, self._privileged)
        return seen, step.reward, step.done, np.zeros(self.num_envs, dtype=bool), infos


class LiftEnv(gymnasium.Env[Named, np.ndarray]):
    """One world of the lift test; see ``LiftVectorEnv``. At the end of an episode, ``info`` has "success"."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, privileged: bool = False, render_mode: None = None, **arguments: Any):
        """
        Args:
            privileged: whether observations include true contacts and forces.
            render_mode: None; use ``fungrasp evaluate --record`` and ``fungrasp view`` to see episodes.
            arguments: see ``lift_worlds``, without ``count``.
        """
        self.render_mode = render_mode
        self.worlds = lift_worlds(1, **arguments)
        self._privileged = privileged
        self.observation_space = _observation_space(self.worlds, privileged)
        self.action_space = _action_space(self.worlds)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Named, dict[str, Any]]:
        """Begin a new episode. seed: new random seed."""
        super().reset(seed=seed, options=options)
        if seed is not None:
            self.worlds.reseed(seed)
        self.worlds.begin(np.arange(1))
        return self._seen(), {}

    def step(self, action: np.ndarray) -> tuple[Named, float, bool, bool, dict[str, Any]]:
        """Advance by one control period of 0.1 s. action: shape [A]."""
        step = self.worlds.advance(np.asarray(action, dtype=np.float64)[None])
        self.worlds.end(step)
        done = bool(step.done[0])
        info = {"success": bool(step.success[0])} if done else {}
        return self._seen(), float(step.reward[0]), done, False, info

    def _seen(self) -> Named:
        return {name: value[0] for name, value in _observe(self.worlds, self._privileged).items()}


def _observe(worlds: TrainingEnvironment, privileged: bool) -> Named:
    parts = worlds.named_observations(privileged)
    return {name: np.nan_to_num(value) for name, value in parts.items()}


def _observation_space(worlds: TrainingEnvironment, privileged: bool) -> spaces.Space[Named]:
    parts = worlds.named_observations(privileged)
    boxes: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(-INPUT_LIMIT, INPUT_LIMIT, value.shape[1:]) for name, value in parts.items()
    }
    return cast("spaces.Space[Named]", spaces.Dict(boxes))


def _action_space(worlds: TrainingEnvironment) -> spaces.Box:
    return spaces.Box(-1.0, 1.0, (worlds.actions,))


gymnasium.register(ID, entry_point=LiftEnv, vector_entry_point=LiftVectorEnv)
