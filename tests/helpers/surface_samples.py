"""Quality numbers found the slow way: from the exported MJCF, dense random points on its collision shapes,
and exact
distances from convex meshes. Shares no code with ``fungrasp.evaluation.grasp_quality``."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from fungrasp.grasps import RobotGrasp
from fungrasp.hands import Hand
from fungrasp.hands.arm import export_hand
from fungrasp.objects import ObjectModel

POINTS = 3000
"""Per collision shape."""

NEAR = 0.006
"""[m]."""


def matrix(pose: np.ndarray) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
    result[:3, 3] = pose[:3]
    return result


class PlacedHand:
    """A hand's exported model with its palm at a grasp's wrist pose."""

    def __init__(self, hand: Hand, grasp: RobotGrasp):
        self.model = mujoco.MjModel.from_xml_string(export_hand(hand))
        self.data = mujoco.MjData(self.model)
        for name, value in zip(grasp.joint_names, grasp.joint_positions, strict=True):
            self.data.joint(name).qpos = value
        mujoco.mj_kinematics(self.model, self.data)
        palm = np.concatenate([self.data.body(hand.palm).xpos, self.data.body(hand.palm).xquat])
        self.world = matrix(grasp.wrist_pose) @ np.linalg.inv(matrix(palm))

    def moved(self, points: np.ndarray) -> np.ndarray:
        """From the model's frame to the world's."""
        return points @ self.world[:3, :3].T + self.world[:3, 3]

    def point(self, name: str) -> np.ndarray:
        """A site or a body's origin, world frame."""
        site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
        local = self.data.site_xpos[site] if site >= 0 else self.data.body(name).xpos
        return self.moved(local[None])[0]

    def surface(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Points on the collision shapes, world frame, and the body that each rides on."""
        points, bodies = [], []
        for geom in range(self.model.ngeom):
            body = self.model.geom_bodyid[geom]
            if body == 0 or not (self.model.geom_contype[geom] or self.model.geom_conaffinity[geom]):
                continue
            shape = _shape(self.model, geom)
            local, _ = trimesh.sample.sample_surface(shape, POINTS, seed=int(random.integers(2**31)))
            rotation = self.data.geom_xmat[geom].reshape(3, 3)
            points.append(self.moved(local @ rotation.T + self.data.geom_xpos[geom]))
            bodies += [self.model.body(int(body)).name] * len(local)
        return np.concatenate(points), np.array(bodies)


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=4, radius=size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        capsule = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[64, 64])
        return capsule.apply_translation([0, 0, -capsule.bounds.mean(axis=0)[2]])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=128)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return trimesh.creation.icosphere(subdivisions=4).apply_scale(size)
    raise NotImplementedError(kind)


def convex_distance(obj: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Signed distance of points from a convex object, its own frame: exact up to ``NEAR``, beyond it that
    from the plane of the face that is farthest below, which is less."""
    mesh = trimesh.Trimesh(obj.vertices, obj.faces, process=True)
    corners, normals = mesh.triangles[:, 0], mesh.face_normals
    planes = np.max(points @ normals.T - np.sum(corners * normals, axis=1), axis=1)
    near = np.flatnonzero((planes > 0) & (planes < NEAR))
    result = planes.copy()
    for part in np.array_split(near, max(1, len(near) // 500)):
        if len(part):
            result[part] = np.linalg.norm(points[part] - _closest(mesh, points[part]), axis=1)
    return result


def _closest(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Nearest points of the triangles whose planes are nearest, those of a convex mesh that matter."""
    heights = points @ mesh.face_normals.T - np.sum(mesh.triangles[:, 0] * mesh.face_normals, axis=1)
    count = min(40, len(mesh.faces))
    faces = np.argsort(-heights, axis=1)[:, :count]
    found = trimesh.triangles.closest_point(
        mesh.triangles[faces.ravel()], np.repeat(points, count, axis=0)
    ).reshape(len(points), count, 3)
    best = np.linalg.norm(found - points[:, None], axis=-1).argmin(axis=1)
    return found[np.arange(len(points)), best]


def nearest_point(obj: ObjectModel, points: np.ndarray) -> np.ndarray:
    mesh = trimesh.Trimesh(obj.vertices, obj.faces, process=True)
    return trimesh.proximity.closest_point_naive(mesh, points)[0]
