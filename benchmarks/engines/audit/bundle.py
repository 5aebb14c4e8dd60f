"""All that another physics engine needs to play a recorded episode again: the hand, its servos and couplings,
the object, what the servos were told, and what came of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.engines.audit.hand_parts import (
    Body,
    CoupledJoints,
    Inertia,
    Vector,
    hand_apart,
    hand_bodies,
    hand_couplings,
    rows,
    short,
    vector,
)
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json
from fungrasp.core.records import record_from_json, record_to_json
from fungrasp.evaluation.trajectory import PHASES, Trajectory
from fungrasp.geometry.poses import relative, transform_points
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.simulation import build_scene
from fungrasp.simulation.scene import Scene
from fungrasp.task.use import TABLE_AWAY, displacement, moved_too_far

SUFFIX = ".episode.json"
"""Of a bundle's file."""
LARGEST = 64_000_000
"""Bytes of the largest bundle that is read."""


@dataclass(frozen=True)
class EpisodeBundle:
    """A recorded episode of the lift test, or of a use test in which only the hand moves. Poses are
    in the world frame: z up, table top of the lift test at z = 0."""

    name: str
    """Of the recording."""
    hand: str
    """Name of the hand."""
    palm: str
    """Name of the palm's body."""
    links: tuple[tuple[str, ...], ...]
    """Bodies of each contact link."""
    bodies: tuple[Body, ...]
    """Of the floating wrist and the hand, parents first."""
    couplings: tuple[CoupledJoints, ...]
    """Joints that move with others."""
    apart: tuple[tuple[str, str], ...]
    """Pairs of bodies that do not collide."""
    object_name: str
    """Name of the object."""
    object_inertia: Inertia
    """Of the object, object frame."""
    pieces: tuple[tuple[Vector, ...], ...]
    """Corners of the object's convex pieces [m], object frame."""
    gravity: float
    """[m/s^2]; the hand's weight is compensated."""
    friction: float
    """Sliding friction of hand, object and table."""
    torsional_friction: float
    """Of all contacts, where an engine has it [m]."""
    timestep: float
    """Physics step of the own engine [s]."""
    wrist_reference: Vector
    """Frame in which the wrist's joints count, 7 numbers."""
    servos: tuple[str, ...]
    """Joints that have one, in the order of the setpoints."""
    start: Mapping[str, float]
    """Position of every joint at the start [rad] or [m]."""
    object_pose: Vector
    """Where the object rests at the start, 7 numbers."""
    period: float
    """Time between two setpoints [s]."""
    setpoints: tuple[Vector, ...]
    """The first is that of the start."""
    lift_time: float
    """When the lift began [s]; infinity is written as -1."""
    hold_time: float
    """Likewise the hold."""
    success: bool
    """Whether the object was lifted and held."""
    reason: str
    """Why not."""
    poses_in_palm: tuple[Vector, ...]
    """Of the object, after each setpoint, 7 numbers each."""
    object_poses: tuple[Vector, ...]
    """Of the object then, world frame, 7 numbers each."""
    contacts: tuple[tuple[bool, ...], ...]
    """Which links touched the object then."""
    table_height: float = 0.0
    """Of the table top [m]."""
    use: bool = False
    """Whether it is of a use test, in which the object has to stay where it is in the palm."""

    @cached_property
    def center(self) -> np.ndarray:
        """Center of mass of the object [m], object frame, shape [3]."""
        return np.array(self.object_inertia.center)

    @cached_property
    def told(self) -> np.ndarray:
        """The setpoints, shape [1 + S, J]."""
        return np.array(self.setpoints)

    def save(self, folder: Path) -> None:
        """Write to ``<name>.episode.json``.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(folder / (self.name + SUFFIX)) as temporary:
            temporary.write_text(json.dumps(record_to_json(self)) + "\n")


def load_bundle(path: Path) -> EpisodeBundle:
    """Read a bundle.

    Raises:
        FungraspError: no such file, or no bundle.
    """
    return record_from_json(EpisodeBundle, read_json(path, "episode", LARGEST), f"the episode {path}")


def make_bundle(name: str, recorded: Trajectory, scene: Scene) -> EpisodeBundle:
    """The bundle of a recorded episode.

    Args:
        name: of the recording.
        recorded: in a nominal world, with what the servos were told. A use test succeeds here where the
            object stays in the palm, wherever the hand touches it.
        scene: of its hand and its object.

    Raises:
        FungraspError: the recording lacks something, or the hand has what other engines are not told of.
    """
    if recorded.controls is None:
        raise FungraspError(
            f"{name} does not hold what the servos were told: record it anew, or leave it out where it is "
            "of a use test in which the world pushes or pulls at the object"
        )
    if recorded.differs:
        raise FungraspError(
            f"{name} is of a world in which these differ from the nominal one, which is not recorded: "
            f"{recorded.differs}"
        )
    model, hand = scene.model, scene.hand
    thing = scene.models[scene.indices([recorded.object_name])[0]]
    servos = np.concatenate([scene.wrist_actuators, scene.finger_actuators])
    driven = [model.joint(int(model.actuator_trnid[servo, 0])).name for servo in servos]
    joints = [
        model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE
    ]
    begins = [recorded.times[recorded.phase >= PHASES.index(p)] for p in ("lift", "hold")]
    lift, hold = (float(times[0]) if len(times) else -1.0 for times in begins)
    in_palm, success, reason = _in_palm(recorded), recorded.success, recorded.reason
    if recorded.is_use_test:
        lift = hold = 0.0
        reason = moved_in_palm(in_palm[0], in_palm[1:], thing.center_of_mass)
        success = not reason
    return EpisodeBundle(
        name=name,
        hand=hand.name,
        palm=hand.palm,
        links=tuple(tuple(members) for members in hand.links),
        bodies=hand_bodies(model),
        couplings=hand_couplings(name, model),
        apart=hand_apart(model),
        object_name=recorded.object_name,
        object_inertia=Inertia(
            recorded.object_mass,
            vector(thing.center_of_mass),
            rows(thing.inertia * (recorded.object_mass / thing.mass)),
        ),
        pieces=tuple(rows(piece.vertices) for piece in thing.pieces),
        gravity=scene.settings.gravity,
        friction=scene.settings.friction,
        torsional_friction=scene.settings.torsional_friction,
        timestep=scene.settings.timestep,
        wrist_reference=vector(recorded.wrist_reference),
        servos=tuple(short(joint) for joint in driven),
        start={short(j): float(recorded.qpos[0, model.joint(j).qposadr[0]]) for j in joints},
        object_pose=vector(recorded.object_pose[0]),
        period=float(np.median(np.diff(recorded.times))),
        setpoints=rows(recorded.controls),
        lift_time=lift,
        hold_time=hold,
        success=success,
        reason=reason,
        poses_in_palm=rows(in_palm[1:]),
        object_poses=rows(recorded.object_pose[1:]),
        contacts=tuple(tuple(map(bool, row)) for row in recorded.link_contacts[1:]),
        table_height=TABLE_AWAY if recorded.is_use_test else 0.0,
        use=recorded.is_use_test,
    )


def moved_in_palm(start: np.ndarray, poses: np.ndarray, center: np.ndarray) -> str:
    """Why an object has not stayed in the palm during a use test, "" if it has.

    Args:
        start: its pose there when the motion began, shape [7].
        poses: and during it, shape [T, 7].
        center: of its mass, object frame [m], shape [3].
    """
    centers = transform_points(np.stack([start, *poses]), center[None, None])[:, 0]
    shift, turn = displacement((centers[0], start[3:]), (centers[1:], poses[:, 3:]))
    return moved_too_far(float(shift.max()), float(turn.max()))


def scene_of(recorded: Trajectory, objects: Mapping[str, ObjectModel]) -> Scene:
    """The scene of a recording. objects: by name, its own among them."""
    name = recorded.object_name
    return build_scene(load_hand(recorded.hand), {name: objects[name]})


def _in_palm(recorded: Trajectory) -> np.ndarray:
    """The object's poses in the palm, shape [T, 7]."""
    return relative(recorded.palm_pose.astype(float), recorded.object_pose.astype(float))
