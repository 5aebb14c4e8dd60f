"""The built-in everyday objects: real sizes, real masses, named functional parts. What makes the file of
their meshes is ``benchmarks.builtin_objects``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.objects.convex_decomposition import convex_hull
from fungrasp.objects.object_model import ObjectModel

MESHES = Path(__file__).parent / "builtin.npz"
"""File of the meshes."""

FIELDS = ("points", "faces", "part_of_face", "part_names", "corners", "corner_counts")
"""Its arrays, each with the rows of all objects, ``counts`` of each: points [m], those of the surface first;
triangles of the surface, the part that each belongs to, and the names of the parts; corners of the convex
pieces, as rows of ``points``, and how many there are of each piece."""

BUILTINS: Mapping[str, tuple[float, str]] = {
    "mug": (0.35, "0.3 l stoneware mug: volume of the mesh at 2300 kg/m3"),
    "wine_glass": (0.15, "typical 0.2 l glass; its wall is thicker than a real one"),
    "pitcher": (0.3, "typical 2 l polypropylene jug, empty"),
    "teapot": (0.7, "typical 0.6 l stoneware pot with lid, empty"),
    "pan": (0.89, "24 cm frying pan: volume of the mesh as aluminium, 2700 kg/m3"),
    "knife": (0.18, "19 cm chef's knife: blade and tang of steel, handle of plastic"),
    "bowl": (0.48, "15 cm stoneware bowl: volume of the mesh at 2300 kg/m3"),
    "spatula": (0.1, "typical turner, steel with a plastic handle"),
    "brush": (0.08, "typical plastic dish brush"),
    "can": (0.353, "0.33 l of soft drink (1.03 kg/l) and 13 g of aluminium"),
    "box": (0.525, "500 g of pasta and 25 g of carton"),
    "bottle": (0.52, "0.5 l of water and 20 g of PET"),
    "spray_bottle": (0.56, "0.5 l of cleaner and 60 g of bottle and trigger"),
    "hammer": (0.66, "16 oz (0.454 kg) claw hammer with handle"),
    "screwdriver": (0.097, "like the Phillips screwdriver of the YCB set"),
    "drill": (1.1, "typical 12 V cordless drill with its battery"),
    "clamp": (0.2, "like the extra large clamp of the YCB set"),
    "flashlight": (0.14, "two AA cells of 24 g in an aluminium tube"),
    "scissors": (0.082, "like the scissors of the YCB set"),
    "marker": (0.0158, "like the large marker of the YCB set"),
    "book": (0.5, "about 250 leaves: volume of the mesh at 0.73 g/cm3"),
    "tennis_ball": (0.058, "rules of the ITF: 56.0 to 59.4 g, 65.4 to 68.6 mm"),
}
"""Mass [kg] of each object, and where size and mass come from."""


def load_builtin(name: str, mass: float | None = None) -> ObjectModel:
    """Read a built-in object. name: a key of ``BUILTINS``. mass: [kg], its own if None."""
    own, source = BUILTINS[name]
    index = list(BUILTINS).index(name)
    of = {key: rows[index] for key, rows in _meshes().items()}
    # Rows are differences from the row before, which take less room.
    faces = np.cumsum(of["faces"], axis=0, dtype=np.uint16).astype(np.int32)
    pieces = np.split(of["points"][of["corners"]], np.cumsum(of["corner_counts"])[:-1])
    return ObjectModel(
        name,
        own if mass is None else float(mass),
        of["points"][: faces.max() + 1].copy(),
        faces,
        parts={part: of["part_of_face"] == i for i, part in enumerate(of["part_names"].tolist())},
        construction=tuple(convex_hull(corners) for corners in pieces),
        source=source,
    )


@cache
def _meshes() -> dict[str, list[np.ndarray]]:
    """Rows of each object, in the order of ``BUILTINS``, by field."""
    data = read_npz(MESHES, "built-in objects")
    ends = np.cumsum(data["counts"], axis=0)[:-1]
    return {key: np.split(data[key], ends[:, column]) for column, key in enumerate(FIELDS)}
