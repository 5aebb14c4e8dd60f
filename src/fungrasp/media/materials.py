"""Materials for the parts of built-in objects."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fungrasp.objects import MIRRORED, ObjectModel


class Material(NamedTuple):
    """Appearance of a surface."""

    color: tuple[float, float, float]
    """sRGB."""
    specular: float = 0.3
    """Strength of the highlight, 0 to 1."""
    shininess: float = 0.3
    """Sharpness of the highlight, 0 to 1, as in MuJoCo."""


PLAIN = Material((0.36, 0.55, 0.72))
"""Material of objects without known materials."""

STEEL = Material((0.70, 0.72, 0.75), 0.9, 0.7)
IRON = Material((0.30, 0.31, 0.33), 0.6, 0.5)
GLAZE = Material((0.36, 0.55, 0.72), 0.6, 0.8)
STONEWARE = Material((0.87, 0.85, 0.79), 0.5, 0.7)
GLASS = Material((0.70, 0.82, 0.84), 1.0, 0.95)
WOOD = Material((0.66, 0.48, 0.30), 0.12, 0.15)
PAPER = Material((0.93, 0.91, 0.85), 0.03, 0.05)
RUBBER = Material((0.17, 0.18, 0.20), 0.15, 0.1)


def _plastic(red: float, green: float, blue: float) -> Material:
    return Material((red, green, blue), 0.35, 0.4)


BLUE, GREEN, RED = _plastic(0.20, 0.42, 0.66), _plastic(0.25, 0.55, 0.42), _plastic(0.70, 0.20, 0.20)
WHITE, TEAL = _plastic(0.90, 0.91, 0.92), _plastic(0.16, 0.47, 0.52)

LOOKS: dict[str, dict[str, Material]] = {
    "mug": {"": GLAZE, "rim": STONEWARE},
    "wine_glass": {"": GLASS},
    "pitcher": {"": WHITE, "handle": BLUE},
    "teapot": {"": STONEWARE, "lid": GLAZE, "handle": GLAZE},
    "pan": {"": IRON, "handle": RUBBER},
    "knife": {"": STEEL, "handle": RUBBER},
    "bowl": {"": STONEWARE, "rim": GLAZE},
    "spatula": {"": STEEL, "handle": RUBBER},
    "brush": {"": BLUE, "bristles": WHITE},
    "can": {"": GREEN._replace(specular=0.8, shininess=0.6), "rim": STEEL},
    "box": {"": PAPER._replace(color=(0.30, 0.46, 0.68))},
    "bottle": {"": Material((0.62, 0.78, 0.86), 0.9, 0.9), "cap": BLUE},
    "spray_bottle": {"": WHITE, "head": BLUE, "trigger": RED, "neck": BLUE},
    "hammer": {"": STEEL, "grip": RUBBER, "shaft": WOOD},
    "screwdriver": {"": STEEL, "handle": RED},
    "drill": {"": TEAL, "chuck": STEEL, "trigger": RED, "battery": RUBBER, "grip": RUBBER},
    "clamp": {"": GREEN, "pivot": STEEL},
    "flashlight": {"": Material((0.25, 0.28, 0.36), 0.7, 0.5), "switch": RED, "head": STEEL},
    "scissors": {"": STEEL, "loops": RED},
    "marker": {"": WHITE, "cap": Material((0.15, 0.16, 0.18))},
    "book": {"": PAPER._replace(color=(0.45, 0.22, 0.26)), "pages": PAPER},
    "tennis_ball": {"": Material((0.78, 0.86, 0.25), 0.02, 0.05)},
}
"""Materials of built-in objects by part; "" is for all other parts."""


def painted_parts(model: ObjectModel) -> list[tuple[Material, np.ndarray]]:
    """Return the materials of an object with the mask of faces of each, shape [F] bool."""
    looks = LOOKS.get(model.name.removesuffix(MIRRORED), {}) if model.parts else {}
    rest = np.ones(len(model.faces), dtype=bool)
    masks: dict[Material, np.ndarray] = {}
    for part, faces in model.parts.items():
        if part in looks:
            masks[looks[part]] = masks.get(looks[part], np.zeros_like(rest)) | (faces & rest)
            rest &= ~faces
    masks[looks.get("", PLAIN)] = masks.get(looks.get("", PLAIN), np.zeros_like(rest)) | rest
    return [(material, mask) for material, mask in masks.items() if mask.any()]
