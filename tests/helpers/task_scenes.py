"""Grasps and objects made for the tests of the task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import trimesh

from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ConvexPiece, ObjectModel
from fungrasp.simulation import MujocoCpuEngine, build_scene
from fungrasp.task import Action, LiftTask
from fungrasp.task.protocol import LiftProtocol

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""A palm upside down: its z axis points at the table."""


@cache
def hand() -> Hand:
    return load_hand("allegro")


@cache
def plain(name: str, size: tuple[float, float, float], mass: float = 0.2) -> ObjectModel:
    mesh = trimesh.creation.box(size)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
    return ObjectModel(name, mass, vertices, faces, construction=(ConvexPiece(vertices, faces),))


def above(objects: Sequence[ObjectModel], height: float = 0.3) -> RobotGraspSet:
    """Hands flat above objects that stand on the table; every finger link should touch."""
    count = len(objects)
    rest = np.array([obj.rest_pose() for obj in objects])
    wrist = np.concatenate([rest[:, :3] + [0.0, 0.0, height], np.tile(DOWN, (count, 1))], axis=1)
    contacts = np.ones((count, len(hand().links)), dtype=bool)
    contacts[:, 0] = False
    return RobotGraspSet(
        hand=hand().name,
        object_name=np.array([obj.name for obj in objects]),
        object_mass=np.array([obj.mass for obj in objects]),
        object_pose=rest,
        object_rest_pose=rest,
        wrist_pose=wrist,
        joint_names=hand().joint_names,
        joint_positions=np.zeros((count, len(hand().joint_names))),
        keypoints=np.zeros((count, len(hand().keypoint_names), 3)),
        link_contacts=contacts,
    )


def ready(objects: Sequence[ObjectModel], protocol: LiftProtocol | None = None, threads: int = 1) -> LiftTask:
    """A task whose objects have settled, a hand 30 cm above each."""
    kinds = {obj.name: obj for obj in objects}
    scene = build_scene(hand(), kinds)
    engine = MujocoCpuEngine(scene, len(objects), threads)
    grasps = above(objects)
    engine.set_parameters(object_index=scene.indices(grasps.object_name.tolist()))
    task = LiftTask(engine, protocol)
    task.settle(grasps)
    return task


def stay(task: LiftTask, lift: bool | np.ndarray = False) -> Action:
    """Remain at the target, fingers as they are."""
    lifts = np.broadcast_to(np.asarray(lift), len(task.engine)).copy()
    return Action(task.engine.wrist_frame, task.setpoints.fingers.copy(), lifts)


def run(task: LiftTask, lift_from: float = np.inf, after: Callable[[], None] = lambda: None) -> None:
    """Stay until all episodes are over. lift_from: when the lift begins [s]; after: each setpoint."""
    while not task.done.all():
        task.step(stay(task, task.time >= lift_from - 1e-9), after=after)
