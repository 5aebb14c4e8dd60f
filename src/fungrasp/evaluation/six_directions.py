"""The six-direction test (docs/evaluate.md): does a closed hand keep an object pushed along each axis?"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import compose, inverse_transform_points, invert, rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning.grasp_motion import squeeze_offsets
from fungrasp.simulation import Engine, Scene, SceneSettings, build_scene, make_engine
from fungrasp.task import Belief

DIRECTIONS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""Directions of the pushes, world frame, in the order of the results, shape [6, 3]."""


CHUNK = 128
"""Grasps simulated together. It bounds the memory."""


@dataclass(frozen=True)
class StaticProtocol:
    """The numbers of the test, those of DexGraspBench's force-closure test."""

    mass: float = 0.1
    """Mass of every object [kg]."""
    friction: float = 0.6
    """Coefficient of sliding friction."""
    torsional_friction: float = 0.02
    """Coefficient of torsional friction [m]."""
    force_per_mass: float = 10.0
    """Force of each push for each kilogram of the object [N/kg]."""
    close_time: float = 0.6
    """Time from the grasp to the full squeeze [s]."""
    pause: float = 0.2
    """Time before each push [s]."""
    push_time: float = 2.0
    """Duration of each push [s]."""
    distance_limit: float = 0.05
    """Largest displacement in the hand of an object that is held [m]."""
    angle_limit: float = np.deg2rad(15.0)
    """Largest turn in the hand of an object that is held [rad]."""


@dataclass(frozen=True, eq=False)
class StaticResult:
    """Outcome for N grasps."""

    passed: np.ndarray
    """Whether all six pushes held, shape [N] bool."""
    displacement_m: np.ndarray
    """Displacement of the object's center of mass in the palm's frame, from before the squeeze to the end of
    each push [m], shape [N, 6]."""
    angle_rad: np.ndarray
    """Turn of the object in the palm's frame over the same time [rad], shape [N, 6]."""


def six_direction_test(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand | str | None = None,
    *,
    protocol: StaticProtocol | None = None,
    threads: int = 0,
    chunk: int = CHUNK,
    progress: Callable[[int], None] = lambda done: None,
) -> StaticResult:
    """Close the hand around an object that floats without gravity, far from any table, and push the object.

    The palm stands at the grasp, the fingers start at the grasp's joint positions and move to the grasp's own
    ``squeeze_positions``; where it has none, they squeeze as in planned motions.

    Args:
        grasps: N grasps.
        objects: by name.
        hand: the robot hand, or its name; that of the grasps if None.
        protocol: the published one if None.
        threads: 0 means all processors. The result does not depend on it.
        chunk: grasps simulated together.
        progress: called with the number of grasps that are done.

    Raises:
        FungraspError: grasps of another hand.
    """
    hand = grasps.load_hand() if hand is None else as_hand(hand)
    grasps.check_hand(hand)
    check_objects(grasps.object_name.tolist(), objects)
    p = protocol or StaticProtocol()
    settings = SceneSettings(gravity=0.0, friction=p.friction, torsional_friction=p.torsional_friction)
    scene = build_scene(hand, objects, settings)
    parts = []
    for start in range(0, len(grasps), chunk):
        part = grasps.select(slice(start, start + chunk))
        parts.append(_push(scene, part, objects, p, threads))
        progress(start + len(part))
    displacement, angle = (np.concatenate(values) for values in zip(*parts, strict=True))
    # NaN, from a simulation that diverged, is not within the limits.
    held = (displacement < p.distance_limit) & (angle < p.angle_limit)
    return StaticResult(np.all(held, axis=1), displacement, angle)


def squeezed_fingers(
    grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], hand: Hand, mass: float | None = None
) -> np.ndarray:
    """Servo targets with which grasps hold: their own ``squeeze_positions`` within the joints' limits, where
    they have some, else those of planned motions [rad], shape [N, U].

    Args:
        grasps: N grasps.
        objects: by name.
        hand: the robot hand.
        mass: of every object [kg]; their own if None.
    """
    closed = hand.independent(grasps.joint_positions)
    squeezed = hand.independent(np.clip(grasps.squeeze_positions, *hand.joint_limits.T))
    missing = np.isnan(squeezed).any(axis=1)
    if missing.any():
        weighed = grasps if mass is None else replace(grasps, object_mass=np.full(len(grasps), mass))
        belief = Belief.nominal(grasps.object_pose, weighed.object_mass, grasps.wrist_pose, closed)
        palm = compose(invert(grasps.object_pose), grasps.wrist_pose)
        planned = closed + squeeze_offsets(hand, weighed, objects, belief, palm, closed)
        squeezed = np.where(missing[:, None], planned, squeezed)
    return squeezed


def _push(
    scene: Scene, grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], p: StaticProtocol, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and angle, shape [W, 6] each."""
    hand, count = scene.hand, len(grasps)
    index = scene.indices(grasps.object_name.tolist())
    engine = make_engine(scene, count, threads)
    engine.set_parameters(
        object_index=index, object_mass=np.full(count, p.mass), table_height=np.full(count, -100.0)
    )
    closed = hand.independent(grasps.joint_positions)
    squeezed = squeezed_fingers(grasps, objects, hand, p.mass)
    engine.reset()
    engine.set_state(
        object_pose=grasps.object_pose,
        wrist_frame=grasps.wrist_pose,
        joint_positions=hand.all_joints(closed),
    )
    before, center = compose(invert(engine.palm_pose), engine.object_pose), _center_in_palm(engine)
    still = np.zeros((count, 3))
    steps = round(p.close_time / scene.settings.timestep)
    for step in range(steps):
        fingers = closed + (step + 1) / steps * (squeezed - closed)
        engine.step(engine.controls(grasps.wrist_pose, still, fingers), 1)
    controls = engine.controls(grasps.wrist_pose, still, squeezed)
    engine.step(controls, round(p.pause / scene.settings.timestep))
    closed_state = engine.get_state()
    displacement, angle = np.empty((count, 6)), np.empty((count, 6))
    for k, direction in enumerate(DIRECTIONS):
        engine.restore(closed_state)
        engine.push_object(np.tile(p.force_per_mass * p.mass * direction, (count, 1)))
        engine.step(controls, round(p.push_time / scene.settings.timestep))
        now = compose(invert(engine.palm_pose), engine.object_pose)
        displacement[:, k] = np.linalg.norm(_center_in_palm(engine) - center, axis=1)
        angle[:, k] = np.linalg.norm(rotation_vector(compose(invert(before), now)[:, 3:]), axis=1)
    return displacement, angle


def _center_in_palm(engine: Engine) -> np.ndarray:
    """Object's center of mass, palm frame [m], shape [W, 3]."""
    return inverse_transform_points(engine.palm_pose, engine.center_of_mass[:, None])[:, 0]
