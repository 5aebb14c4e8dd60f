"""A robot hand in the scene of a page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.hands import Hand
from fungrasp.media.grasp_scenes import CONTACT
from fungrasp.media.surfaces import drawn_geoms, geom_surface, model_materials
from fungrasp.media.visual_meshes import dressed_model
from fungrasp.viewer.scene_nodes import Color, color_bytes, creased, move

if TYPE_CHECKING:
    from viser import SceneApi

MISSED: Color = (0.85, 0.25, 0.45)
"""Color of links that should touch and do not."""

UNWANTED: Color = (0.95, 0.80, 0.25)
"""Color of links that touch and were not asked to."""


class _Part(NamedTuple):
    """Surfaces of one body that have one color."""

    handle: Any
    color: np.ndarray
    link: int


class RobotFigure:
    """A robot hand: a frame for each body, a mesh for each color in it."""

    def __init__(
        self, scene: SceneApi, name: str, hand: Hand, *, opacity: float | None = None, collision: bool = False
    ):
        """
        Args:
            scene: of the page.
            name: of the node that carries it.
            hand: any hand.
            opacity: below 1 for a hand that is only thought of; None for a solid one.
            collision: draw the shapes that collide in the place of those that look like the hand.
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
        drawn = drawn_geoms(self._model, ground=True) & (materials.colors[:, 3] > 0)
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
        """Vertices and faces of some geoms, in the frame of their body; creases keep their edges."""
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
        """Lowest and highest corners of boxes that hold what is drawn, where the joints are now, palm frame
        [m], shape [N, 3]."""
        geoms = np.isin(self._model.geom_bodyid, list(self._frames))
        centers, sizes = self._data.geom_xpos[geoms], self._model.geom_rbound[geoms, None]
        return transform_points(self._back, np.concatenate([centers - sizes, centers + sizes]))

    def place(self, wrist_pose: np.ndarray, joint_positions: np.ndarray) -> None:
        """Move it.

        Args:
            wrist_pose: of the palm body, in the frame of the node's parent, shape [7].
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
            wanted: links that should, shape [L] bool; None where nothing is asked.
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
        """Give each link a color. colors: sRGB, at least L rows; None for the hand's own."""
        for part in self._parts:
            part.handle.color = color_bytes(part.color if colors is None else colors[part.link % len(colors)])

    @property
    def handles(self) -> list[Any]:
        """What can be clicked and dragged."""
        return [part.handle for part in self._parts]

    def show(self, visible: bool) -> None:
        """Whether it is seen."""
        self._root.visible = visible

    def remove(self) -> None:
        """Take it out of the scene."""
        self._root.remove()
