"""Captures for the verdict: YCB or built-in objects in their grasps, and small shapes in a pinch; objects
are in one of two parts, so that nothing that was fitted decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.perception.capture_files import TRUTH_FILE, write_capture
from benchmarks.perception.scene_additions import varied_settings
from benchmarks.synthetic_captures.render_capture import capture_at, render_capture
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import HumanGrasp, HumanGraspSet, builtin_grasps, load_objects
from fungrasp.objects import ObjectModel, builtin_object, mirrored_name, mirrored_object, plain_shape
from fungrasp.perception.scene.table import put_down

PARTS = ("fit", "kept")
"""Every second object, by name, is in the first, the others in the second."""

ORDER = "gbgsgbgsgb"
"""Kinds of the captures in turn: of the grasps given, built-in, small shapes."""

PINCH = (0.015, 0.085)
"""Widths of small shapes that are held between thumb and two fingers [m]."""

OTHER_SIDES = (0.018, 0.09)
"""Range of a small shape's other sides [m]."""

THUMB_TIP, FINGERTIPS = 20, [4, 8]
"""Joints: of the thumb, and of index and middle finger."""

SKIN = 0.007
"""From a joint of a fingertip to its skin [m]."""


class VerdictCaptures:
    """Renders captures one by one; each is the same whatever others are rendered."""

    def __init__(self, given: HumanGraspSet, meshes: Path | None, part: str, seed: int):
        """
        Args:
            given: grasps beside the built-in ones.
            meshes: folder of their objects' meshes.
            part: one of ``PARTS``.
            seed: decides the captures.
        """
        self.seed, self._part = seed, PARTS.index(part)
        objects = load_objects(given, meshes)
        self._given = self._mine(given), objects
        every = builtin_grasps()
        names = np.unique(every.object_name).tolist()
        self._builtin = self._mine(every), {name: builtin_object(name) for name in names}

    def _mine(self, grasps: HumanGraspSet) -> HumanGraspSet:
        names = np.unique(grasps.object_name)[self._part :: len(PARTS)]
        return grasps.select(np.isin(grasps.object_name, names))

    @cached_property
    def _pinches(self) -> HumanGraspSet:
        grasps = self._given[0]
        return grasps.select(
            np.array([PINCH[0] < pinch_width(joints) < PINCH[1] for joints in grasps.hand_joints])
        )

    def write(self, index: int, folder: Path, look: int = 0) -> Path:
        """Render a capture into a folder of its own, unless it is there. look: another look at the same
        scene, see ``render_capture``; of the same name, so it goes elsewhere."""
        place = folder / f"{self.seed}_{index:04d}"
        if (place / TRUTH_FILE).is_file():
            return place
        kind, settings = ORDER[index % len(ORDER)], varied_settings()
        if kind == "s":
            rng = np.random.default_rng([self.seed, index])
            grasps = self._pinches
            grasp, model = small_shape(grasps[int(rng.integers(len(grasps)))], rng)
            known = render_capture(grasp, model, rng, settings, look)
            objects: Mapping[str, ObjectModel] = {model.name: model}
        else:
            grasps, objects = self._given if kind == "g" else self._builtin
            known = capture_at(index, grasps, objects, self.seed, settings, look)
        name = known.grasp.object_name
        model = objects[name] if known.side == "right" else mirrored_object(objects[mirrored_name(name)])
        write_capture(known, place, model)
        return place


def pinch_width(joints: np.ndarray) -> float:
    """Width of what fits between the tips of the thumb and two fingers [m]. joints: shape [21, 3]."""
    return float(np.linalg.norm(joints[FINGERTIPS].mean(axis=0) - joints[THUMB_TIP])) - 2 * SKIN


def small_shape(grasp: HumanGrasp, rng: np.random.Generator) -> tuple[HumanGrasp, ObjectModel]:
    """The grasp with a box, cylinder or sphere between thumb and fingers in place of its object, turned as
    the rest of the hand is least in the way."""
    joints, width = grasp.hand_joints, pinch_width(grasp.hand_joints)
    sides = rng.uniform(*OTHER_SIDES, 2)
    mm = [f"{1000 * side:.0f}" for side in (width, *sides)]
    name = ("box:" + "x".join(mm), f"cylinder:{mm[0]}x{mm[1]}", f"sphere:{mm[0]}")[int(rng.integers(3))]
    model = plain_shape(name, 0.1)
    fingers, thumb = joints[FINGERTIPS].mean(axis=0), joints[THUMB_TIP]
    along = (fingers - thumb) / np.linalg.norm(fingers - thumb)
    facing = Rotation.align_vectors(along[None], np.array([[1.0, 0.0, 0.0]]))[0]
    best, most = grasp.object_pose, -np.inf
    for turn in rng.uniform(0, 2 * np.pi, 16):
        rotation = facing * Rotation.from_euler("x", turn)
        pose = np.concatenate([0.5 * (fingers + thumb), rotation.as_quat(scalar_first=True)])
        beside = inverse_transform_points(pose, joints)
        free = float(_outside(model, beside).min())
        if free > most:
            best, most = pose, free
    grasp = replace(
        grasp,
        object_name=name,
        object_mass=model.mass,
        object_pose=best,
        object_rest_pose=put_down(model, best),
        hand_qpos=None,
    )
    return grasp, model


def _outside(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    """How far points are outside the box round a shape [m], negative inside, shape [P]."""
    return (np.abs(points) - 0.5 * model.size).max(axis=1)
