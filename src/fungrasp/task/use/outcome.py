"""Outcomes of use tests: displacement of objects, and contacts on the parts that the person held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import quaternion_conjugate, quaternion_multiply, relative, rotation_vector
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_parts
from fungrasp.task.environment import LiftEnvironment

LARGEST_SHIFT = 0.01
"""Largest accepted displacement of the object's center of mass in the palm [m]."""

LARGEST_TURN = np.deg2rad(10.0)
"""Largest accepted turn of the object in the palm [rad]."""


@dataclass(frozen=True, eq=False, repr=False)
class UseOutcomes(BatchRecord):
    """Outcomes of W use tests, shape [W] each; NaN and "" if not tested."""

    motion: np.ndarray
    """Name of the motion, "" if the task has none or the object was not held, str."""
    success: np.ndarray
    """Whether the object stayed in the palm and the task's requirements were met, bool."""
    shift_m: np.ndarray
    """Largest displacement of the object's center of mass in the palm during the motion [m]."""
    turn_rad: np.ndarray
    """Largest turn of the object in the palm during the motion [rad]."""
    trigger_force_n: np.ndarray
    """Force of the pressing finger on the object at the end [N]; NaN without a trigger."""
    functional_contact: np.ndarray
    """Share of the target links that touch the part which the person touched there, at the start of the
    motion."""
    reason: np.ndarray
    """Why the test failed, "" on success, str."""


def displacement(
    start: tuple[np.ndarray, np.ndarray], now: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements [m] and turns [rad] of objects in the palm, shape [I] each.

    Args:
        start: centers of mass [m], shape [I, 3], and rotations, shape [I, 4], palm frame; the first axis may
            be missing.
        now: the same, later.
    """
    turn = rotation_vector(quaternion_multiply(now[1], quaternion_conjugate(start[1])))
    return np.linalg.norm(now[0] - start[0], axis=-1), np.linalg.norm(turn, axis=-1)


def moved_too_far(shift: float, turn: float) -> str:
    """Return why an object has not stayed in the palm, "" if it has. shift: [m]; turn: [rad]."""
    if shift > LARGEST_SHIFT:
        return "the object slipped in the palm"
    if turn > LARGEST_TURN:
        return "the object turned in the palm"
    return ""


def functional_contact(environment: LiftEnvironment) -> tuple[np.ndarray, np.ndarray]:
    """Measure contacts with the parts that the person touched.

    Returns:
        Share of the target links that touch the part with the person's contact, shape [W]; any part counts
        for the palm and for unknown contacts. Name of the part that each link touches or would touch first,
        shape [W, L] str.
    """
    engine, scene, shown = environment.engine, environment.scene, environment.task.shown
    models = [scene.models[i] for i in engine.object_index]
    parts = touched_parts(
        scene.hand,
        models,
        relative(engine.object_pose, engine.palm_pose),
        scene.hand.independent(engine.joint_positions),
    )
    wanted, actual = environment.task.target_contacts, engine.link_contacts
    right = np.ones_like(wanted)
    if shown is not None:
        for world, model in enumerate(models):
            if model.parts:
                right[world, 1:] = parts[world, 1:] == nearest_parts(model, shown.places[world])
    share = (wanted & actual & right).sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
    return share, parts


def touched_parts(
    hand: Hand, models: Sequence[ObjectModel], palm: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    """Return the name of the part that each link touches or would touch first, "" for objects without parts,
    shape [N, L] str.

    Args:
        models: object models, N of them.
        palm: poses, object frame, shape [N, 7].
        joints: independent joints [rad], shape [N, U].
    """
    spheres = collision_spheres(hand)
    kinematics = HandKinematics(hand, len(models))
    kinematics.update(palm, joints)
    centers = kinematics.points(spheres.points)
    touched = np.full((len(models), len(hand.links)), "", dtype=object)
    different = {id(model): model for model in models if model.parts}
    for model in different.values():
        rows = np.flatnonzero([other is model for other in models])
        bank, first = SignedDistanceBank([model.signed_distance]), np.zeros(len(rows), dtype=int)
        gap = bank.query(first, centers[rows])[0] - spheres.radius
        nearest, least = spheres.nearest(gap, len(hand.links))
        found = np.take_along_axis(centers[rows], nearest[..., None], axis=1).reshape(-1, 3)
        touched[rows] = np.where(np.isfinite(least), nearest_parts(model, found).reshape(least.shape), "")
    return touched.astype(str)
