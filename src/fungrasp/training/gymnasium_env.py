"""The lift test as an environment of Gymnasium, ``fungrasp/Lift-v0`` (extra ``gymnasium``).

Importing this module registers it; so does an id that names the module:
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
"""Observations by name of their part."""


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
    """The worlds of the environments below; their arguments are these.

    Args:
        grasps: human grasps, which are retargeted, or robot grasps of ``hand``; or a file of them, or
            "builtin".
        objects: of the grasps, or a folder of meshes ``<name>.obj``; built-in objects need none.
        worlds: what episodes draw their worlds from: "nominal", "moderate", "wide" or "reality".
        settings: of the episodes, but for the number of worlds, what they are drawn from, and histories,
            which there are none of.

    Raises:
        FungraspError: a file or an object can't be read, grasps of another hand, or an unknown name.
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
    settings = settings or EnvironmentSettings()
    settings = replace(settings, worlds=count, randomization=preset(worlds), history=False)
    return TrainingEnvironment(library, objects, hand, settings, seed, threads)


class LiftVectorEnv(VectorEnv[Named, np.ndarray, np.ndarray]):
    """Many worlds of the lift test, each with a grasp of its own, simulated together.

    Actions are residual actions in [-1, 1] (``ResidualSettings``). Observations are a dictionary of the parts
    of the layout; ``gymnasium.wrappers.vector.FlattenObservation`` makes one array of them. Where an episode
    ends, the next one begins in the same step; ``infos`` then holds "final_obs" and "success" of the one that
    ended. All episodes terminate, none is truncated.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs: int = 1, privileged: bool = False, **arguments: Any):
        """
        Args:
            num_envs: W, number of worlds.
            privileged: whether observations hold the contacts and forces that only a simulation knows.
            arguments: of ``lift_worlds``, but for ``count``.
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
        """Begin new episodes in all worlds. seed: of everything random from here on; the first one of a
        list."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed, options=options)
        if seed is not None:
            self.worlds.reseed(seed)
        self.worlds.begin(np.arange(self.num_envs))
        return _observe(self.worlds, self._privileged), {}

    def step(self, actions: np.ndarray) -> tuple[Named, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control period of 0.1 s. actions: shape [W, A]."""
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
    """One world of the lift test; see ``LiftVectorEnv``. ``info`` holds "success" where an episode ends."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, privileged: bool = False, render_mode: None = None, **arguments: Any):
        """
        Args:
            privileged: whether observations hold the contacts and forces that only a simulation knows.
            render_mode: None; ``fungrasp evaluate --record`` and ``fungrasp view`` show episodes.
            arguments: of ``lift_worlds``, but for ``count``.
        """
        self.render_mode = render_mode
        self.worlds = lift_worlds(1, **arguments)
        self._privileged = privileged
        self.observation_space = _observation_space(self.worlds, privileged)
        self.action_space = _action_space(self.worlds)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Named, dict[str, Any]]:
        """Begin a new episode. seed: of everything random from here on."""
        super().reset(seed=seed, options=options)
        if seed is not None:
            self.worlds.reseed(seed)
        self.worlds.begin(np.arange(1))
        return self._seen(), {}

    def step(self, action: np.ndarray) -> tuple[Named, float, bool, bool, dict[str, Any]]:
        """One control period of 0.1 s. action: shape [A]."""
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
