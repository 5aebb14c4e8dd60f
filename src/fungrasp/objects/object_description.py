"""Description of an object in plain values: what ``fungrasp objects show`` prints."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fungrasp.objects.object_model import ObjectModel
from fungrasp.objects.piece_fidelity import piece_fidelity


def describe_object(model: ObjectModel) -> dict[str, Any]:
    """Size [m], volume [m3], mass [kg], inertia [kg m2], fidelity of the pieces [m], ...; ready for JSON."""
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
