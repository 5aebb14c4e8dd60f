"""The six-direction test (docs/evaluation.md): does a closed hand keep an object pushed along each axis?"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.evaluation.lift_test import CHUNK, check_hand
from fungrasp.geometry.poses import compose, invert, rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.planning.grasp_motion import ReferenceSettings
from fungrasp.planning.grip_forces import squeeze_torques
from fungrasp.simulation import Scene, SceneSettings, Worlds, build_scene
from fungrasp.transfer import move_table

DIRECTIONS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""Of the pushes, world frame, in the order of the results."""


@dataclass(frozen=True)
class StaticProtocol:
    """The numbers of the test, those of DexGraspBench's force-closure test."""

    mass: float = 0.1
    """Of every object [kg]."""
    friction: float = 0.6
    """Sliding friction."""
    torsional_friction: float = 0.02
    """[m]."""
    force_per_mass: float = 10.0
    """[N/kg]."""
    close_time: float = 0.6
    """From the grasp to the full squeeze [s]."""
    pause: float = 0.2
    """Before each push [s]."""
    push_time: float = 2.0
    """[s]."""
    distance_limit: float = 0.05
    """An object that moves farther in the hand has been lost [m]."""
    angle_limit: float = np.deg2rad(15.0)
    """As has one that turns farther [rad]."""


@dataclass(frozen=True, eq=False)
class StaticResult:
    """Outcome for N grasps."""

    passed: np.ndarray
    """All six pushes held, shape [N] bool."""
    displacement_m: np.ndarray
    """Of the object's centre of mass in the palm's frame at the end of each push, since before the squeeze,
    shape [N, 6]."""
    angle_rad: np.ndarray
    """Turn of the object in the palm's frame, shape [N, 6]."""


def six_direction_test(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    *,
    protocol: StaticProtocol | None = None,
    threads: int = 0,
    chunk: int = CHUNK,
    progress: Callable[[int], None] = lambda done: None,
) -> StaticResult:
    """Close the hand around an object that floats without gravity, far from any table, and push the object.

    The palm stands at the grasp, the fingers start at the grasp's joint positions and squeeze as the
    reference controller does.

    Args:
        grasps: N grasps of ``hand``.
        objects: by name.
        hand: the robot hand.
        protocol: the published one if None.
        threads: 0 means all processors. The result does not depend on it.
        chunk: grasps simulated together.
        progress: called with the number of grasps that are done.

    Raises:
        FungraspError: grasps of another hand.
    """
    check_hand(grasps, hand)
    p = protocol or StaticProtocol()
    settings = SceneSettings(friction=p.friction, torsional_friction=p.torsional_friction)
    scene = build_scene(hand, objects, settings)
    scene.model.opt.gravity[:] = 0.0
    parts = []
    for start in range(0, len(grasps), chunk):
        part = grasps.select(slice(start, start + chunk))
        parts.append(_push(scene, part, objects, p, threads))
        progress(start + len(part))
    displacement, angle = (np.concatenate(values) for values in zip(*parts, strict=True))
    # NaN, from a simulation that diverged, is not within the limits.
    held = (displacement < p.distance_limit) & (angle < p.angle_limit)
    return StaticResult(np.all(held, axis=1), displacement, angle)


def _push(
    scene: Scene, grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], p: StaticProtocol, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and angle, shape [W, 6] each."""
    names = {name: i for i, name in enumerate(scene.objects)}
    index = np.array([names[name] for name in grasps.object_name.tolist()])
    worlds = Worlds(scene, index, mass=np.full(len(grasps), p.mass), threads=threads)
    move_table(worlds, -100.0)
    matrix, offset = scene.hand.coupling
    closed = (grasps.joint_positions - offset) @ np.linalg.pinv(matrix).T
    squeezed = closed + _servo_offsets(scene.hand, grasps, closed, objects, p.mass)
    worlds.reset()
    worlds.object_pose, worlds.wrist_reference = grasps.object_pose, grasps.wrist_pose
    worlds.joint_positions = closed @ matrix.T + offset
    worlds.forward()
    before, center = compose(invert(worlds.palm_pose), worlds.object_pose), _center_in_palm(worlds)
    steps = round(p.close_time / scene.settings.timestep)
    for step in range(steps):
        worlds.ctrl[:, scene.finger_actuators] = closed + (step + 1) / steps * (squeezed - closed)
        worlds.step(1)
    worlds.step(round(p.pause / scene.settings.timestep))
    states = [worlds.qpos, worlds.qvel, worlds.batch.bind("qacc_warmstart")]
    kept = [state.copy() for state in states]
    push = worlds.batch.bind("xfrc_applied")
    body = scene.model.body("object").id
    displacement, angle = np.empty((len(grasps), 6)), np.empty((len(grasps), 6))
    for k, direction in enumerate(DIRECTIONS):
        for state, value in zip(states, kept, strict=True):
            state[:] = value
        push[:, body, :3] = p.force_per_mass * p.mass * direction
        worlds.step(round(p.push_time / scene.settings.timestep))
        now = compose(invert(worlds.palm_pose), worlds.object_pose)
        displacement[:, k] = np.linalg.norm(_center_in_palm(worlds) - center, axis=1)
        angle[:, k] = np.linalg.norm(rotation_vector(compose(invert(before), now)[:, 3:]), axis=1)
    return displacement, angle


def _servo_offsets(
    hand: Hand, grasps: RobotGraspSet, closed: np.ndarray, objects: Mapping[str, ObjectModel], mass: float
) -> np.ndarray:
    """The reference controller's squeeze, as offsets of the servo targets [rad], shape [W, U]."""
    s = ReferenceSettings()
    names = grasps.object_name.tolist()
    around = CollisionScene.settled(names, grasps.object_pose, objects)
    wrist = compose(invert(grasps.object_pose), grasps.wrist_pose)
    models = [objects[name] for name in names]
    torques = squeeze_torques(hand, around, models, wrist, closed, grasps.link_contacts)
    stiffness = np.array([servo.kp for servo in hand.actuators.values()])
    force = (s.force + s.force_per_kg * mass) * grasps.extra.get("force_scale", np.ones(len(grasps)))
    return np.clip(force[:, None] * torques / stiffness, -s.squeeze_limit, s.squeeze_limit)


def _center_in_palm(worlds: Worlds) -> np.ndarray:
    """Object's centre of mass, palm frame [m], shape [W, 3]."""
    center = np.concatenate([worlds.center_of_mass, np.tile([1.0, 0.0, 0.0, 0.0], (len(worlds), 1))], axis=1)
    return compose(invert(worlds.palm_pose), center)[:, :3]
