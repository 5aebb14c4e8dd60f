"""Every built-in object with its mass and where that comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fungrasp.objects.builtin.assembly import Parts, assemble
from fungrasp.objects.builtin.containers import Can, Carton, Mug
from fungrasp.objects.model import ObjectModel


@dataclass(frozen=True)
class Builtin:
    """A built-in object before its mesh is made."""

    parts: Callable[[], Parts]
    """Makes the convex solids."""
    mass: float
    """[kg]."""
    source: str
    """Why this size and mass."""


BUILTINS = {
    "mug": Builtin(Mug().parts, 0.34, "stoneware mug of 0.3 l, empty"),
    "box": Builtin(Carton().parts, 0.4, "carton"),
    "can": Builtin(Can().parts, 0.35, "drink can of 0.33 l, full"),
}
"""By name."""


def build(name: str, mass: float | None = None) -> ObjectModel:
    """Make a built-in object. name: a key of ``BUILTINS``. mass: [kg], its own if None."""
    entry = BUILTINS[name]
    vertices, faces, masks, pieces = assemble(entry.parts())
    mass = entry.mass if mass is None else float(mass)
    return ObjectModel(name, mass, vertices, faces, parts=masks, construction=pieces, source=entry.source)
