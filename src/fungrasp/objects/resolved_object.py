"""Objects from a mesh, a mesh file, a built-in object or a plain shape, with a guessed mass if necessary."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mesh_file import is_colorless, read_colored_mesh
from fungrasp.geometry.triangle_mesh import volume_and_center
from fungrasp.objects.builtin_objects import is_plain_shape, plain_shape
from fungrasp.objects.mesh_file import load_mesh, mend_mesh
from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.object_registry import builtin_object, check_density, object_from_file, object_names

_log = logging.getLogger(__name__)

if TYPE_CHECKING:
    import trimesh


DENSITY = 500.0
"""Density of everyday objects by the volume of their convex hulls [kg/m^3]: the median of YCB's and the
built-in ones is 540."""

DENSITIES = (190.0, 940.0)
"""80 % interval of these densities [kg/m^3]."""

EIGHT_OF_TEN = 1.28
"""Half width of the 80 % interval of a normal distribution, in standard deviations."""


@dataclass(frozen=True, eq=False)
class ResolvedObject:
    """An object with additional data for perception."""

    model: ObjectModel
    """Mesh, mass and inertia of the object."""
    colored: trimesh.Trimesh | None = None
    """Mesh with the colors of the file, if any. They distinguish the sides of nearly symmetric objects."""
    notes: tuple[str, ...] = ()
    """Assumptions, as sentences to print."""
    mass_range: tuple[float, float] | None = None
    """80 % interval of a guessed mass [kg]."""

    @property
    def mass_spread(self) -> float | None:
        """Standard deviation of the logarithm of a guessed mass."""
        if self.mass_range is None:
            return None
        return float(np.log(self.mass_range[1] / self.mass_range[0])) / (2 * EIGHT_OF_TEN)


def resolve_object(
    obj: ObjectModel | ResolvedObject | trimesh.Trimesh | str | Path, mass: float | None = None
) -> ResolvedObject:
    """Make an object from a mesh file, a name, an object or a mesh.

    Args:
        obj: mesh file [m], name of a built-in object, or shape, "box:60x28x30"; an existing file has
            priority. Or an object, or a mesh as arrays.
        mass: [kg]. None: known for built-in objects, otherwise guessed from the size of the mesh.

    Raises:
        FungraspError: a file or object is unknown, mesh or mass is invalid, the density is impossible, or the
            object already has a mass.
    """
    if isinstance(obj, ResolvedObject):
        return obj
    if isinstance(obj, ObjectModel):
        if mass is not None:
            raise FungraspError(f"'{obj.name}' already has a mass, {obj.mass:.4g} kg: leave out mass=")
        return ResolvedObject(obj)
    if not isinstance(obj, str | Path):
        model = object_from_mesh(obj, mass)
        volume = volume_and_center(model.hull)[0]
        between = None if mass is not None else (DENSITIES[0] * volume, DENSITIES[1] * volume)
        return ResolvedObject(model, mass_range=between)
    mesh = str(obj)
    # Unlike Path.is_file it takes a name of any length.
    is_file = os.path.isfile(mesh)  # noqa: PTH113
    shape = not is_file and is_plain_shape(mesh)
    if not is_file and not shape and (mesh in object_names() or Path(mesh).name == mesh == Path(mesh).stem):
        model = builtin_object(mesh, mass)
        check_density(model)
        return ResolvedObject(model)
    notes: tuple[str, ...] = ()
    between = None
    if mass is None:
        unit = plain_shape(mesh, 1.0) if shape else object_from_file(mesh, 1.0)
        volume = volume_and_center(unit.hull)[0]
        mass, between = DENSITY * volume, (DENSITIES[0] * volume, DENSITIES[1] * volume)
        notes = (
            f"the mass was guessed, {mass:.2g} kg, and may be {between[0]:.2g} to {between[1]:.2g}: give "
            "it if you know it",
        )
    model = plain_shape(mesh, mass) if shape else object_from_file(mesh, mass)
    check_density(model)
    return ResolvedObject(model, colored_mesh(mesh, model) if is_file else None, notes, between)


def object_from_mesh(
    mesh: trimesh.Trimesh | trimesh.Scene | str | Path, mass: float | None = None, name: str = ""
) -> ObjectModel:
    """Make an object from a mesh, which is repaired if it is not closed.

    Args:
        mesh: a mesh [m] with ``vertices`` and ``faces`` as in trimesh, or a file.
        mass: [kg]; None: guessed from the size of the mesh, with a warning.
        name: name of the object in grasps. Default: the file's name, or "object".

    Raises:
        FungraspError: the file can't be read, the surface can't be repaired or is not in meters, or the mass
            is invalid.
    """
    if isinstance(mesh, str | Path):
        vertices, faces, repairs = load_mesh(mesh)
        name, source = name or Path(mesh).stem, str(mesh)
    elif hasattr(shape := _whole(mesh), "vertices") and hasattr(shape, "faces"):
        name, source = name or "object", "arrays"
        vertices, faces, repairs = mend_mesh(np.asarray(shape.vertices), np.asarray(shape.faces), name)
    else:
        raise FungraspError(
            f"expected a mesh (trimesh.Trimesh) or the path of one, not {type(mesh).__name__}"
        )
    model = ObjectModel(name, 1.0 if mass is None else mass, vertices, faces, repairs=repairs, source=source)
    volume = volume_and_center(model.hull)[0]
    if mass is None:
        model = replace(model, mass=DENSITY * volume)
        _log.warning("%s: the mass was guessed from its size, %.2g kg: give mass=", name, model.mass)
    check_density(model)
    return model


def _whole(mesh: Any) -> Any:
    """Return one mesh of a scene, which is what ``trimesh.load`` makes of a GLB."""
    return mesh.to_mesh() if hasattr(mesh, "to_mesh") else mesh


def colored_mesh(path: str | Path, model: ObjectModel) -> trimesh.Trimesh | None:
    """Return the object with the colors of its mesh file, including textures.

    A repaired mesh keeps its surface; each vertex gets the color of the file's nearest vertex.

    Returns:
        None if the file has no colors, or if they can't be read, which is logged.
    """
    try:
        mesh = None if is_colorless(path) else read_colored_mesh(path)
    except FungraspError as problem:
        _log.warning("%s; the shape is used without colors", problem)
        return None
    if mesh is None or not model.repairs:
        return mesh
    import trimesh

    visual: Any = mesh.visual
    colors = (visual.to_color() if visual.kind == "texture" else visual).vertex_colors
    nearest = KDTree(np.asarray(mesh.vertices)).query(model.vertices)[1]
    return trimesh.Trimesh(
        model.vertices, model.faces, vertex_colors=np.asarray(colors)[nearest], process=False
    )
