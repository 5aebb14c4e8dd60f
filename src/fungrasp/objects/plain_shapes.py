"""Objects without a mesh file: boxes, cylinders and spheres, which their names describe."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.objects.convex_decomposition import convex_hull
from fungrasp.objects.object_model import ObjectModel

SHAPES = {"box": ("length", "width", "height"), "cylinder": ("diameter", "height"), "sphere": ("diameter",)}
"""Sizes of each shape, in the order of its name: "box:60x28x30", "cylinder:66x115", "sphere:67"."""

SMALLEST, LARGEST = 1.0, 1500.0
"""Limits of a size [mm]."""

_SEGMENTS = 48
"""Flat sides of a cylinder, and of a sphere around its axis."""


def is_plain_shape(name: str) -> bool:
    """Whether a name describes a shape: "box:...", "cylinder:..." or "sphere:..."."""
    return name.split(":", 1)[0] in SHAPES and ":" in name


@lru_cache(maxsize=256)
def plain_shape(name: str, mass: float) -> ObjectModel:
    """The object that a name describes, its center at the origin, a cylinder's axis along z.

    Args:
        name: "box:LENGTHxWIDTHxHEIGHT", "cylinder:DIAMETERxHEIGHT" or "sphere:DIAMETER", in millimetres.
        mass: [kg].

    Raises:
        FungraspError: the name describes no shape, or a size is impossible.
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
    """Corners of a convex solid of revolution about z. profile: radius and height [m], from bottom to top."""
    angles = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.insert(radius * circle, 2, height, axis=1) for radius, height in profile])


def _sizes(name: str) -> list[float]:
    """The sizes that a name says [m]."""
    kind, _, text = name.partition(":")
    wanted = SHAPES.get(kind, ())
    example = f"{kind}:{'x'.join(size.upper() for size in wanted)}" if wanted else "box:60x28x30"
    parts = text.split("x")
    if len(parts) != len(wanted) or not all(re.fullmatch(r"\d{1,4}(\.\d{1,6})?", part) for part in parts):
        raise FungraspError(f"'{name[:60]}' is no shape: write {example}, sizes in millimetres")
    sizes = [float(part) for part in parts]
    if not SMALLEST <= min(sizes) <= max(sizes) <= LARGEST:
        raise FungraspError(f"'{name}': sizes must be {SMALLEST:g} to {LARGEST:g} mm")
    return [1e-3 * size for size in sizes]
