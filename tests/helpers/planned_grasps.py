"""Grasps of a can and a ball, their motions, and tasks that are ready to play them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from fungrasp.planning.references import References

from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import Motion
from fungrasp.policies.plan_tracking import Tracker
from fungrasp.policies.scripted import planned
from fungrasp.retarget import retarget
from fungrasp.simulation import Scene, Worlds, build_scene
from fungrasp.task import LiftTask, Protocol
from fungrasp.task.observation import layout, observe, privileged


@cache
def hand() -> Hand:
    return load_hand("allegro")


@cache
def grasps_and_objects() -> tuple[RobotGraspSet, Mapping[str, ObjectModel]]:
    """One grasp of each."""
    human = builtin_grasps()
    human = human.select([np.flatnonzero(human.object_name == name)[0] for name in ("can", "tennis_ball")])
    objects = load_objects(human)
    return retarget(human, objects, hand()), objects


@cache
def scene() -> Scene:
    return build_scene(hand(), grasps_and_objects()[1])


def start(protocol: Protocol | None = None) -> LiftTask:
    """A task that has been reset."""
    grasps, _ = grasps_and_objects()
    index = np.array([scene().objects.index(name) for name in grasps.object_name.tolist()])
    task = LiftTask(scene(), grasps, Worlds(scene(), index, grasps.object_mass, threads=1), protocol)
    task.reset()
    return task


@cache
def motion() -> Motion:
    """Of both grasps."""
    return planned(start(), grasps_and_objects()[1])


def references() -> References:
    """Of both grasps."""
    grasps, _ = grasps_and_objects()
    return References.of(motion(), grasps, start().settled_pose, hand())


def tracker(task: LiftTask | None = None, **options) -> Tracker:
    """At its beginning, each world with its own grasp."""
    result = Tracker(task or start(), grasps_and_objects()[1], references(), **options)
    result.begin(np.arange(2), np.arange(2))
    return result


def layouts() -> tuple[tuple[tuple[str, int], ...], tuple[tuple[str, int], ...]]:
    """Of the observation and the privileged observation."""
    at_work = tracker()
    view, sensed = at_work.view(), at_work.sensed()
    return (
        layout(observe(view.now, view.before, view.wanted, view.action)),
        layout(privileged(sensed.contacts, sensed.forces, view.wanted.contacts)),
    )
