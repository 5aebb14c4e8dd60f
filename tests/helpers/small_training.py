"""A training small enough for tests: two objects, a few worlds, a few steps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from fungrasp.training.train import RunSettings

from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.retargeting import retarget
from fungrasp.simulation import Device
from fungrasp.training.environment import EnvironmentSettings, TrainingEnvironment
from fungrasp.training.plan_library import PlanLibrary, Variety, build_plan_library
from fungrasp.training.settings import PpoSettings
from fungrasp.training.training_sets import TrainingSet

WORLDS = 8
PPO = PpoSettings(hidden=(32, 16), steps=6, epochs=2, minibatches=2, warm_up=2)
BATCH = WORLDS * PPO.steps
"""Control steps of an update."""


@cache
def hand() -> Hand:
    return load_hand("allegro")


@cache
def training_set() -> TrainingSet:
    human = builtin_grasps()
    human = human.select([np.flatnonzero(human.object_name == name)[0] for name in ("can", "tennis_ball")])
    objects = load_objects(human)
    return TrainingSet("two grasps", retarget(human, objects, hand(), threads=1), objects, "free")


@cache
def library() -> PlanLibrary:
    one = training_set()
    return build_plan_library(one.grasps, one.objects, hand(), Variety(copies=2), threads=1)


def environment(seed: int = 0, device: Device = "cpu", **settings: Any) -> TrainingEnvironment:
    chosen = EnvironmentSettings(**({"worlds": WORLDS} | settings))
    return TrainingEnvironment(library(), training_set().objects, hand(), chosen, seed, 1, device)


def run_settings(**ppo: Any) -> RunSettings:
    return RunSettings(0, Variety(copies=1), EnvironmentSettings(worlds=WORLDS), replace(PPO, **ppo))


def unusable(grasps: RobotGraspSet) -> RobotGraspSet:
    """The same grasps of objects that lie far below the table."""
    shift = np.array([0.0, 0.0, -50.0, 0.0, 0.0, 0.0, 0.0])
    return replace(
        grasps,
        object_rest_pose=grasps.object_rest_pose + shift,
        object_pose=grasps.object_pose + shift,
        wrist_pose=grasps.wrist_pose + shift,
    )
