"""Visual meshes of hands: stored ones for built-in hands, their own for other hands.

``visual_meshes.npz`` has for each hand the body of each mesh, its color (sRGB), specular and shininess, its
numbers of vertices and faces, and all vertices [``UNIT``] and faces. The meshes were modeled for fungrasp
from the sizes in the manufacturers' drawings, by a program that was in the repository until November 2026
(``src/fungrasp/media/hand_shells``).
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.hand_registry import hand_files

UNIT = 1e-5
"""Unit of the vertices in the file [m]."""

COLLISION_GROUP = 3
"""Geom group of collision shapes, which is not drawn by MuJoCo's convention."""

PLAIN = (0.5, 0.5, 0.5, 1.0)
"""Color of a geom that uses its material's color."""


def dressed_spec(hand: Hand) -> mujoco.MjSpec:
    """Return ``hand.spec()`` with stored visual meshes and hidden collision shapes; unchanged if the hand has
    no stored meshes."""
    spec = hand.spec()
    meshes = _visual_meshes(hand)
    for geom in spec.geoms if meshes else ():
        geom.group = COLLISION_GROUP
    for number, (body, look, vertices, faces) in enumerate(meshes):
        name = f"visual {number}"
        mesh = spec.add_mesh(name=name)
        mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        *color, specular, shininess = look.tolist()
        spec.add_material(name=name, rgba=[*color, 1.0], specular=specular, shininess=shininess)
        added = spec.body(body).add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, rgba=PLAIN, mass=0.0
        )
        added.contype, added.conaffinity, added.group = 0, 0, 1
    return spec


def dressed_model(hand: Hand) -> mujoco.MjModel:
    """Return ``dressed_spec`` compiled, with the joints and bodies of ``hand.model``. Do not change it."""
    key = (str(hand.path), hand.digest)
    if key not in _models:
        _models[key] = dressed_spec(hand).compile()
    return _models[key]


_models: dict[tuple[str, str], mujoco.MjModel] = {}


def _visual_meshes(hand: Hand) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Return body, look (shape [5]), vertices [m] and faces of each stored mesh of a hand."""
    known = {Path(path).resolve(): name for name, path in hand_files().items()}
    name, stored = known.get(Path(hand.path).resolve()), _stored()
    if f"{name}/bodies" not in stored:
        return []
    bodies, looks, counts, vertices, faces = (
        stored[f"{name}/{part}"] for part in ("bodies", "looks", "counts", "vertices", "faces")
    )
    ends = np.cumsum(counts, axis=0)[:-1]
    places = np.split(UNIT * vertices.astype(float), ends[:, 0])
    triangles = np.split(faces.astype(np.int32), ends[:, 1])
    return list(zip(bodies.tolist(), looks, places, triangles, strict=True))


@cache
def _stored() -> dict[str, np.ndarray]:
    with (
        files("fungrasp.media").joinpath("visual_meshes.npz").open("rb") as stream,
        np.load(stream) as arrays,
    ):
        return dict(arrays)
