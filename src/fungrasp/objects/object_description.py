"""Description of an object in plain values: what ``fungrasp objects show`` prints."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from fungrasp.geometry.signed_distance import mesh_signed_distance
from fungrasp.objects.object_model import ObjectModel

SAMPLES = 4000
"""Number of points at which pieces are compared with their mesh."""


def describe_object(model: ObjectModel) -> dict[str, Any]:
    """Return size [m], volume [m3], mass [kg], inertia [kg m2], piece fidelity [m], ..., as JSON values."""
    mesh = model.mesh
    areas = mesh.area_faces
    return {
        "name": model.name,
        "source": model.source,
        "size": model.size.tolist(),
        "vertices": len(model.vertices),
        "faces": len(model.faces),
        "watertight": bool(mesh.is_watertight),
        "repairs": list(model.repairs),
        "volume": float(mesh.volume),
        "mass": model.mass,
        "center_of_mass": model.center_of_mass.tolist(),
        "inertia": model.inertia.tolist(),
        "parts": {name: {"area": float(areas[mask].sum())} for name, mask in model.parts.items()},
        "pieces": len(model.pieces),
        "fidelity": asdict(piece_fidelity(model)),
    }


@dataclass(frozen=True)
class Fidelity:
    """Deviation of the union of an object's pieces from its mesh [m]."""

    bulge_max: float
    """Largest distance of a point of a piece outside the mesh [m]."""
    bulge_mean: float
    """Mean distance outside the mesh over the pieces' surface [m], 0 inside."""
    shrink_max: float
    """Largest distance of a point of the mesh outside all pieces [m]."""
    shrink_mean: float
    """Mean distance outside all pieces over the mesh [m], 0 inside a piece."""


def piece_fidelity(model: ObjectModel) -> Fidelity:
    """Compare the pieces with the mesh, at ``SAMPLES`` points on the mesh and on all pieces together, and at
    the pieces' corners."""
    shapes = [trimesh.Trimesh(piece.vertices, piece.faces, process=False) for piece in model.pieces]
    area = sum(shape.area for shape in shapes)
    on_pieces = np.concatenate([_surface(shape, round(SAMPLES * shape.area / area)) for shape in shapes])
    corners = np.concatenate([piece.vertices for piece in model.pieces])
    outside = np.maximum(mesh_signed_distance(model.mesh, np.concatenate([on_pieces, corners])), 0.0)
    on_mesh = _surface(model.mesh, SAMPLES)
    planes = [ConvexHull(piece.vertices).equations for piece in model.pieces]
    uncovered = np.maximum(
        np.min([(on_mesh @ p[:, :3].T + p[:, 3]).max(axis=1) for p in planes], axis=0), 0.0
    )
    return Fidelity(
        bulge_max=float(outside.max()),
        bulge_mean=float(outside[: len(on_pieces)].mean()),
        shrink_max=float(uncovered.max()),
        shrink_mean=float(uncovered.mean()),
    )


def _surface(mesh: trimesh.Trimesh, count: int) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(mesh, max(count, 1), seed=0)[0])
