"""Every built-in object with its mass and where size and mass come from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fungrasp.objects.builtin import containers, desk, drinking, kitchen, tools
from fungrasp.objects.builtin.assembly import PartSolids, assemble
from fungrasp.objects.object_model import ObjectModel


@dataclass(frozen=True)
class BuiltinObject:
    """A built-in object before its mesh is made."""

    parts: Callable[[], PartSolids]
    """Makes the convex solids."""
    mass: float
    """Mass [kg]."""
    source: str
    """Where size and mass come from."""


BUILTINS = {
    "mug": BuiltinObject(drinking.Mug().parts, 0.35, "0.3 l stoneware mug: volume of the mesh at 2300 kg/m3"),
    "wine_glass": BuiltinObject(
        drinking.WineGlass().parts, 0.15, "typical 0.2 l glass; its wall is thicker than a real one"
    ),
    "pitcher": BuiltinObject(drinking.Pitcher().parts, 0.3, "typical 2 l polypropylene jug, empty"),
    "teapot": BuiltinObject(drinking.Teapot().parts, 0.7, "typical 0.6 l stoneware pot with lid, empty"),
    "pan": BuiltinObject(
        kitchen.Pan().parts, 0.89, "24 cm frying pan: volume of the mesh as aluminium, 2700 kg/m3"
    ),
    "knife": BuiltinObject(
        kitchen.Knife().parts, 0.18, "19 cm chef's knife: blade and tang of steel, handle of plastic"
    ),
    "bowl": BuiltinObject(
        kitchen.Bowl().parts, 0.48, "15 cm stoneware bowl: volume of the mesh at 2300 kg/m3"
    ),
    "spatula": BuiltinObject(kitchen.Spatula().parts, 0.1, "typical turner, steel with a plastic handle"),
    "brush": BuiltinObject(kitchen.Brush().parts, 0.08, "typical plastic dish brush"),
    "can": BuiltinObject(
        containers.Can().parts, 0.353, "0.33 l of soft drink (1.03 kg/l) and 13 g of aluminium"
    ),
    "box": BuiltinObject(containers.Carton().parts, 0.525, "500 g of pasta and 25 g of carton"),
    "bottle": BuiltinObject(containers.Bottle().parts, 0.52, "0.5 l of water and 20 g of PET"),
    "spray_bottle": BuiltinObject(
        containers.SprayBottle().parts, 0.56, "0.5 l of cleaner and 60 g of bottle and trigger"
    ),
    "hammer": BuiltinObject(tools.Hammer().parts, 0.66, "16 oz (0.454 kg) claw hammer with handle"),
    "screwdriver": BuiltinObject(
        tools.Screwdriver().parts, 0.097, "like the Phillips screwdriver of the YCB set"
    ),
    "drill": BuiltinObject(tools.Drill().parts, 1.1, "typical 12 V cordless drill with its battery"),
    "clamp": BuiltinObject(tools.Clamp().parts, 0.2, "like the extra large clamp of the YCB set"),
    "flashlight": BuiltinObject(tools.Flashlight().parts, 0.14, "two AA cells of 24 g in an aluminium tube"),
    "scissors": BuiltinObject(desk.Scissors().parts, 0.082, "like the scissors of the YCB set"),
    "marker": BuiltinObject(desk.Marker().parts, 0.0158, "like the large marker of the YCB set"),
    "book": BuiltinObject(desk.Book().parts, 0.5, "about 250 leaves: volume of the mesh at 0.73 g/cm3"),
    "tennis_ball": BuiltinObject(
        desk.Ball().parts, 0.058, "rules of the ITF: 56.0 to 59.4 g, 65.4 to 68.6 mm"
    ),
}
"""By name."""


def build_builtin(name: str, mass: float | None = None) -> ObjectModel:
    """Make a built-in object. name: a key of ``BUILTINS``. mass: [kg], its own if None."""
    entry = BUILTINS[name]
    vertices, faces, masks, pieces = assemble(entry.parts())
    mass = entry.mass if mass is None else float(mass)
    return ObjectModel(name, mass, vertices, faces, parts=masks, construction=pieces, source=entry.source)
