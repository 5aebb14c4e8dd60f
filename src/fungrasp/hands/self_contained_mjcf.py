"""Writing a model as one MJCF text that needs no other file."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError


def self_contained_xml(spec: mujoco.MjSpec) -> str:
    """MJCF text of a model; ``spec`` itself is left in the same state.

    Meshes are written as vertices and faces; pictures used as textures are left out.

    Raises:
        FungraspError: the model does not compile, or cannot be written as one file.
    """
    spec = spec.copy()
    try:
        model = spec.compile()
        _drop_pictures(spec)
        _inline_meshes(spec, model)
        text = spec.to_xml()
        mujoco.MjModel.from_xml_string(text)
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise FungraspError(
            f"the model '{spec.modelname}' cannot be written as one MJCF file: {reason}"
        ) from error
    return text


def _drop_pictures(spec: mujoco.MjSpec) -> None:
    pictures = {texture.name for texture in spec.textures if texture.file or any(texture.cubefiles)}
    for material in spec.materials:
        material.textures = ["" if name in pictures else name for name in material.textures]
    for texture in list(spec.textures):
        if texture.name in pictures:
            spec.delete(texture)


def _inline_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace mesh files by their vertices, in the frame and scale in which the geoms use them."""
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        i = mesh.id
        vertices = model.mesh_vert[model.mesh_vertadr[i] :][: model.mesh_vertnum[i]].astype(float)
        faces = model.mesh_face[model.mesh_faceadr[i] :][: model.mesh_facenum[i]]
        rotation = np.zeros(9)
        # The compiler moves a mesh to its inertial frame; this moves it back.
        mujoco.mju_quat2Mat(rotation, model.mesh_quat[i])
        vertices = vertices @ rotation.reshape(3, 3).T + model.mesh_pos[i]
        # MuJoCo names a nameless mesh after its file, and the geoms use that name.
        mesh.name = model.mesh(i).name
        mesh.file = ""
        mesh.uservert = vertices.ravel()
        mesh.userface = faces.ravel()
        mesh.scale, mesh.refpos, mesh.refquat = [1, 1, 1], [0, 0, 0], [1, 0, 0, 0]
