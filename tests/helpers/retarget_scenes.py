"""Plain objects and human grasps of them, made with the human hand's own model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"
ROBOTS = ("allegro", "shadow", "faive", "inspire", "leap")
RADIUS = 0.035
"""Of the ball and the can [m]."""


@cache
def plain_objects() -> Mapping[str, ObjectModel]:
    """A ball, a can and a box, each centered on its origin."""
    meshes = {
        "ball": trimesh.creation.icosphere(subdivisions=3, radius=RADIUS),
        "can": trimesh.creation.cylinder(radius=RADIUS, height=0.14, sections=48),
        "box": trimesh.creation.box((0.06, 0.12, 0.16)),
    }
    objects = {}
    for name, mesh in meshes.items():
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
        objects[name] = ObjectModel(name, 0.2, vertices, faces)
        # A grid of our own, as the tests should not fill the user's cache.
        objects[name].__dict__["signed_distance"] = SignedDistanceGrid.from_mesh(
            vertices, faces, spacing=0.003
        )
    return objects


@cache
def held() -> HumanGraspSet:
    """Six human grasps: ball, can and box, each from two sides, all on a table, all fingertips in contact."""
    objects = plain_objects()
    names = np.repeat(list(objects), 2)
    rest = np.array([objects[name].rest_pose(yaw) for name, yaw in zip(names, (0.0, 0.4) * 3, strict=True)])
    hand = load_hand("human")
    kinematics = HandKinematics(hand, len(names))
    points = HandPoints(kinematics)
    contacts = np.zeros((len(names), len(hand.links)), dtype=bool)
    contacts[:, 1:] = points.match.is_last
    around = CollisionScene.measured_and_settled(names.tolist(), rest, objects)
    problem = problem_with(around, contacts=contacts)
    wrist, joints = _around(kinematics, len(names))
    objective = [
        partial(terms.contact_gap, unit=0.001),
        partial(terms.object_penetration, unit=0.0003),
        partial(terms.table_penetration, unit=0.001, margin=0.005),
        partial(terms.self_penetration, unit=0.001),
        partial(terms.stay_near, start=(wrist, joints), unit=1.0, position_unit=0.05, rotation_unit=1.0),
    ]
    wrist, joints, _ = minimize(points, problem, objective, wrist, joints, 60)
    touching = HandState(points, problem, wrist, joints)
    by_link = [touching.clearance[:, members].min(axis=1) for members in points.link_members]
    return HumanGraspSet(
        object_name=names,
        object_mass=np.full(len(names), 0.2),
        object_pose=rest,
        object_rest_pose=rest,
        hand_joints=transform_points(rest, touching.keypoints),
        link_contacts=np.stack(by_link, axis=1) < 0.002,
    )


def problem_with(around: CollisionScene, **given: np.ndarray) -> RetargetingProblem:
    """A problem of N hands whose other fields are zero. given: fields of ``RetargetingProblem``."""
    count = len(around)
    empty = {
        "joints": np.zeros((count, 21, 3)),
        "contacts": np.zeros((count, 16), dtype=bool),
        "surface": np.zeros((count, 15, 3)),
        "normals": np.zeros((count, 15, 3)),
        "center": np.zeros((count, 3)),
        "extent": np.ones(count),
        "weight": np.ones(count),
    }
    return RetargetingProblem(**{**vars(around), **empty, **given})


def field(
    distance: Callable[[np.ndarray], np.ndarray], spacing: float = 0.01, half: float = 0.3
) -> SignedDistanceGrid:
    """Distance [m] of points [..., 3] as a grid. half: of its width [m]."""
    axis = np.arange(-half, half + spacing, spacing)
    corners = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return SignedDistanceGrid(np.full(3, axis[0]), spacing, distance(corners))


def around_field(grid: SignedDistanceGrid, count: int, table: float = -10.0) -> CollisionScene:
    """One object for N hands, and a table at the height ``table`` [m] along x."""
    up = np.broadcast_to([1.0, 0.0, 0.0], (count, 1, 3))
    return CollisionScene(
        SignedDistanceBank([grid]), np.zeros(count, dtype=int), up, np.full((count, 1), -table)
    )


def moved(grasps: HumanGraspSet, pose: np.ndarray) -> HumanGraspSet:
    """The whole scene moved. pose: new world frame from old, shape [7]."""
    return HumanGraspSet(
        object_name=grasps.object_name,
        object_mass=grasps.object_mass,
        object_pose=compose(pose, grasps.object_pose),
        object_rest_pose=compose(pose, grasps.object_rest_pose),
        hand_joints=transform_points(pose, grasps.hand_joints),
        link_contacts=grasps.link_contacts,
        task=grasps.task,
    )


def _around(kinematics: HandKinematics, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A half closed hand with an upright thing in it, the fingers level, thumb up, palm towards its axis."""
    rotation = Rotation.from_matrix(np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])).as_quat(
        scalar_first=True
    )
    wrist = np.tile(np.concatenate([[RADIUS + 0.03, -0.085, 0.0], rotation]), (count, 1))
    return wrist, np.tile(0.6 * kinematics.lower + 0.4 * kinematics.upper, (count, 1))
