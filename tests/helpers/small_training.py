"""A training small enough for tests: two objects, a few worlds, a few steps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.policies.checkpoint.card import PolicyCard
from fungrasp.policies.checkpoint.checkpoint_file import load_policy
from fungrasp.retargeting import retarget
from fungrasp.simulation import Device, SceneSettings
from fungrasp.training.distill import train_student
from fungrasp.training.environment import TrainingEnvironment
from fungrasp.training.settings import (
    CurveSettings,
    DistillSettings,
    EnvironmentSettings,
    PpoSettings,
    StudentSpec,
    TrainSpec,
    Variety,
)
from fungrasp.training.train import train
from fungrasp.training.training_sets import PlanLibrary, TrainingSet, build_plan_library

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
    return build_plan_library(
        one.grasps, one.objects, hand(), TrainSpec(threads=1, variety=Variety(copies=2))
    )


def environment(seed: int = 0, device: Device = "cpu", **settings: Any) -> TrainingEnvironment:
    chosen = EnvironmentSettings(**({"worlds": WORLDS} | settings))
    physics = SceneSettings(device=device)
    return TrainingEnvironment(library(), training_set().objects, hand(), chosen, seed, 1, physics)


def run_spec(steps: float = BATCH, curve: CurveSettings | None = None, **ppo: Any) -> TrainSpec:
    return TrainSpec(
        steps,
        threads=1,
        device="cpu",
        curve=curve or CurveSettings(every=0),
        environment=EnvironmentSettings(worlds=WORLDS),
        ppo=replace(PPO, **ppo),
        variety=Variety(copies=1),
    )


def trained(
    folder: Path, spec: TrainSpec | None = None, sets: list[TrainingSet] | None = None, **more: Any
) -> PolicyCard:
    """Train, with fields of the spec; the policy's card."""
    spec = replace(spec or run_spec(), **more)
    return load_policy(train(folder, sets or [training_set()], hand(), spec)).card


def distilled(
    teacher: Path, folder: Path, steps: float, settings: DistillSettings, **more: Any
) -> PolicyCard:
    """Distill; the student's card."""
    spec = StudentSpec(steps, threads=1, settings=settings)
    return load_policy(train_student(teacher, folder, spec, **more)).card


def unusable(grasps: RobotGraspSet) -> RobotGraspSet:
    """The same grasps of objects that lie far below the table."""
    shift = np.array([0.0, 0.0, -50.0, 0.0, 0.0, 0.0, 0.0])
    return replace(
        grasps,
        object_rest_pose=grasps.object_rest_pose + shift,
        object_pose=grasps.object_pose + shift,
        wrist_pose=grasps.wrist_pose + shift,
    )
