"""How hard each finger should press so that the contact forces balance: a small force optimisation per grasp."""

from __future__ import annotations


import numpy as np
from scipy.optimize import nnls

from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.retarget.problem import HandPoints, State, Surroundings

CONE_EDGES = 6


def squeeze_torques(
    hand: Hand,
    around: Surroundings,
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
    state = State(points, around, wrist_in_object, grasp)
    nearest = np.stack(
        [m[np.argmin(state.clearance[:, m], axis=1)] for m in points.link_members], axis=1
    )
    clearance = np.take_along_axis(state.clearance, nearest, axis=1)
    normal = np.take_along_axis(state.normals, nearest[..., None], axis=1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    place = np.take_along_axis(state.balls, nearest[..., None], axis=1) - points.balls.radius[nearest][..., None] * normal
    jacobian = points.kinematics.jacobian(points.balls.points.bodies[nearest], place)[..., 6:]
    torques = np.zeros_like(grasp)
    for row in range(len(around)):
        used = np.flatnonzero(contacts[row] & (clearance[row] < near))
        if len(used) < 2:
            used = np.argsort(clearance[row])[:3]
        force = balanced_forces(
            place[row, used] - objects[row].center_of_mass, -normal[row, used], friction, 0.5 * float(np.max(objects[row].size))
        )
        torques[row] = np.einsum("ci,ciu->u", force, jacobian[row, used])
    return torques


def balanced_forces(place: np.ndarray, inward: np.ndarray, friction: float, reach: float) -> np.ndarray:
    """Contact forces in their friction cones that cancel out as well as they can; their normal parts sum to 1.

    Args:
        place: contact points relative to the centre of mass [m], shape [C, 3].
        inward: unit normals into the object, shape [C, 3].
        friction: coefficient.
        reach: length by which torques are divided [m].

    Returns:
        shape [C, 3].
    """
    edges = _cone(inward, friction).reshape(-1, 3)
    arms = np.repeat(place, CONE_EDGES, axis=0)
    wrench = np.concatenate([edges, np.cross(arms, edges) / reach], axis=1).T
    share = np.ones((1, edges.shape[0]))
    small = 0.05 * np.eye(edges.shape[0])
    matrix = np.concatenate([wrench, 3.0 * share, small])
    goal = np.concatenate([np.zeros(6), [3.0], np.zeros(edges.shape[0])])
    strength, _ = nnls(matrix, goal)
    strength /= max(strength.sum(), 1e-6)
    return (strength[:, None] * edges).reshape(len(place), CONE_EDGES, 3).sum(axis=1)


def _cone(inward: np.ndarray, friction: float) -> np.ndarray:
    """Edges of the friction cones, unit normal part, shape [C, CONE_EDGES, 3]."""
    helper = np.where(np.abs(inward[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(inward, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(inward, first)
    angles = 2 * np.pi * np.arange(CONE_EDGES) / CONE_EDGES
    side = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    return inward[:, None] + friction * side
