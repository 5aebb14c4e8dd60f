"""What hands look like: meshes for the eye of the built-in hands, other hands' own.

``visual_meshes.npz`` holds them: for each hand the body that carries each mesh, its color (sRGB), strength
and sharpness of its highlight, numbers of its vertices and faces, and all vertices [``UNIT``] and faces. They
were modeled for fungrasp by a program that the repository held until November 2026
(``src/fungrasp/media/hand_shells``), from the sizes in the makers' drawings.
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
"""Of the vertices in the file [m]."""

COLLISION_GROUP = 3
"""Geom group of what is not drawn, by MuJoCo's convention."""

PLAIN = (0.5, 0.5, 0.5, 1.0)
"""Color of a geom whose material counts."""


def dressed_spec(hand: Hand) -> mujoco.MjSpec:
    """``hand.spec()`` in which what collides is hidden where there is something that looks like the hand.

    A hand that is not built in, and has no visual meshes, is shown by its collision shapes.
    """
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
    """``dressed_spec``, compiled; do not change it. Joints and bodies are those of ``hand.model``."""
    key = (str(hand.path), hand.digest)
    if key not in _models:
        _models[key] = dressed_spec(hand).compile()
    return _models[key]


_models: dict[tuple[str, str], mujoco.MjModel] = {}


def _visual_meshes(hand: Hand) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Body, look (shape [5]), vertices [m] and faces of each mesh of a built-in hand; none of others."""
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
