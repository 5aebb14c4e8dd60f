"""Meshes of other things than what is in a hand: none of them may be accepted for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.objects import ObjectModel, mirrored_object
from fungrasp.objects.builtin_objects import plain_shape
from fungrasp.objects.object_variants import scaled_object
from fungrasp.perception.object_pose.icp import KnownSurface
from fungrasp.perception.object_pose.known_object import KnownObject, MeshRays, known_object

SCALES = (0.5, 0.67, 0.77, 1.3, 1.5, 2.0)
"""Sizes in which the right mesh is wrong."""

STRETCHED = {"longer": 1.4, "shorter": 0.7}
"""Factors on the longest side."""

SAME = 0.03
"""A mesh whose surface is nearer than this part of its size to another's, on average, is the same shape."""


def wrong_meshes(model: ObjectModel, others: Mapping[str, ObjectModel]) -> dict[str, ObjectModel]:
    """Wrong meshes by kind: other sizes, other proportions, the mirror image where that is another shape, the
    cylinder or box of the same sides, the other object whose sides are most alike, and the same in size.

    Args:
        model: the right object.
        others: objects to choose from, by name.
    """
    found = {f"x{scale:g}": scaled_object(model, scale) for scale in SCALES}
    found |= {kind: _stretched(model, factor) for kind, factor in STRETCHED.items()}
    if _chiral(model):
        found["mirrored"] = mirrored_object(model)
    sides = np.clip(1000 * model.size, 5.0, 700.0)
    longest = int(sides.argmax())
    across = float(np.delete(sides, longest).mean())
    for name in (
        "box:" + "x".join(f"{side:.0f}" for side in sides),
        f"cylinder:{across:.0f}x{sides[longest]:.0f}",
        f"sphere:{np.cbrt(np.prod(sides)):.0f}",
    ):
        shape = plain_shape(name, model.mass)
        if not _same_shape(shape, model):
            found[name.split(":")[0]] = shape
    size = float(np.linalg.norm(model.size))
    alike = [one for one in others.values() if not _same_shape(one, model)]
    if alike:
        proportions = np.array([np.sort(one.size) / np.linalg.norm(one.size) for one in alike])
        apart = np.linalg.norm(proportions - np.sort(model.size) / size, axis=1)
        for i in np.argsort(apart):
            # A ball in another size is the sphere.
            scaled = scaled_object(alike[i], size / float(np.linalg.norm(alike[i].size)))
            if not _same_shape(scaled, model):
                found["other, same size"] = scaled
                break
        sizes = [abs(np.log(np.linalg.norm(one.size) / size)) for one in alike]
        found["other"] = alike[int(np.argmin(sizes))]
    return found


def with_colors(known: KnownObject, points: np.ndarray, colors: np.ndarray, mesh: np.ndarray) -> KnownObject:
    """A mesh that is known with the colors of another one.

    Args:
        known: the mesh.
        points: of the other's surface, as parts of its box, shape [P, 3].
        colors: RGB there, 0 to 1, shape [P, 3].
        mesh: lowest and highest corner of this mesh's box [m], shape [2, 3].
    """
    samples = (known.surface.samples - mesh[0]) / (mesh[1] - mesh[0])
    return replace(known, colors=colors[KDTree(points).query(samples)[1]])


def searched_mesh(mesh: ObjectModel, right: ObjectModel) -> KnownObject:
    """A mesh made ready for the search; in a moment where it is the right one in another size."""
    if mesh.scaled_from is None or mesh.scaled_from[0] is not right:
        return known_object(mesh)
    known, factor = known_object(right), mesh.scaled_from[1]
    symmetries = known.symmetries.copy()
    symmetries[:, :3] *= factor
    return replace(
        known,
        surface=KnownSurface(SignedDistanceBank([mesh.signed_distance]), factor * known.surface.samples),
        rays=MeshRays(mesh.vertices, mesh.faces),
        size=factor * known.size,
        middle=factor * known.middle,
        symmetries=symmetries,
    )


def _stretched(model: ObjectModel, factor: float) -> ObjectModel:
    factors = np.where(np.arange(3) == int(model.size.argmax()), factor, 1.0)
    return ObjectModel(
        f"{model.name} stretched {factor:g}", model.mass, model.vertices * factors, model.faces
    )


def _points(model: ObjectModel) -> np.ndarray:
    return np.asarray(model.mesh.sample(600, seed=0)) - 0.5 * (model.vertices.min(0) + model.vertices.max(0))


def _same_shape(one: ObjectModel, other: ObjectModel) -> bool:
    """Whether two surfaces are alike in the frames that they have, sides sorted."""
    a, b = _points(one)[:, np.argsort(one.size)], _points(other)[:, np.argsort(other.size)]
    apart = max(KDTree(a).query(b)[0].mean(), KDTree(b).query(a)[0].mean())
    return bool(apart < SAME * np.linalg.norm(other.size) + 0.002)


def _chiral(model: ObjectModel) -> bool:
    """Whether no reflection in a plane of the mesh's axes, or of its principal ones, brings it to itself."""
    points = np.asarray(model.mesh.sample(3000, seed=0))
    tree, limit = KDTree(points), SAME * float(np.linalg.norm(model.size))
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    for axis in (*np.eye(3), *axes):
        along = points @ axis
        for middle in (0.5 * (along.min() + along.max()), along.mean()):
            mirrored = points - 2.0 * np.outer(along - middle, axis)
            if tree.query(mirrored[:500])[0].mean() < limit:
                return False
    return True
