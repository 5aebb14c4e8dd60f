"""The scene of a test capture: a person's hand and an object on a table among other things, in a room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import trimesh

from benchmarks.synthetic_captures.painted_mesh import PaintedMesh, fine_mesh_normals, painted_object
from benchmarks.synthetic_captures.skin_and_sleeve import Forearm, painted_hand, painted_sleeve
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.media.ray_tracing import Look
from fungrasp.media.surfaces import Color, SurfaceMesh
from fungrasp.objects import ObjectModel, builtin_object


class Label(IntEnum):
    """What a pixel of a test capture shows."""

    ROOM = 0
    TABLE = 1
    OBJECT = 2
    HAND = 3
    """Skin, the forearm included."""
    SLEEVE = 4
    CLUTTER = 5


TABLE_SIZE = (1.4, 0.9, 0.03)
"""Length, width and thickness of the table top [m]."""

CLUTTER = (
    "mug",
    "can",
    "box",
    "bottle",
    "bowl",
    "book",
    "tennis_ball",
    "marker",
    "flashlight",
    "spray_bottle",
)
"""Built-in objects that stand or lie about."""

CLUTTER_REACH = (0.10, 0.38)
"""Clutter stands so far from the grasp, measured between centers [m]."""

SLEEVES_WORN = 0.7
"""Fraction of the people who wear a sleeve."""

SLEEVES: tuple[Color, ...] = (
    (0.20, 0.26, 0.42),
    (0.72, 0.72, 0.74),
    (0.16, 0.16, 0.17),
    (0.55, 0.20, 0.20),
    (0.30, 0.42, 0.34),
    (0.80, 0.76, 0.62),
)
"""What is worn over the forearm, sRGB."""

SKIN_LIKE: tuple[Color, ...] = (
    (0.78, 0.60, 0.44),
    (0.70, 0.52, 0.36),
    (0.86, 0.68, 0.52),
    (0.62, 0.44, 0.30),
    (0.88, 0.74, 0.64),
)
"""Cardboard, light and dark wood, leather, plaster: things whose color is that of some skin, sRGB."""

WALL_DISTANCE = (1.4, 2.6)
"""Range of distances of the walls from the grasp [m]."""

_SPACE = 0.012
_FLOOR = -0.72
_WOODS: tuple[tuple[Color, Color], ...] = (
    ((0.72, 0.55, 0.38), (0.58, 0.41, 0.26)),
    ((0.50, 0.36, 0.25), (0.37, 0.25, 0.17)),
    ((0.84, 0.76, 0.64), (0.76, 0.66, 0.53)),
)
_PLAINS: tuple[Color, ...] = ((0.86, 0.86, 0.85), (0.32, 0.33, 0.35), (0.60, 0.63, 0.64), (0.42, 0.52, 0.60))


@dataclass(frozen=True)
class CaptureScene:
    """Surfaces to be seen, what they are, and the light."""

    surfaces: tuple[SurfaceMesh, ...]
    """Surfaces to be seen, world frame."""
    labels: np.ndarray
    """``Label`` of each surface, shape [surfaces] uint8."""
    look: Look
    """Lights, table top and backdrop."""
    arm: Forearm
    """The forearm of the hand that holds the object, world frame."""

    @property
    def arm_end(self) -> np.ndarray:
        """End of the arm [m], world frame, shape [3]; views that show it are avoided."""
        return self.arm.control[2]


def capture_scene(
    grasp: HumanGrasp,
    painted: PaintedMesh,
    rng: np.random.Generator,
    *,
    tones: Sequence[Color],
    clutter: int,
    towards: float,
    skin_like: float = 0.0,
) -> CaptureScene:
    """Put a grasp into a room.

    Args:
        grasp: of a right hand, world frame.
        painted: the grasped object, object frame.
        rng: decides skin, sleeve, table, clutter and light.
        tones: of skin, sRGB; one is taken.
        clutter: how many other things to put on the table; fewer if they don't find a place.
        towards: direction from the grasp to the camera along the table [rad]; the clutter keeps out of it.
        skin_like: part of the clutter, and of the table tops, with colors that some skin has.
    """
    skin, arm = painted_hand(grasp.hand_joints, tones[int(rng.integers(len(tones)))], rng)
    held = painted.moved(grasp.object_pose)
    glossy = held.surface(float(rng.uniform(0.05, 0.5)), float(rng.uniform(12, 80)))
    parts = [(Label.HAND, skin.surface(0.18, 15.0)), (Label.OBJECT, glossy)]
    if rng.uniform() < SLEEVES_WORN:
        cloth = SLEEVES[rng.integers(len(SLEEVES))]
        sleeve = painted_sleeve(arm, rng.uniform(0.25, 0.6), cloth, rng)
        parts.append((Label.SLEEVE, sleeve.surface(0.02, 6.0)))
    taken, center = np.concatenate([held.vertices, skin.vertices]), held.vertices.mean(0)
    for model, pose in _clutter(taken, center, clutter, towards, rng):
        obj = painted_object(model)
        if skin_like and rng.uniform() < skin_like:
            obj = _in_one_color(obj, SKIN_LIKE[rng.integers(len(SKIN_LIKE))])
        parts.append((Label.CLUTTER, obj.moved(pose).surface(0.3, 40.0)))
    parts.append((Label.TABLE, capture_table(center, skin_like, rng)))
    parts += [(Label.ROOM, surface) for surface in _room(center, rng)]
    labels, surfaces = zip(*parts, strict=True)
    return CaptureScene(surfaces, np.array(labels, np.uint8), _look(rng), arm)


def _clutter(
    taken: np.ndarray, center: np.ndarray, count: int, towards: float, rng: np.random.Generator
) -> list[tuple[ObjectModel, np.ndarray]]:
    """Things on the table that meet neither the grasp nor one another."""
    placed = []
    occupied = [taken[:, :2]]
    for _ in range(count):
        model = builtin_object(CLUTTER[rng.integers(len(CLUTTER))])
        for _ in range(12):
            away, azimuth = rng.uniform(*CLUTTER_REACH), towards + rng.uniform(0.2, 1.8) * np.pi
            pose = model.rest_pose(rng.uniform(0, 2 * np.pi))
            pose[:2] = center[:2] + away * np.array([np.cos(azimuth), np.sin(azimuth)])
            points = transform_points(pose, model.vertices)[:, :2]
            low, high = points.min(0) - _SPACE, points.max(0) + _SPACE
            if not any(((other > low) & (other < high)).all(1).any() for other in occupied):
                placed.append((model, pose))
                edge = np.linspace(0, 1, 12)
                u, v = np.meshgrid(edge, edge)
                occupied.append(
                    (points.min(0) + np.stack([u, v], -1) * np.ptp(points, axis=0)).reshape(-1, 2)
                )
                break
    return placed


def _in_one_color(painted: PaintedMesh, color: Color) -> PaintedMesh:
    """The same with the paint's light and dark in shades of one color."""
    gray = painted.colors.mean(axis=1, keepdims=True)
    shade = 1.0 + 0.25 * (gray - gray.mean())
    return replace(painted, colors=np.clip(shade * np.asarray(color), 0.0, 1.0))


def capture_table(center: np.ndarray, skin_like: float, rng: np.random.Generator) -> SurfaceMesh:
    """A table top under a point [m], world frame, shape [3]; skin_like: probability that its colors are such
    as some skin has."""
    size = np.array(TABLE_SIZE)
    box = trimesh.creation.box(size)
    vertices = np.array(box.vertices)
    places = vertices[:, :2] / size[:2] + 0.5
    image = _table_image(rng)
    if skin_like and rng.uniform() < skin_like:
        gray = image.mean(axis=-1, keepdims=True)
        color = np.asarray(SKIN_LIKE[rng.integers(len(SKIN_LIKE))])
        image = np.clip(color * gray / gray.mean(), 0, 1)
    offset = rng.uniform(-0.5, 0.5, 2) * (0.5 * size[1] - 0.25)
    yaw = rng.uniform(0, np.pi)
    pose = np.array([*(center[:2] + offset), -0.5 * size[2], np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    vertices, faces = transform_points(pose, vertices), np.array(box.faces)
    normals, specular = fine_mesh_normals(vertices, faces), float(rng.uniform(0, 0.15))
    return SurfaceMesh(vertices, faces, normals, np.ones(3), specular, 50.0, image, places[faces])


def _table_image(rng: np.random.Generator) -> np.ndarray:
    """Wood or something plain with a little grain, sRGB, shape [H, W, 3]."""
    y, x = np.mgrid[:384, :600] / 600.0
    if rng.uniform() < 0.6:
        light, dark = (np.asarray(c) for c in _WOODS[rng.integers(len(_WOODS))])
        board = np.floor(y * rng.uniform(6, 14))
        shift = np.sin(board * 12.9898 + rng.uniform(0, 6)) * 43.7
        rings = np.sin(60 * y + 6 * np.sin(5 * x + shift) + 3 * np.sin(11 * y + shift))
        part = 0.5 + 0.3 * rings + 0.12 * np.sin(400 * y + 9 * x + shift) + 0.2 * np.sin(shift)
        image = light + np.clip(part, 0, 1)[..., None] * (dark - light)
    else:
        image = np.broadcast_to(np.asarray(_PLAINS[rng.integers(len(_PLAINS))]), (*x.shape, 3))
        if rng.uniform() < 0.4:
            cells = (np.floor(x * 28) + np.floor(y * 28)) % 2
            image = image * (1 - 0.12 * cells[..., None])
    image = image * (1 + 0.02 * rng.normal(size=x.shape))[..., None]
    return np.clip(image, 0, 1)


def _room(center: np.ndarray, rng: np.random.Generator) -> list[SurfaceMesh]:
    """Floor and four walls."""
    gray = rng.uniform(0.45, 0.9)
    wall = np.clip(gray + rng.uniform(-0.08, 0.08, 3), 0, 1)
    floor = np.clip(0.6 * gray + rng.uniform(-0.1, 0.1, 3), 0, 1)
    middle = np.array([*center[:2], _FLOOR])
    things = [_block(middle - np.array([0, 0, 0.05]), (8, 8, 0.1), floor)]
    for i, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        away = rng.uniform(*WALL_DISTANCE)
        size = (0.1, 8, 2.6) if x else (8, 0.1, 2.6)
        things.append(_block(middle + np.array([x * away, y * away, 1.3]), size, wall * (1 - 0.06 * i)))
    return things


def _block(center: np.ndarray, size: Sequence[float], color: np.ndarray) -> SurfaceMesh:
    box = trimesh.creation.box(size)
    vertices = np.array(box.vertices) + center
    return PaintedMesh(vertices, np.array(box.faces), np.tile(color, (len(vertices), 1))).surface(0.0)


def _look(rng: np.random.Generator) -> Look:
    azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.9, 2.5)
    # The first was the lamp's radius: what is drawn after it stays as it was.
    _, key, fill = rng.uniform((2.0, 1.0, 0.7), (14.0, 2.3, 1.2)).tolist()
    return Look(
        backdrop_top=(0.0, 0.0, 0.0),
        backdrop_horizon=(0.0, 0.0, 0.0),
        light=(float(np.cos(azimuth)), float(np.sin(azimuth)), float(height)),
        key=key,
        fill=fill,
    )
