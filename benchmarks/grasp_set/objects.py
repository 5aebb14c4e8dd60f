"""The objects of the set: built-in ones and drawn shapes of random sizes and masses, and given meshes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree

from benchmarks.builtin_objects.assembly import assemble
from benchmarks.grasp_set.shapes import DRAWN_KINDS
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.grasps.importers.ycb import YCB_MASSES
from fungrasp.objects import ObjectModel, load_object, object_from_file, object_names
from fungrasp.objects.object_registry import mesh_files

BUILTIN_SCALES = (0.85, 1.2)
"""Smallest and largest factor on the size of a built-in object."""

MASS_FACTORS = (0.7, 1.5)
"""Smallest and largest factor on a built-in object's mass, beside the cube of that of its size."""

APART = 2e-6
"""How far corners that coincide are moved into the object [m]."""

SAMPLES = 20_000
"""Points of a surface that tell which part a face belongs to."""

MASSES: Mapping[str, float] = {**YCB_MASSES, "021_bleach_cleanser": 0.602}
"""Masses of YCB objects [kg]; of the bleach cleanser about half: full, it is beyond most hands."""


@dataclass(frozen=True, eq=False)
class SetObject:
    """One object of the set."""

    model: ObjectModel
    """With the name under which it is written, and its parts."""
    stratum: str
    """Kind of object: "builtin", "ycb", or one of ``DRAWN_KINDS``."""
    family: str
    """Objects of one family differ in size alone."""
    tasks: Mapping[str, str]
    """What the grasps of a part are for."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction that points up at rest, object frame."""
    scale: float = 1.0
    """Factor on the size of a built-in object."""
    weight: int = 1
    """How many times as many grasps as of another object are wanted."""


def drawn_objects(count: int, seed: int) -> list[SetObject]:
    """``count`` objects of each family of ``DRAWN_KINDS``; of those that may lie on any face, every third
    does.

    Args:
        count: positive.
        seed: of the dimensions.
    """
    objects = []
    for kind, family, number in (
        (k, f, n) for k, fs in DRAWN_KINDS.items() for f in fs for n in range(count)
    ):
        rng = np.random.default_rng([seed, *f"{kind} {family}".encode(), number])
        shape = DRAWN_KINDS[kind][family](rng)
        vertices, faces, parts, _ = assemble(shape.parts)
        mass = shape.mass or shape.density * float(trimesh.Trimesh(vertices, faces, process=False).volume)
        name = f"{family.replace(' ', '-')}-{number}"
        model = ObjectModel(name, float(np.round(mass, 4)), vertices, faces, parts=parts, source="drawn")
        up = (0.0, 0.0, 1.0)
        if shape.lies and number % 3 == 2:
            angle = rng.uniform(0, 2 * np.pi)
            up = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
        objects.append(SetObject(model, kind, family, shape.tasks, up))
    return objects


def builtin_objects(count: int, seed: int) -> list[SetObject]:
    """Each built-in object in ``count`` random sizes and masses."""
    objects = []
    for name, number in product(object_names(), range(count)):
        rng = np.random.default_rng([seed, *name.encode(), number])
        scale = float(np.round(rng.uniform(*BUILTIN_SCALES), 3))
        obj = load_object(name)
        mass = obj.mass * scale**3 * rng.uniform(*MASS_FACTORS)
        model = replace(
            obj,
            name=f"{name}-of-size-{scale:g}",
            mass=float(np.round(mass, 4)),
            vertices=scale * obj.vertices,
            construction=(),
            source="built-in, of another size and mass",
        )
        objects.append(SetObject(model, "builtin", name, {}, scale=scale))
    return objects


def ycb_objects(folder: Path, masses: Mapping[str, float] = MASSES) -> list[SetObject]:
    """The meshes of a folder whose masses are known.

    Raises:
        FungraspError: there is none, or a mesh can't be read.
    """
    files = mesh_files(folder)
    objects = [
        SetObject(object_from_file(files[name], mass), "ycb", name, {}, weight=2)
        for name, mass in masses.items()
        if name in files
    ]
    if not objects:
        raise FungraspError(f"{folder}: none of its meshes is of the YCB set ({next(iter(masses))}.obj, ...)")
    return objects


def written_meshes(objects: Sequence[SetObject], folder: Path) -> list[SetObject]:
    """Write each object's mesh into a folder, ``<name>.obj``; the objects as they are read from there, with
    the parts of before.

    Raises:
        FungraspError: a file can't be written.
    """
    read = []
    for obj in objects:
        path, model = folder / f"{obj.model.name}.obj", obj.model
        text = _obj(model) if obj.stratum != "ycb" else Path(model.source).read_text()
        if not path.is_file() or path.read_text() != text:
            with atomic_path(path) as temporary:
                temporary.write_text(text)
        same = object_from_file(path, model.mass)
        read.append(replace(obj, model=replace(same, parts=_parts_as_of(model, same))))
    return read


def _parts_as_of(model: ObjectModel, same: ObjectModel) -> dict[str, np.ndarray]:
    """The parts of an object for other triangles of the same surface: those of the nearest sample."""
    if not model.parts:
        return {}
    points, face = trimesh.sample.sample_surface(model.mesh, SAMPLES, seed=0)[:2]
    nearest = face[KDTree(points).query(same.vertices[same.faces].mean(axis=1))[1]]
    return {name: mask[nearest] for name, mask in model.parts.items()}


def _obj(model: ObjectModel) -> str:
    """Text of an OBJ file. Where solids touch in an edge, corners coincide without being one: a reader that
    joins them would open the surface, so they are moved apart by ``APART``."""
    vertices = model.vertices.copy()
    pairs = KDTree(vertices).query_pairs(APART, output_type="ndarray")
    neighbors = {tuple(edge) for edge in model.mesh.edges_sorted.tolist()}
    touching = [pair for pair in pairs.tolist() if tuple(sorted(pair)) not in neighbors]
    moved = np.unique(np.array(touching, dtype=int).ravel())
    vertices[moved] -= APART * model.mesh.vertex_normals[moved]
    lines = [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (model.faces + 1).tolist()]
    return "\n".join(lines) + "\n"
