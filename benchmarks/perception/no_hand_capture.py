"""Captures without a human hand, but with much that looks like one: faces, robot hands, limbs of dolls, and
things with the colors of skin. They are for measuring how often a hand is seen where there is none."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.perception.other_people import painted_person
from benchmarks.perception.scene_additions import varied_settings
from benchmarks.synthetic_captures.capture_camera import posed_rays
from benchmarks.synthetic_captures.capture_scene import SKIN_LIKE, Label, surroundings
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.painted_mesh import PaintedMesh
from benchmarks.synthetic_captures.render_capture import drawn_intrinsics, photographed
from fungrasp.hands import hand_files, load_hand
from fungrasp.media.camera import orbit_camera
from fungrasp.media.ray_tracing import NOTHING, RayTracer
from fungrasp.media.surfaces import SurfaceMesh, drawn_geoms, geom_surface, linear, model_materials
from fungrasp.perception import Capture

CLUTTER = (2, 7)
"""Fewest and most things on the table."""

ELEVATION = (3.0, 60.0)
"""Range of elevations of the camera above the table [degrees]: low ones see faces."""

SKIN_LIKE_PART = 0.7
"""Part of the things, and of the tables, with the colors of skin."""

ROBOT_COLORED = 0.4
"""Part of the robot hands that are painted in a color of skin."""


def no_hand_capture(seed: int, index: int, settings: CaptureSettings | None = None) -> tuple[Capture, str]:
    """One capture without a hand.

    In turn there is a person, a robot's hand, limbs of a doll, and clutter alone; each may come with others.

    Args:
        seed: decides everything, together with the index.
        index: from 0 on.
        settings: camera and its errors; by default varied ones.

    Returns:
        The capture, and what is in it in words.
    """
    settings = settings or varied_settings()
    rng = np.random.default_rng([seed, index])
    azimuth = float(rng.uniform(0, 2 * np.pi))
    center = np.array([0.0, 0.0, 0.05])
    chosen = {("person", "robot hand", "limbs", "clutter")[index % 4]}
    chosen |= {kind for kind in ("person", "robot hand", "limbs") if rng.uniform() < 0.2}
    parts: list[tuple[Label, SurfaceMesh]] = []
    words = []
    if "robot hand" in chosen:
        name, surfaces = _robot_hand(rng)
        parts += [(Label.CLUTTER, surface) for surface in surfaces]
        words.append(f"{name} hand")
    if "limbs" in chosen:
        parts += [(Label.CLUTTER, mesh.surface(0.25, 20.0)) for mesh in _limbs(rng)]
        words.append("limbs")
    if "person" in chosen:
        center = _add_person(parts, azimuth, settings, rng)
        words.append("person")
    taken = np.concatenate([surface.vertices for _, surface in parts]) if parts else center[None]
    count = int(rng.integers(CLUTTER[0], CLUTTER[1] + 1))
    around, look = surroundings(
        taken[:: max(1, len(taken) // 2000)],
        np.zeros(3),
        rng,
        clutter=count,
        towards=azimuth,
        skin_like=SKIN_LIKE_PART,
    )
    parts += around
    tracer = RayTracer([surface for _, surface in parts], look)
    lens = drawn_intrinsics(settings, rng)
    camera = orbit_camera(
        (center + rng.normal(size=3) * 0.03).tolist(),
        rng.uniform(*settings.distance),
        float(np.degrees(azimuth)) + rng.normal() * 10,
        rng.uniform(*((ELEVATION[0], 25.0) if "person" in chosen else ELEVATION)),
    )
    pose = np.array(
        [*camera.position, *Rotation.from_matrix(camera.rotation).as_quat(scalar_first=True).tolist()]
    )
    rays, shape = posed_rays(lens, pose), (lens.height, lens.width)
    points = tracer.see(rays)
    light = tracer.picture(rays, points)
    distance = np.where(points.surface == NOTHING, 0.0, points.distance).reshape(shape)
    depth = (distance / np.linalg.norm(lens.rays(), axis=-1)).astype(np.float32)
    return photographed(light, depth, lens, settings, rng), " and ".join(words) or "clutter"


def _add_person(
    parts: list[tuple[Label, SurfaceMesh]],
    towards: float,
    settings: CaptureSettings,
    rng: np.random.Generator,
) -> np.ndarray:
    """A person behind the table, who looks about at the camera; the point that the camera looks at [m]."""
    tone = settings.skin[int(rng.integers(len(settings.skin)))]
    away, side = rng.uniform(0.05, 0.35), towards + np.pi
    place = np.array([away * np.cos(side), away * np.sin(side), rng.uniform(0.22, 0.4)])
    turn = Rotation.from_euler(
        "ZYX", [towards + rng.normal() * 0.5, rng.uniform(-0.2, 0.4), rng.normal() * 0.2]
    )
    pose = np.concatenate([place, turn.as_quat(scalar_first=True)])
    parts += [(Label.PERSON, mesh.moved(pose).surface(0.12, 15.0)) for mesh in painted_person(tone, rng)]
    return place - [0, 0, rng.uniform(0.0, 0.15)]


def _robot_hand(rng: np.random.Generator) -> tuple[str, list[SurfaceMesh]]:
    """A robot's hand that lies or stands on the table with its joints anyhow, in its own colors or in one of
    skin."""
    names = [name for name in sorted(hand_files()) if name != "human"]
    name = names[int(rng.integers(len(names)))]
    model = load_hand(name).model
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    limited = model.jnt_limited.astype(bool) & (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    for joint in np.flatnonzero(limited):
        data.qpos[model.jnt_qposadr[joint]] = rng.uniform(low[joint], high[joint])
    mujoco.mj_kinematics(model, data)
    materials = model_materials(model)
    turn = Rotation.random(rng=rng)
    skin = np.asarray(SKIN_LIKE[int(rng.integers(len(SKIN_LIKE)))]) if rng.uniform() < ROBOT_COLORED else None
    surfaces = []
    for geom in np.flatnonzero(drawn_geoms(model, ground=True)):
        surface = geom_surface(model, int(geom), materials)
        rotation = turn.as_matrix() @ data.geom_xmat[geom].reshape(3, 3)
        surface = surface.moved(turn.apply(data.geom_xpos[geom]), rotation)
        if skin is not None:
            surface = replace(surface, color=linear(skin), texture=None, corner_uv=None)
        surfaces.append(surface)
    every = np.concatenate([surface.vertices for surface in surfaces])
    shift = np.array([*(-every[:, :2].mean(axis=0)), 0.002 - every[:, 2].min()])
    return name, [surface.moved(shift, np.eye(3)) for surface in surfaces]


def _limbs(rng: np.random.Generator) -> list[PaintedMesh]:
    """A few tapered rods and balls in a color of skin, as dolls and dummies have for limbs."""
    color = np.asarray(SKIN_LIKE[int(rng.integers(len(SKIN_LIKE)))])
    meshes = []
    for _ in range(int(rng.integers(3, 8))):
        radius, length = rng.uniform(0.007, 0.03), rng.uniform(0.03, 0.18)
        rod = trimesh.creation.capsule(height=length, radius=radius, count=(24, 24))
        turn = Rotation.from_euler("ZYX", [rng.uniform(0, 2 * np.pi), np.pi / 2 + rng.normal() * 0.3, 0])
        vertices = turn.apply(np.array(rod.vertices))
        vertices += [*(rng.normal(size=2) * 0.06), 0.002 - vertices[:, 2].min() + rng.uniform(0, 0.05)]
        shade = np.clip(color * rng.uniform(0.9, 1.05), 0, 1)
        meshes.append(PaintedMesh(vertices, np.array(rod.faces), np.tile(shade, (len(vertices), 1))))
    return meshes
