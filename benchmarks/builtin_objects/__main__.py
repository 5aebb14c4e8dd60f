"""``python -m benchmarks.builtin_objects``: writes the meshes of the package's built-in objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.builtin_objects import tools, vessels
from benchmarks.builtin_objects.assembly import PartSolids, assemble
from benchmarks.command import main
from fungrasp.core.files import atomic_path
from fungrasp.objects.builtin_objects import BUILTINS, FIELDS, MESHES

CONSTRUCTIONS: Mapping[str, Callable[[], PartSolids]] = {
    "mug": vessels.mug,
    "wine_glass": vessels.wine_glass,
    "pitcher": vessels.pitcher,
    "teapot": vessels.teapot,
    "pan": tools.pan,
    "knife": tools.knife,
    "bowl": tools.bowl,
    "spatula": tools.spatula,
    "brush": tools.brush,
    "can": vessels.can,
    "box": vessels.carton,
    "bottle": vessels.bottle,
    "spray_bottle": vessels.spray_bottle,
    "hammer": tools.hammer,
    "screwdriver": tools.screwdriver,
    "drill": tools.drill,
    "clamp": tools.clamp,
    "flashlight": tools.flashlight,
    "scissors": tools.scissors,
    "marker": tools.marker,
    "book": tools.book,
    "tennis_ball": tools.ball,
}
"""What makes the convex solids of an object, by its name."""


def write_builtin_objects(path: Path = MESHES) -> None:
    """Write all of them anew. Another version of manifold3d may cut the same surfaces into other triangles.

    Raises:
        FungraspError: the file can't be written.
    """
    made = [_fields(CONSTRUCTIONS[name]()) for name in BUILTINS]
    arrays: dict[str, Any] = {key: np.concatenate([fields[key] for fields in made]) for key in FIELDS}
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            counts=np.array([[len(fields[key]) for key in FIELDS] for fields in made]),
            **arrays,
        )


def _fields(parts: PartSolids) -> dict[str, np.ndarray]:
    """What the file holds of an object."""
    vertices, faces, masks, pieces = assemble(parts)
    # Most corners of pieces are points of the surface, to the last bit.
    points, row = list(vertices), {point.tobytes(): i for i, point in enumerate(vertices)}
    for corner in np.concatenate(pieces):
        if row.setdefault(corner.tobytes(), len(points)) == len(points):
            points.append(corner)
    return {
        "points": np.array(points),
        "faces": np.diff(faces.astype(np.uint16), axis=0, prepend=np.zeros((1, 3), np.uint16)),
        "part_of_face": np.argmax(list(masks.values()), axis=0).astype(np.uint8),
        "part_names": np.array(list(masks)),
        "corners": np.array([row[corner.tobytes()] for corner in np.concatenate(pieces)], np.uint16),
        "corner_counts": np.array([len(piece) for piece in pieces], np.uint16),
    }


@dataclass(frozen=True)
class WriteBuiltinObjects:
    """Write the meshes of the built-in objects anew, from their construction."""

    out: Path = MESHES
    """File to write (.npz)."""

    def run(self) -> None:
        write_builtin_objects(self.out)


if __name__ == "__main__":
    main("builtin_objects", WriteBuiltinObjects)
