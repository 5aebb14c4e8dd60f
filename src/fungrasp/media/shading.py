"""How surfaces look: lights, materials, the table top, the backdrop and the conversion to 8 bits."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.media.pixel_loops import STEPS, to_levels

Color = tuple[float, float, float]
"""sRGB, each from 0 to 1."""


@dataclass(frozen=True)
class Look:
    """Light, table top and backdrop."""

    backdrop_top: Color = (0.78, 0.83, 0.88)
    """Color overhead."""
    backdrop_horizon: Color = (0.955, 0.96, 0.965)
    """Color at the horizon, into which the table top fades."""
    table: Color = (0.800, 0.812, 0.824)
    """Color of the light squares."""
    table_dark: Color = (0.752, 0.766, 0.780)
    """Color of the dark squares."""
    square: float = 0.05
    """Side of a square of the table top [m]."""
    fade: tuple[float, float] = (0.45, 1.7)
    """Distance from the first camera's target where the table top begins to fade, and is gone [m]."""
    light: tuple[float, float, float] | None = None
    """Direction towards the key light, world frame; None puts it above and to the left of the first
    camera.
    """
    light_radius: float = 6.0
    """Angular radius of the key light [degrees]; 0 makes hard shadows."""
    key: float = 2.2
    """Strength of the key light."""
    fill: float = 0.95
    """Strength of the light from all of the sky."""
    occlusion_radius: float = 0.08
    """Things nearer than this darken each other [m]."""

    def __post_init__(self) -> None:
        for name in ("backdrop_top", "backdrop_horizon", "table", "table_dark"):
            color = np.asarray(getattr(self, name), dtype=float)
            if color.shape != (3,) or not ((color >= 0) & (color <= 1)).all():
                raise FungraspError(f"{name} must be 3 numbers from 0 to 1, not {getattr(self, name)!r}")
        if self.light is not None and not (np.shape(self.light) == (3,) and np.linalg.norm(self.light) > 0):
            raise FungraspError(f"light must be a direction of 3 numbers, not {self.light!r}")
        if not 0 <= self.light_radius < 60:
            raise FungraspError(f"light_radius must lie between 0 and 60 degrees, not {self.light_radius}")

    @property
    def light_spread(self) -> float:
        """Tangent of the key light's angular radius."""
        return float(np.tan(np.radians(self.light_radius)))

    @property
    def numbers(self) -> np.ndarray:
        """What ``pixel_loops.shade`` needs, shape [8, 3]: linear colors of the table's light and dark
        squares, horizon, zenith, key light, sky, bounce from below; then the squares' side and where the
        table fades [m]."""
        table, dark, horizon, top = (
            linear(np.asarray(color))
            for color in (self.table, self.table_dark, self.backdrop_horizon, self.backdrop_top)
        )
        key = np.array([1.0, 0.965, 0.91]) * self.key / np.pi
        sky = np.array([0.93, 0.97, 1.03]) * self.fill * 0.62
        return np.array(
            [table, dark, horizon, top, key, sky, table * self.fill * 0.42, (self.square, *self.fade)]
        )


@dataclass(frozen=True)
class Materials:
    """Colors and gloss of a model's geoms."""

    colors: np.ndarray
    """sRGB and opacity, shape [ngeom, 4]."""
    specular: np.ndarray
    """Strength of the highlight, shape [ngeom]."""
    shininess: np.ndarray
    """Exponent of the highlight, shape [ngeom]."""


def model_materials(model: mujoco.MjModel) -> Materials:
    """What the model says: a geom's own color, or its material's if it has one and the geom's was left
    alone.
    """
    colors = model.geom_rgba.astype(np.float32).copy()
    specular = np.full(model.ngeom, 0.35, np.float32)
    shininess = np.full(model.ngeom, 40.0, np.float32)
    material = model.geom_matid
    has = material >= 0
    plain = has & np.all(np.abs(colors - [0.5, 0.5, 0.5, 1.0]) < 1e-6, axis=1)
    colors[plain] = model.mat_rgba[material[plain]]
    specular[has] = model.mat_specular[material[has]]
    shininess[has] = np.maximum(128.0 * model.mat_shininess[material[has]], 1.0)
    return Materials(colors, specular, shininess)


def linear(color: np.ndarray) -> np.ndarray:
    """sRGB to linear light; any shape, 0 to 1."""
    color = np.asarray(color, dtype=np.float32)
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def to_bytes(light: np.ndarray) -> np.ndarray:
    """Linear light, 1 being white, to 8-bit sRGB; any shape."""
    levels = np.ascontiguousarray(light, np.float32)
    result = np.empty(levels.shape, np.uint8)
    to_levels(result.reshape(-1), levels.reshape(-1), _GAMMA)
    return result


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products over the last axis; the shapes are equal."""
    return np.einsum("...i,...i->...", a, b)


def sun_direction(look: Look, rotation: np.ndarray) -> tuple[float, float, float]:
    """Direction towards the key light. rotation: of the camera, its axes as columns, shape [3, 3]."""
    right, forward = rotation[:, 0], rotation[:, 2]
    if look.light is not None:
        return look.light
    ahead = np.array([forward[0], forward[1], 0.0])
    size = np.linalg.norm(ahead)
    ahead = ahead / size if size > 1e-6 else np.cross([0.0, 0.0, 1.0], right)
    x, y, z = (-0.60 * right - 0.48 * ahead + np.array([0.0, 0.0, 1.05])).tolist()
    return x, y, z


_levels = np.linspace(0.0, 1.0, STEPS + 1)
_GAMMA = np.round(
    255
    * np.where(_levels <= 0.0031308, 12.92 * _levels, 1.055 * np.maximum(_levels, 1e-9) ** (1 / 2.4) - 0.055)
).astype(np.uint8)
