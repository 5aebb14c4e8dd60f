"""Scene nodes of pages: hands, objects, contacts and forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.grasps.as_shown import PlaceMarks
from fungrasp.hands import Hand
from fungrasp.media.grasp_scenes import CONTACT, MISSED, SKIN, UNWANTED
from fungrasp.media.hand_mesh import human_hand_mesh
from fungrasp.media.materials import painted_parts
from fungrasp.media.pictures import AS_SHOWN, NOT_SHOWN
from fungrasp.media.surfaces import drawn_geoms, geom_surface, model_materials
from fungrasp.media.visual_meshes import dressed_model
from fungrasp.objects import ObjectModel

if TYPE_CHECKING:
    from viser import SceneApi

Color = tuple[float, float, float]
"""sRGB, each from 0 to 1."""

STILL = 2e-5
"""Smallest change of a pose that is sent to the browser [m or quaternion component]."""


def creased(
    vertices: np.ndarray, faces: np.ndarray, corner_normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface with separate vertices at creases, because browsers smooth over shared vertices.

    Args:
        vertices: [m], shape [V, 3].
        faces: shape [T, 3].
        corner_normals: result of ``fungrasp.media.surfaces.corner_normals``, shape [T, 3, 3].
    """
    corners = np.column_stack([faces.ravel(), np.round(corner_normals.reshape(-1, 3) * 20)]).astype(int)
    _, first, index = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    return vertices[faces.ravel()[first]], index.reshape(-1, 3)


def move(handle: Any, pose: np.ndarray) -> None:
    """Set the pose of a scene node. pose: shape [7]."""
    if np.abs(handle.position - pose[:3]).max() > STILL:
        handle.position = pose[:3]
    if np.abs(handle.wxyz - pose[3:]).max() > STILL:
        handle.wxyz = pose[3:]


def pose_of(handle: Any) -> np.ndarray:
    """Return the pose of a scene node, shape [7]."""
    return np.concatenate([handle.position, handle.wxyz])


def color_bytes(color: Any) -> tuple[int, int, int]:
    """Return an 8-bit color. color: sRGB, each from 0 to 1."""
    red, green, blue = (round(255 * float(c)) for c in np.clip(color, 0, 1))
    return red, green, blue


SUNK: Color = (0.85, 0.12, 0.10)
"""Color of points inside the object."""

NEAR: Color = (0.15, 0.65, 0.35)
"""Color of points that touch."""


class HumanFigure:
    """A rigid human hand with colored links in contact."""

    def __init__(self, scene: SceneApi, name: str, joints: np.ndarray, link_contacts: np.ndarray):
        """
        Args:
            name: name of the node.
            joints: [m], shape [21, 3].
            link_contacts: shape [16] bool.
        """
        import trimesh
        from PIL import Image
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial

        mesh = human_hand_mesh(joints, cell=0.003)
        share = np.clip(mesh.links @ np.asarray(link_contacts, dtype=float), 0, 1)
        # A fully colored palm would dominate the fingers.
        share = share * (1 - 0.6 * mesh.links[:, 0])
        ramp = np.linspace(0, 1, 64)[None, :, None]
        colors = np.asarray(SKIN) + ramp * (np.asarray(CONTACT) - np.asarray(SKIN))
        material = PBRMaterial(
            baseColorTexture=Image.fromarray(np.round(255 * colors).astype(np.uint8)),
            metallicFactor=0.0,
            roughnessFactor=0.75,
        )
        place = np.stack([(0.5 + 63 * share) / 64, np.full_like(share, 0.5)], axis=-1)
        looks = TextureVisuals(uv=place, material=material)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=looks, process=False)
        self.handle = scene.add_mesh_trimesh(name, solid)

    def place(self, motion: np.ndarray) -> None:
        """Move the hand. motion: motion from the initial pose, shape [7]."""
        move(self.handle, motion)

    def remove(self) -> None:
        """Remove the node from the scene."""
        self.handle.remove()


class ObjectFigure:
    """An object."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        model: ObjectModel,
        *,
        opacity: float | None = None,
        color: Color | None = None,
    ):
        """
        Args:
            opacity: opaque if None.
            color: color of the surface; those of its materials if None.
        """
        from fungrasp.media.surfaces import corner_normals

        self.handle = scene.add_frame(name, show_axes=False)
        vertices, faces = model.vertices, model.faces
        normals = corner_normals(vertices, faces)
        self.surfaces: list[Any] = []
        """Nodes that can be clicked and dragged."""
        for number, (look, mask) in enumerate(painted_parts(model)):
            points, triangles = creased(vertices, faces[mask], normals[mask])
            paint = color_bytes(look.color if color is None else color)
            self.surfaces.append(
                scene.add_mesh_simple(f"{name}/{number}", points, triangles, color=paint, opacity=opacity)
            )

    def place(self, pose: np.ndarray) -> None:
        """Move the object. pose: shape [7]."""
        move(self.handle, pose)

    def remove(self) -> None:
        """Remove the node from the scene."""
        self.handle.remove()


class ContactMarks:
    """Marks of contact points, penetration and forces."""

    def __init__(self, scene: SceneApi, name: str):
        """
        Args:
            name: name of the object's node.
        """
        self._scene, self._name = scene, name
        self._points: Any = None
        self._arrows: Any = None
        self._places: list[Any] = []

    def points(self, places: np.ndarray, clearance: np.ndarray, within: float) -> None:
        """Mark points.

        Args:
            places: [m], shape [L, 3].
            clearance: distance of each point from the object's surface [m], shape [L].
            within: maximum clearance of marked points [m].
        """
        near = clearance < within
        share = np.clip(-clearance[near, None] / 0.002, 0, 1)
        colors = np.asarray(NEAR) + share * (np.asarray(SUNK) - np.asarray(NEAR))
        if not near.any():
            self._points = _removed(self._points)
            return
        colors = np.round(255 * colors).astype(np.uint8)
        places = places[near].astype(np.float32)
        if self._points is None:
            self._points = self._scene.add_point_cloud(
                f"{self._name}/points", places, colors, point_size=0.004, point_shape="circle"
            )
        else:
            self._points.points, self._points.colors = places, colors

    def forces(self, places: np.ndarray, forces: np.ndarray) -> None:
        """Draw forces as arrows of 15 mm/N that end at their points of application.

        Args:
            places: [m], shape [L, 3].
            forces: [N], shape [L, 3]; zero for none.
        """
        which = np.linalg.norm(forces, axis=1) > 0.05
        if not which.any():
            self._arrows = _removed(self._arrows)
            return
        ends = np.stack([places - 0.015 * forces, places], axis=1)[which].astype(np.float32)
        if self._arrows is None:
            self._arrows = self._scene.add_arrows(
                f"{self._name}/forces",
                ends,
                color_bytes((0.55, 0.1, 0.8)),
                shaft_radius=0.002,
                head_radius=0.005,
                head_length=0.01,
            )
        else:
            self._arrows.points = ends

    def places(self, marks: PlaceMarks | None) -> None:
        """Connect human contact points (larger) with the robot's. marks: None for none."""
        for handle in self._places:
            handle.remove()
        self._places = []
        if marks is None or not len(marks.shown):
            return
        colors = np.array([AS_SHOWN if shown else NOT_SHOWN for shown in marks.shown], dtype=np.uint8)
        ends = np.stack([marks.places, marks.points], axis=1).astype(np.float32)
        lines = self._scene.add_line_segments(
            f"{self._name}/lines", ends, np.stack([colors, colors], axis=1), thickness=0.002
        )
        self._places = [lines] + [
            self._scene.add_point_cloud(
                f"{self._name}/places{i}", ends[:, i], colors, point_size=size, point_shape="circle"
            )
            for i, size in enumerate((0.010, 0.006))
        ]

    def clear(self) -> None:
        """Remove all marks."""
        self.places(None)
        self._points, self._arrows = _removed(self._points), _removed(self._arrows)


def _removed(handle: Any) -> None:
    if handle is not None:
        handle.remove()


class _Part(NamedTuple):
    """Surfaces of one body and one color."""

    handle: Any
    color: np.ndarray
    link: int


class RobotFigure:
    """A robot hand, with a frame for each body and a mesh for each color of a body."""

    def __init__(
        self, scene: SceneApi, name: str, hand: Hand, *, opacity: float | None = None, collision: bool = False
    ):
        """
        Args:
            name: name of the root node.
            opacity: opaque if None.
            collision: draw collision shapes instead of visual meshes.
        """
        self.hand = hand
        self._model = dressed_model(hand)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        palm = self._data.body(hand.palm)
        self._back = invert(np.concatenate([palm.xpos, palm.xquat]))
        self._root = scene.add_frame(name, show_axes=False)
        self._frames: dict[int, Any] = {}
        self._parts: list[_Part] = []
        self._joints = np.array([self._model.joint(j).qposadr[0] for j in hand.joint_names])
        owner = {body: k for k, bodies in enumerate(hand.links) for body in bodies}
        materials = model_materials(self._model)
        drawn = drawn_geoms(self._model) & (materials.colors[:, 3] > 0)
        if collision:
            drawn = (self._model.geom_contype | self._model.geom_conaffinity) > 0
        drawn = np.flatnonzero(drawn)
        for body in np.unique(self._model.geom_bodyid[drawn]).tolist():
            title = self._model.body(body).name
            frame = f"{name}/{title or 'base'}"
            self._frames[body] = scene.add_frame(frame, show_axes=False)
            geoms = drawn[self._model.geom_bodyid[drawn] == body]
            colors = np.round(materials.colors[geoms, :3], 3)
            for k, color in enumerate(np.unique(colors, axis=0)):
                vertices, faces = self._joined(geoms[(colors == color).all(axis=1)], materials)
                handle = scene.add_mesh_simple(
                    f"{frame}/{k}", vertices, faces, color=color_bytes(color), opacity=opacity
                )
                self._parts.append(_Part(handle, color, owner.get(title, 0)))

    def _joined(self, geoms: np.ndarray, materials: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return vertices and faces of some geoms in the frame of their body, with creases."""
        vertices, faces, count = [], [], 0
        rotation = np.empty(9)
        for geom in geoms.tolist():
            surface = geom_surface(self._model, geom, materials)
            mujoco.mju_quat2Mat(rotation, self._model.geom_quat[geom])
            points, triangles = creased(surface.vertices, surface.faces, surface.corner_normals)
            vertices.append(points @ rotation.reshape(3, 3).T + self._model.geom_pos[geom])
            faces.append(triangles + count)
            count += len(points)
        return np.concatenate(vertices), np.concatenate(faces)

    @property
    def corners(self) -> np.ndarray:
        """Lowest and highest corners of boxes around the visible geoms at the current joints [m], palm frame,
        shape [N, 3]."""
        geoms = np.isin(self._model.geom_bodyid, list(self._frames))
        centers, sizes = self._data.geom_xpos[geoms], self._model.geom_rbound[geoms, None]
        return transform_points(self._back, np.concatenate([centers - sizes, centers + sizes]))

    def place(self, wrist_pose: np.ndarray, joint_positions: np.ndarray) -> None:
        """Set wrist pose and joints.

        Args:
            wrist_pose: pose of the palm body in the frame of the node's parent, shape [7].
            joint_positions: in the order of ``hand.joint_names`` [rad], shape [M].
        """
        self._data.qpos[self._joints] = joint_positions
        mujoco.mj_kinematics(self._model, self._data)
        move(self._root, compose(wrist_pose, self._back))
        for body, frame in self._frames.items():
            move(frame, np.concatenate([self._data.xpos[body], self._data.xquat[body]]))

    def paint(self, reached: np.ndarray | None = None, wanted: np.ndarray | None = None) -> None:
        """Color the links.

        Args:
            reached: links that touch, shape [L] bool; None for none.
            wanted: links that should touch, shape [L] bool; as ``reached`` if None.
        """
        for part in self._parts:
            touches = reached is not None and bool(reached[part.link])
            asked = touches if wanted is None else bool(wanted[part.link])
            tint = None
            if touches or asked:
                tint = CONTACT if touches and asked else UNWANTED if touches else MISSED
            share = 0.55 if part.link == 0 else 0.85
            color = part.color if tint is None else part.color + share * (np.array(tint) - part.color)
            color = color_bytes(color)
            if tuple(part.handle.color) != color:
                part.handle.color = color

    def paint_links(self, colors: np.ndarray | None) -> None:
        """Color each link. colors: sRGB, one row per link; the hand's colors if None."""
        for part in self._parts:
            part.handle.color = color_bytes(part.color if colors is None else colors[part.link % len(colors)])

    @property
    def handles(self) -> list[Any]:
        """Nodes that can be clicked and dragged."""
        return [part.handle for part in self._parts]

    def show(self, visible: bool) -> None:
        """Show or hide the hand."""
        self._root.visible = visible

    def remove(self) -> None:
        """Remove the node from the scene."""
        self._root.remove()
