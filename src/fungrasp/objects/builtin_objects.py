"""Built-in objects, and plain shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.objects.convex_decomposition import convex_hull
from fungrasp.objects.object_model import ObjectModel

MESHES = Path(__file__).parent / "builtin.npz"
"""File of the meshes."""

FIELDS = ("points", "faces", "part_of_face", "part_names", "corners", "corner_counts")
"""Arrays of the file, with the rows of all objects (``counts`` gives the numbers per object): points [m],
those of the surface first; triangles of the surface, part of each triangle, and names of the parts; corners
of the convex pieces as rows of ``points``, and number of corners of each piece."""

BUILTINS: Mapping[str, tuple[float, str]] = {
    "mug": (0.35, "0.3 l stoneware mug: volume of the mesh at 2300 kg/m3"),
    "wine_glass": (0.15, "typical 0.2 l glass; its wall is thicker than a real one"),
    "pitcher": (0.3, "typical 2 l polypropylene jug, empty"),
    "teapot": (0.7, "typical 0.6 l stoneware pot with lid, empty"),
    "pan": (0.89, "24 cm frying pan: volume of the mesh as aluminum, 2700 kg/m3"),
    "knife": (0.18, "19 cm chef's knife: blade and tang of steel, handle of plastic"),
    "bowl": (0.48, "15 cm stoneware bowl: volume of the mesh at 2300 kg/m3"),
    "spatula": (0.1, "typical turner, steel with a plastic handle"),
    "brush": (0.08, "typical plastic dish brush"),
    "can": (0.353, "0.33 l of soft drink (1.03 kg/l) and 13 g of aluminum"),
    "box": (0.525, "500 g of pasta and 25 g of carton"),
    "bottle": (0.52, "0.5 l of water and 20 g of PET"),
    "spray_bottle": (0.56, "0.5 l of cleaner and 60 g of bottle and trigger"),
    "hammer": (0.66, "16 oz (0.454 kg) claw hammer with handle"),
    "screwdriver": (0.097, "like the Phillips screwdriver of the YCB set"),
    "drill": (1.1, "typical 12 V cordless drill with its battery"),
    "clamp": (0.2, "like the extra large clamp of the YCB set"),
    "flashlight": (0.14, "two AA cells of 24 g in an aluminum tube"),
    "scissors": (0.082, "like the scissors of the YCB set"),
    "marker": (0.0158, "like the large marker of the YCB set"),
    "book": (0.5, "about 250 leaves: volume of the mesh at 0.73 g/cm3"),
    "tennis_ball": (0.058, "rules of the ITF: 56.0 to 59.4 g, 65.4 to 68.6 mm"),
}
"""Mass [kg] of each object, and the source of size and mass."""


def load_builtin(name: str, mass: float | None = None) -> ObjectModel:
    """Read a built-in object. name: key of ``BUILTINS``. mass: [kg]; the object's own if None."""
    own, source = BUILTINS[name]
    index = list(BUILTINS).index(name)
    of = {key: rows[index] for key, rows in _meshes().items()}
    # Rows are stored as differences from the previous row, which compress better.
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
    """Return the rows of each object, in the order of ``BUILTINS``, by field."""
    data = read_npz(MESHES, "built-in objects")
    ends = np.cumsum(data["counts"], axis=0)[:-1]
    return {key: np.split(data[key], ends[:, column]) for column, key in enumerate(FIELDS)}


SHAPES = {"box": ("length", "width", "height"), "cylinder": ("diameter", "height"), "sphere": ("diameter",)}
"""Sizes of each shape, in the order of its name: "box:60x28x30", "cylinder:66x115", "sphere:67"."""

SMALLEST, LARGEST = 1.0, 1500.0
"""Limits of a size [mm]."""

_SEGMENTS = 48
"""Number of sides of a cylinder, and of a sphere around its axis."""


def is_plain_shape(name: str) -> bool:
    """Return whether a name describes a shape: "box:...", "cylinder:..." or "sphere:..."."""
    return name.split(":", 1)[0] in SHAPES and ":" in name


@lru_cache(maxsize=256)
def plain_shape(name: str, mass: float) -> ObjectModel:
    """Make a plain shape from its name, centered at the origin; the axis of a cylinder is z.

    Args:
        name: "box:LENGTHxWIDTHxHEIGHT", "cylinder:DIAMETERxHEIGHT" or "sphere:DIAMETER", in millimeters.
        mass: [kg].

    Raises:
        FungraspError: the name is not that of a shape, or a size is invalid.
    """
    sizes = _sizes(name)
    kind = name.split(":", 1)[0]
    if kind == "box":
        points = 0.5 * np.array(sizes) * list(product((-1.0, 1.0), repeat=3))
    elif kind == "cylinder":
        radius, height = 0.5 * sizes[0], 0.5 * sizes[1]
        points = lathe([(radius, -height), (radius, height)], _SEGMENTS)
    else:
        angles = np.linspace(0.0, np.pi, _SEGMENTS // 2 + 1)
        radius = 0.5 * sizes[0]
        points = lathe([(radius * np.sin(a), -radius * np.cos(a)) for a in angles], _SEGMENTS)
    hull = convex_hull(points)
    return ObjectModel(
        name, mass, hull.vertices, hull.faces.astype(np.int32), construction=(hull,), source="its name"
    )


def lathe(profile: Sequence[tuple[float, float]], segments: int = 40) -> np.ndarray:
    """Return corners of a convex solid of revolution about z. profile: radius and height [m], bottom to
    top."""
    angles = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.insert(radius * circle, 2, height, axis=1) for radius, height in profile])


def _sizes(name: str) -> list[float]:
    """Parse the sizes in the name of a shape [m]."""
    kind, _, text = name.partition(":")
    wanted = SHAPES.get(kind, ())
    example = f"{kind}:{'x'.join(size.upper() for size in wanted)}" if wanted else "box:60x28x30"
    parts = text.split("x")
    if len(parts) != len(wanted) or not all(re.fullmatch(r"\d{1,4}(\.\d{1,6})?", part) for part in parts):
        raise FungraspError(f"'{name[:60]}' is not a shape: write {example}, sizes in millimeters")
    sizes = [float(part) for part in parts]
    if not SMALLEST <= min(sizes) <= max(sizes) <= LARGEST:
        raise FungraspError(f"'{name}': sizes must be {SMALLEST:g} to {LARGEST:g} mm")
    return [1e-3 * size for size in sizes]
