"""How hard each finger should press so that the contact forces balance: a small force optimisation per
grasp."""

from __future__ import annotations

import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.contact_forces import balanced_forces
from fungrasp.optimization.hand_state import HandPoints, HandState


def squeeze_torques(
    hand: Hand,
    around: CollisionScene,
    objects: list[ObjectModel],
    wrist_in_object: np.ndarray,
    grasp: np.ndarray,
    contacts: np.ndarray,
    friction: float = 0.6,
    near: float = 0.006,
) -> np.ndarray:
    """Joint torques of balanced contact forces whose normal parts sum to 1 N.

    The forces f >= 0 along the edges of the friction cones at the links that should touch minimise
    |sum of wrenches|^2 + small |f|^2 (torques over half the object's size).

    Args:
        hand: the robot hand.
        around: N objects and tables.
        objects: of each grasp, length N.
        wrist_in_object: shape [N, 7].
        grasp: independent joints [rad], shape [N, U].
        contacts: links that should touch, palm first, shape [N, L] bool.
        friction: coefficient to plan with; less than the true one, to be safe.
        near: links farther from the object than this are left out [m].

    Returns:
        Torques on the independent joints [N m per N], shape [N, U].
    """
    points = HandPoints(HandKinematics(hand, len(around)))
    state = HandState(points, around, wrist_in_object, grasp)
    nearest = np.stack([m[np.argmin(state.clearance[:, m], axis=1)] for m in points.link_members], axis=1)
    # nearest [N, L]: of each link the collision sphere that is nearest to the object.
    clearance = np.take_along_axis(state.clearance, nearest, axis=1)
    normal = np.take_along_axis(state.normals, nearest[..., None], axis=1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    place = (
        np.take_along_axis(state.spheres, nearest[..., None], axis=1)
        - points.spheres.radius[nearest][..., None] * normal
    )
    jacobian = points.kinematics.jacobian(points.spheres.points.bodies[nearest], place)[..., 6:]
    used = contacts & (clearance < near)
    lonely = used.sum(axis=1) < 2
    used[lonely] = (clearance <= np.sort(clearance, axis=1)[:, 2:3])[lonely]
    centers = np.array([model.center_of_mass for model in objects])
    reach = np.array([0.5 * float(np.max(model.size)) for model in objects])
    force = balanced_forces(
        (place - centers[:, None]) / reach[:, None, None], -normal, used, friction, iterations=200
    )
    # Virtual work: tau = sum over contacts of J^T f, with the columns of the joints alone, shape [N, U].
    return np.einsum("nci,nciu->nu", force, jacobian)
