"""The shape of every built-in object; its mass is in ``fungrasp.objects.builtin_objects``."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from benchmarks.builtin_objects import containers, desk, drinking, kitchen, tools
from benchmarks.builtin_objects.assembly import PartSolids

CONSTRUCTIONS: Mapping[str, Callable[[], PartSolids]] = {
    "mug": drinking.Mug().parts,
    "wine_glass": drinking.WineGlass().parts,
    "pitcher": drinking.Pitcher().parts,
    "teapot": drinking.Teapot().parts,
    "pan": kitchen.Pan().parts,
    "knife": kitchen.Knife().parts,
    "bowl": kitchen.Bowl().parts,
    "spatula": kitchen.Spatula().parts,
    "brush": kitchen.Brush().parts,
    "can": containers.Can().parts,
    "box": containers.Carton().parts,
    "bottle": containers.Bottle().parts,
    "spray_bottle": containers.SprayBottle().parts,
    "hammer": tools.Hammer().parts,
    "screwdriver": tools.Screwdriver().parts,
    "drill": tools.Drill().parts,
    "clamp": tools.Clamp().parts,
    "flashlight": tools.Flashlight().parts,
    "scissors": desk.Scissors().parts,
    "marker": desk.Marker().parts,
    "book": desk.Book().parts,
    "tennis_ball": desk.Ball().parts,
}
"""What makes the convex solids of an object, by its name."""
