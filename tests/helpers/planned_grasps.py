"""Grasps of a can and a ball, their plans, and environments that are ready to play them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies.plan_tracking import PlanTracker
from fungrasp.retargeting import retarget
from fungrasp.simulation import Scene, build_scene
from fungrasp.task import Belief, GraspPlan, LiftEnvironment
from fungrasp.task.features import contact_features, layout


@cache
def hand() -> Hand:
    return load_hand("allegro")


@cache
def grasps_and_objects() -> tuple[RobotGraspSet, Mapping[str, ObjectModel]]:
    """One grasp of each."""
    human = builtin_grasps()
    human = human.select([np.flatnonzero(human.object_name == name)[0] for name in ("can", "tennis_ball")])
    objects = load_objects(human)
    return retarget(human, objects, hand(), threads=1), objects


@cache
def scene() -> Scene:
    return build_scene(hand(), grasps_and_objects()[1])


def start(**options: Any) -> LiftEnvironment:
    """An environment whose objects have settled. options: of ``LiftEnvironment``."""
    environment = LiftEnvironment(scene(), 2, threads=1, **options)
    environment.settle(grasps_and_objects()[0])
    return environment


@cache
def belief() -> Belief:
    """Of both scenes, all of it true."""
    return LiftEnvironment(scene(), 2, threads=1).settle(grasps_and_objects()[0])


@cache
def plan() -> GraspPlan:
    """Of both grasps."""
    grasps, objects = grasps_and_objects()
    return MotionPlanner(hand(), objects).plan(grasps, belief())


def tracker(environment: LiftEnvironment | None = None, **options: Any) -> PlanTracker:
    """At its beginning, each world with its own plan."""
    result = PlanTracker(hand(), grasps_and_objects()[1], plan(), 2, **options)
    both = np.arange(2)
    result.begin(both, both, (environment or start()).observe())
    return result


@cache
def layouts() -> tuple[tuple[tuple[str, int], ...], tuple[tuple[str, int], ...]]:
    """Of what a student sees, and of the contacts that a teacher sees besides."""
    environment = start()
    seen, privileged = tracker(environment).state(), environment.privileged()
    contacts = contact_features(privileged.contacts, privileged.forces, seen.target.contacts)
    return layout(seen.robot_features()), layout(contacts)
