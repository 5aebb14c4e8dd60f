"""The object that somebody holds in an image: a mesh file or a built-in object; and its mirror image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import trimesh

    from fungrasp.objects import ObjectModel

DENSITY = 500.0
"""Density of everyday objects by the volume of their convex hulls [kg/m^3]: the median of YCB's and the
built-in ones is 540; eight of ten lie between 190 and 940."""


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object that a command was given."""

    model: ObjectModel
    """Mesh, mass and inertia of the object."""
    colored: trimesh.Trimesh | None = None
    """The same with the colours of its mesh file, if it has any."""
    notes: tuple[str, ...] = ()
    """Assumptions that were made, as sentences to print."""


def held_object(mesh: str, mass: float | None) -> HeldObject:
    """The object by its mesh file or its name.

    Args:
        mesh: a mesh file [m], the name of a built-in object, or a shape, "box:60x28x30". A file of that name
            comes first.
        mass: [kg]; None takes a built-in object's own, or guesses it from the size of the mesh.

    Raises:
        FungraspError: there is no such file or object, the mesh is bad, or the mass.
    """
    from fungrasp.objects import builtin_object, is_plain_shape, object_from_file, object_names, plain_shape
    from fungrasp.perception.object_pose.known_object import colored_mesh

    is_file = Path(mesh).is_file()
    shape = not is_file and is_plain_shape(mesh)
    if not is_file and not shape and (mesh in object_names() or Path(mesh).name == mesh == Path(mesh).stem):
        return HeldObject(builtin_object(mesh, mass))
    notes: tuple[str, ...] = ()
    if mass is None:
        unit = plain_shape(mesh, 1.0) if shape else object_from_file(mesh, 1.0)
        mass = DENSITY * float(unit.mesh.convex_hull.volume)
        notes = (f"the mass was guessed, {mass:.2f} kg: give --mass if you know it",)
    model = plain_shape(mesh, mass) if shape else object_from_file(mesh, mass)
    return HeldObject(model, colored_mesh(mesh, model) if is_file else None, notes)


def write_mesh(path: Path, model: ObjectModel) -> None:
    """Write the object's surface, in the format that the path's ending names.

    Raises:
        FungraspError: it can't be written.
    """
    import trimesh

    from fungrasp.files import atomic_path

    with atomic_path(path) as temporary:
        trimesh.Trimesh(model.vertices, model.faces, process=False).export(temporary)
