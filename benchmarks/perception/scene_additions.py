"""What else may be seen in a test capture: rings, a watch, another person's hand, people across the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.perception.other_people import other_hand, painted_person
from benchmarks.perception.worn_things import painted_ring, painted_watch
from benchmarks.synthetic_captures.capture_scene import SLEEVES, SLEEVES_WORN, CaptureScene, Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings, camera_settings
from benchmarks.synthetic_captures.painted_mesh import PaintedMesh
from benchmarks.synthetic_captures.skin_and_sleeve import back_of_hand
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import HumanGrasp, builtin_grasps
from fungrasp.media.surfaces import Color, SurfaceMesh

HAND_AWAY = (0.16, 0.38)
"""Another person's hand is so far from the grasp, between their middles [m]."""

PERSON_AWAY, HEAD_HEIGHT = (0.45, 0.80), (0.24, 0.48)
"""A person is so far from the grasp along the table, with the middle of the head so high above it [m]."""

CLEAR = 0.02
"""Another hand is at least so far from hand and object [m]."""


@dataclass(frozen=True)
class MoreInTheImage:
    """Adds worn things and other people to scenes."""

    worn: float = 0.0
    """Part of the hands that wear a ring, and part that wears a watch."""
    people: float = 0.0
    """Part of the scenes with a hand of somebody else beside the grasp, and part with a person behind it."""

    def __post_init__(self) -> None:
        for name in ("worn", "people"):
            if not 0 <= getattr(self, name) <= 1:
                raise FungraspError(f"captures: {name} is a part, from 0 to 1, not {getattr(self, name)}")

    def __call__(
        self,
        scene: CaptureScene,
        grasp: HumanGrasp,
        center: np.ndarray,
        towards: float,
        tones: Sequence[Color],
        rng: np.random.Generator,
    ) -> CaptureScene:
        scene = with_worn_things(scene, grasp, self.worn, rng)
        return with_other_people(scene, center, towards, self.people, tones, rng)


def varied_settings(camera: str = "mixed") -> CaptureSettings:
    """``camera_settings`` with left hands, rings, watches, and other people in the image.

    Raises:
        UnknownNameError: there is no such camera.
    """
    return replace(camera_settings(camera), additions=MoreInTheImage(0.3, 0.3), left=0.4)


def with_worn_things(
    scene: CaptureScene, grasp: HumanGrasp, part: float, rng: np.random.Generator
) -> CaptureScene:
    """The scene with rings and a watch on the hand, each worn by this part of the people."""
    parts: list[tuple[Label, SurfaceMesh]] = []
    if rng.uniform() < part:
        parts.append((Label.WORN, painted_ring(grasp.hand_joints, rng).surface(0.6, 60.0)))
    if rng.uniform() < part:
        watch = painted_watch(scene.arm, back_of_hand(grasp.hand_joints), rng)
        parts.append((Label.WORN, watch.surface(0.4, 50.0)))
    return scene.with_parts(parts)


def with_other_people(
    scene: CaptureScene,
    center: np.ndarray,
    towards: float,
    part: float,
    tones: Sequence[Color],
    rng: np.random.Generator,
) -> CaptureScene:
    """The scene with a hand of somebody else beside the grasp, and a person behind it, each in this part of
    the scenes.

    Args:
        scene: as far as it is made.
        center: of the held object [m], world frame, shape [3].
        towards: direction from the grasp to the camera along the table [rad].
        part: of the scenes.
        tones: of skin, sRGB.
        rng: random numbers.
    """
    parts: list[tuple[Label, SurfaceMesh]] = []
    tone = tones[int(rng.integers(len(tones)))]
    if rng.uniform() < part:
        taken = [
            surface.vertices
            for surface, label in zip(scene.surfaces, scene.labels, strict=True)
            if label in (Label.HAND, Label.OBJECT, Label.SLEEVE)
        ]
        held = np.concatenate(taken) if taken else center[None]
        meshes = _placed_hand(held, center, towards, tone, rng)
        parts += [(Label.PERSON, mesh.surface(0.15, 15.0)) for mesh in meshes]
    if rng.uniform() < part:
        parts += [(Label.PERSON, mesh.surface(0.12, 15.0)) for mesh in _seated(center, towards, tone, rng)]
    return scene.with_parts(parts)


def _placed_hand(
    taken: np.ndarray, center: np.ndarray, towards: float, tone: Color, rng: np.random.Generator
) -> list[PaintedMesh]:
    """A hand that meets neither the grasp nor hides it; none if it finds no place."""
    grasps = builtin_grasps()
    joints = grasps.hand_joints[int(rng.integers(len(grasps)))]
    cloth = SLEEVES[int(rng.integers(len(SLEEVES)))] if rng.uniform() < SLEEVES_WORN else None
    meshes = other_hand(joints, tone, cloth, rng)
    middle = meshes[0].vertices[:, :2].mean(axis=0)
    tree = KDTree(taken[::7])
    for _ in range(24):
        yaw, away = rng.uniform(0, 2 * np.pi), rng.uniform(*HAND_AWAY)
        azimuth = towards + rng.uniform(0.35, 1.65) * np.pi
        turn = Rotation.from_euler("z", yaw)
        place = center[:2] + away * np.array([np.cos(azimuth), np.sin(azimuth)])
        moved = []
        for mesh in meshes:
            vertices = turn.apply(mesh.vertices - np.array([*middle, 0.0])) + np.array([*place, 0.0])
            moved.append(replace(mesh, vertices=vertices))
        if all(tree.query(mesh.vertices[::5])[0].min() > CLEAR for mesh in moved):
            return moved
    return []


def _seated(center: np.ndarray, towards: float, tone: Color, rng: np.random.Generator) -> list[PaintedMesh]:
    """A person behind the grasp, as the camera sees it, who looks at it."""
    azimuth = towards + np.pi + rng.uniform(-0.8, 0.8)
    away = rng.uniform(*PERSON_AWAY)
    place = [
        *(center[:2] + away * np.array([np.cos(azimuth), np.sin(azimuth)])),
        rng.uniform(*HEAD_HEIGHT),
    ]
    yaw = azimuth + np.pi + rng.normal() * 0.4
    turn = Rotation.from_euler("ZYX", [yaw, rng.uniform(-0.1, 0.4), rng.normal() * 0.1])
    pose = np.array([*place, *turn.as_quat(scalar_first=True)])
    return [mesh.moved(pose) for mesh in painted_person(tone, rng)]
