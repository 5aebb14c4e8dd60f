"""How surfaces look: lights, materials, the table top, the backdrop and the conversion to 8 bits."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.errors import FungraspError

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
    return _GAMMA[np.clip(light * _STEPS + 0.5, 0, _STEPS).astype(np.int32)]


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products over the last axis; the shapes are equal."""
    return np.einsum("...i,...i->...", a, b)


def soft_clip(light: np.ndarray) -> np.ndarray:
    """Compress what is brighter than the display so that it keeps its hue; the dark two thirds stay as they
    are.
    """
    knee = np.float32(0.65)
    over = np.maximum(light - knee, 0.0)
    return np.minimum(light, knee) + (1 - knee) * over / (over + (1 - knee))


def backdrop(look: Look, directions: np.ndarray) -> np.ndarray:
    """Linear color of the sky. directions: unit, world frame, shape [R, 3]. Returns shape [R, 3]."""
    height = np.clip(directions[:, 2:] * 1.6, 0.0, 1.0).astype(np.float32)
    return (
        linear(np.asarray(look.backdrop_horizon)) * (1 - height)
        + linear(np.asarray(look.backdrop_top)) * height
    )


def table_top(look: Look, points: np.ndarray, directions: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Linear color of the table, its squares filtered over the width of a pixel.

    Args:
        points: (x, y) [m], world frame, shape [P, 2].
        directions: unit view directions, shape [P, 3].
        width: of a pixel across the view [m], shape [P].

    Returns:
        shape [P, 3].
    """
    side = np.float32(look.square)
    slant = width / np.maximum(-directions[:, 2], 1e-4)
    along = np.sqrt(directions[:, 0] ** 2 + directions[:, 1] ** 2 + 1e-12)
    wave = np.ones(len(points), np.float32)
    for axis in (0, 1):
        towards = np.abs(directions[:, axis]) / along
        aside = np.abs(directions[:, 1 - axis]) / along
        w = np.maximum((towards * slant + aside * width) / side, 1e-4)
        x = points[:, axis] / side
        wave *= (_triangle(x + 0.5 * w) - _triangle(x - 0.5 * w)) / w
    light, dark = linear(np.asarray(look.table)), linear(np.asarray(look.table_dark))
    return light + (0.5 - 0.5 * wave)[:, None] * (dark - light)


def lit(
    look: Look,
    albedo: np.ndarray,
    normals: np.ndarray,
    views: np.ndarray,
    sun: np.ndarray,
    shadow: np.ndarray,
    openness: np.ndarray,
    specular: np.ndarray,
    shininess: np.ndarray,
) -> np.ndarray:
    """Linear light that leaves surfaces towards the eye: key light, sky and bounce from below, highlight,
    faint rim.

    Args:
        albedo: linear colors, shape [P, 3].
        normals: unit, world frame, shape [P, 3].
        views: unit directions from the eye to the surface, shape [P, 3].
        sun: unit direction towards the key light, shape [3].
        shadow: part of the key light that arrives, shape [P].
        openness: part of the surroundings that is not hidden by near things, shape [P].
        specular: strength of the highlight, shape [P].
        shininess: its exponent, shape [P].

    Returns:
        shape [P, 3].
    """
    facing = normals @ sun
    diffuse = np.maximum(facing, 0.0) * shadow
    up = 0.5 + 0.5 * normals[:, 2]
    bounce_color = linear(np.asarray(look.table)) * np.float32(look.fill * 0.42)
    ambient = (up[:, None] * _sky_color(look) + (1 - up[:, None]) * bounce_color) * openness[:, None]
    half = sun - views
    half /= np.sqrt(dot(half, half))[:, None]
    shine = np.maximum(dot(normals, half), 0.0) ** shininess * specular * diffuse * (shininess + 8) / 60.0
    grazing = (1.0 - np.clip(-dot(normals, views), 0.0, 1.0)) ** 4
    sheen = grazing * openness * (0.12 * up) * np.minimum(specular * 3, 1.0)
    return albedo * (diffuse[:, None] * _key_color(look) + ambient) + (0.5 * shine + sheen)[:, None]


def lit_table(
    look: Look, albedo: np.ndarray, sun: np.ndarray, shadow: np.ndarray, openness: np.ndarray
) -> np.ndarray:
    """``lit`` for a matt, level table top. Returns shape [P, 3]."""
    diffuse = np.float32(max(float(sun[2]), 0.0)) * shadow
    return albedo * (diffuse[:, None] * _key_color(look) + openness[:, None] * _sky_color(look))


def table_fade(look: Look, points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """How much of the table is still there, 1 to 0. points: (x, y) [m], shape [P, 2]. Returns shape [P]."""
    near, far = look.fade
    distance = np.hypot(points[:, 0] - middle[0], points[:, 1] - middle[1])
    s = np.clip((far - distance) / (far - near), 0.0, 1.0).astype(np.float32)
    return s * s * (3 - 2 * s)


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


def _key_color(look: Look) -> np.ndarray:
    return np.array([1.0, 0.965, 0.91], np.float32) * np.float32(look.key / np.pi)


def _sky_color(look: Look) -> np.ndarray:
    return np.array([0.93, 0.97, 1.03], np.float32) * np.float32(look.fill * 0.62)


def _triangle(x: np.ndarray) -> np.ndarray:
    phase = np.mod(x, 2.0)
    return np.minimum(phase, 2.0 - phase)


_STEPS = 4095
_levels = np.linspace(0.0, 1.0, _STEPS + 1)
_GAMMA = np.round(
    255
    * np.where(_levels <= 0.0031308, 12.92 * _levels, 1.055 * np.maximum(_levels, 1e-9) ** (1 / 2.4) - 0.055)
).astype(np.uint8)
