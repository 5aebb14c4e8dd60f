"""Every built-in object with its mass and where size and mass come from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fungrasp.objects.builtin import containers, desk, drinking, kitchen, tools
from fungrasp.objects.builtin.assembly import Parts, assemble
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
    "mug": Builtin(drinking.Mug().parts, 0.34, "stoneware, 0.35 l, empty: volume of the mesh at 2300 kg/m3"),
    "wine_glass": Builtin(drinking.WineGlass().parts, 0.15, "glass"),
    "pitcher": Builtin(drinking.Pitcher().parts, 0.36, "polypropylene, 1.9 l"),
    "teapot": Builtin(drinking.Teapot().parts, 0.9, "stoneware with 0.3 l of tea"),
    "pan": Builtin(kitchen.Pan().parts, 0.95, "24 cm"),
    "knife": Builtin(kitchen.Knife().parts, 0.19, ""),
    "bowl": Builtin(kitchen.Bowl().parts, 0.4, ""),
    "spatula": Builtin(kitchen.Spatula().parts, 0.1, ""),
    "brush": Builtin(kitchen.Brush().parts, 0.1, ""),
    "can": Builtin(containers.Can().parts, 0.355, ""),
    "box": Builtin(containers.Carton().parts, 0.53, ""),
    "bottle": Builtin(containers.Bottle().parts, 0.525, ""),
    "spray_bottle": Builtin(containers.SprayBottle().parts, 0.57, ""),
    "hammer": Builtin(tools.Hammer().parts, 0.665, ""),
    "screwdriver": Builtin(tools.Screwdriver().parts, 0.097, ""),
    "drill": Builtin(tools.Drill().parts, 1.2, ""),
    "clamp": Builtin(tools.Clamp().parts, 0.2, ""),
    "flashlight": Builtin(tools.Flashlight().parts, 0.16, ""),
    "scissors": Builtin(desk.Scissors().parts, 0.082, ""),
    "marker": Builtin(desk.Marker().parts, 0.016, ""),
    "book": Builtin(desk.Book().parts, 0.45, ""),
    "tennis_ball": Builtin(desk.Ball().parts, 0.058, ""),
}
"""By name."""


def build(name: str, mass: float | None = None) -> ObjectModel:
    """Make a built-in object. name: a key of ``BUILTINS``. mass: [kg], its own if None."""
    entry = BUILTINS[name]
    vertices, faces, masks, pieces = assemble(entry.parts())
    mass = entry.mass if mass is None else float(mass)
    return ObjectModel(name, mass, vertices, faces, parts=masks, construction=pieces, source=entry.source)
