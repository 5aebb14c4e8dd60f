"""What stands in the scene of a page: a human hand, an object, contacts and forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.media.grasp_scenes import CONTACT, SKIN
from fungrasp.media.hand_mesh import human_hand_mesh
from fungrasp.media.materials import painted_parts
from fungrasp.objects import ObjectModel
from fungrasp.viewer.scene_nodes import Color, color_bytes, creased, move

if TYPE_CHECKING:
    from viser import SceneApi

SUNK: Color = (0.85, 0.12, 0.10)
"""Color of points inside the object."""

NEAR: Color = (0.15, 0.65, 0.35)
"""Color of points that touch."""


class HumanFigure:
    """A human hand, links in contact colored, that moves as one piece."""

    def __init__(self, scene: SceneApi, name: str, joints: np.ndarray, link_contacts: np.ndarray):
        """
        Args:
            scene: of the page.
            name: of the node that carries it.
            joints: [m], shape [21, 3].
            link_contacts: shape [16] bool.
        """
        import trimesh
        from PIL import Image
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial

        mesh = human_hand_mesh(joints, cell=0.003)
        share = np.clip(mesh.links @ np.asarray(link_contacts, dtype=float), 0, 1)
        # A whole palm in contact would drown the fingers.
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
        """Move it. motion: from where it was made, shape [7]."""
        move(self.handle, motion)

    def remove(self) -> None:
        """Take it out of the scene."""
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
            scene: of the page.
            name: of the node.
            model: the object.
            opacity: None for a solid one.
            color: of the whole surface; that of its materials if None.
        """
        from fungrasp.media.surfaces import corner_normals

        self.handle = scene.add_frame(name, show_axes=False)
        vertices, faces = model.vertices, model.faces
        normals = corner_normals(vertices, faces)
        self.surfaces: list[Any] = []
        """What can be clicked and dragged."""
        for number, (look, mask) in enumerate(painted_parts(model)):
            points, triangles = creased(vertices, faces[mask], normals[mask])
            paint = color_bytes(look.color if color is None else color)
            self.surfaces.append(
                scene.add_mesh_simple(f"{name}/{number}", points, triangles, color=paint, opacity=opacity)
            )

    def place(self, pose: np.ndarray) -> None:
        """Move it. pose: shape [7]."""
        move(self.handle, pose)

    def remove(self) -> None:
        """Take it out of the scene."""
        self.handle.remove()


class ContactMarks:
    """Where the links touch, or sink in, and the forces there."""

    def __init__(self, scene: SceneApi, name: str):
        """
        Args:
            scene: of the page.
            name: of the node, which a figure of the object carries.
        """
        self._scene, self._name = scene, name
        self._points: Any = None
        self._arrows: Any = None

    def points(self, places: np.ndarray, clearance: np.ndarray, within: float) -> None:
        """Mark points.

        Args:
            places: [m], shape [L, 3].
            clearance: of each from the object's surface [m], shape [L].
            within: what is farther than this is not marked [m].
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

    def forces(self, places: np.ndarray, forces: np.ndarray, meters_per_newton: float = 0.015) -> None:
        """Draw forces as arrows that end where they act.

        Args:
            places: [m], shape [L, 3].
            forces: [N], shape [L, 3]; zero for none.
            meters_per_newton: length of an arrow [m/N].
        """
        which = np.linalg.norm(forces, axis=1) > 0.05
        if not which.any():
            self._arrows = _removed(self._arrows)
            return
        ends = np.stack([places - meters_per_newton * forces, places], axis=1)[which].astype(np.float32)
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

    def clear(self) -> None:
        """Take all marks away."""
        self._points, self._arrows = _removed(self._points), _removed(self._arrows)


def _removed(handle: Any) -> None:
    if handle is not None:
        handle.remove()
