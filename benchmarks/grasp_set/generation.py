"""The grasps of the set: one part of the work for each object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.grasp_set.objects import SetObject
from benchmarks.grasp_set.specifications import set_specifications
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, part_key, run_job
from fungrasp.geometry.poses import invert, transform_points
from fungrasp.geometry.signed_distance import project_to_surface
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.optimization.force_closure import closure_residual, primitive_wrenches
from fungrasp.optimization.problem import CollisionScene
from fungrasp.simulation.scene import NOMINAL_FRICTION
from fungrasp.synthesis import GraspSpecification, SynthesisSettings, synthesize_grasps

SETTINGS = SynthesisSettings(starts=3)
"""As ``fungrasp grasps make`` solves grasps of any mesh."""

LARGEST_RESIDUAL = 0.25
"""Largest unbalanced part of the contact forces of a plausible grasp [-], with friction of the lift test."""

ENOUGH = 1.5
"""Specifications that are solved at once, for each grasp that is still wanted."""

FAR_JOINTS = np.array([5, *(1 + 4 * finger + k for finger in range(5) for k in (1, 2, 3))])
"""Joint at the far end of each of ``HUMAN_LINKS``; of the palm the middle finger's knuckle."""

FIELDS = (
    "object_name",
    "object_mass",
    "object_pose",
    "object_rest_pose",
    "hand_joints",
    "link_contacts",
    "task",
)
"""Of ``HumanGraspSet`` that are kept."""


@dataclass(frozen=True, eq=False)
class Generation(Job[int]):
    """Grasps to be made of each object; a part is the number of an object."""

    objects: Sequence[SetObject]
    """As they were read from their meshes."""
    count: int
    """Largest number of grasps of an object of weight 1."""
    seed: int
    """Of specifications and random starts."""

    @cached_property
    def specifications(self) -> list[list[GraspSpecification]]:
        """Of each object."""
        return [set_specifications(obj, self.seed) for obj in self.objects]

    def parts(self) -> list[int]:
        """Each object."""
        return list(range(len(self.objects)))

    def key(self, part: int) -> str:
        """Digest of object, specifications and seed."""
        obj, specs = self.objects[part], self.specifications[part]
        count = obj.weight * self.count
        return part_key("grasp set", load_hand("human"), obj.model, specs, SETTINGS, count, self.seed)

    def run(self, parts: Sequence[int], progress: Callable[[float], None]) -> list[Arrays]:
        """Fields of each object's grasps; of an object that nobody can hold, no rows."""
        return [self._grasps(part) for part in parts]

    def _grasps(self, part: int) -> Arrays:
        model, waiting = self.objects[part].model, self.specifications[part]
        count, found = self.objects[part].weight * self.count, None
        while waiting and (found is None or len(found) < count):
            wanted = count - (0 if found is None else len(found))
            number = int(np.ceil(ENOUGH * wanted))
            some, waiting = waiting[:number], waiting[number:]
            try:
                more = synthesize_grasps(some, self.seed, SETTINGS, {model.name: model})
            except FungraspError:
                continue
            more = more.select(balance_residuals(more, model) <= LARGEST_RESIDUAL)
            found = more if found is None else HumanGraspSet.concatenate([found, more])
        if found is None:
            return {}
        kept = found.select(slice(0, count))
        return {name: getattr(kept, name) for name in FIELDS}


def made_grasps(
    objects: Sequence[SetObject],
    count: int,
    seed: int,
    store: PartStore | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> HumanGraspSet:
    """Grasps of objects, in their order.

    Args:
        objects: as they were read from their meshes.
        count: largest number of grasps of each of weight 1.
        seed: the same objects and seed give the same grasps.
        store: keeps finished objects, and knows those of an interrupted run.
        progress: called with the share that is done, 0 to 1.

    Raises:
        FungraspError: there are none at all, or a part can't be written.
    """
    found = run_job(Generation(objects, count, seed), store, progress=progress)
    sets: list[HumanGraspSet] = []
    for arrays in found:
        if arrays and len(arrays["object_name"]):
            fields: dict[str, Any] = dict(arrays)
            sets.append(HumanGraspSet(**fields))
    if not sets:
        raise FungraspError("none of the objects can be held")
    return HumanGraspSet.concatenate(sets)


def balance_residuals(grasps: HumanGraspSet, model: ObjectModel) -> np.ndarray:
    """Unbalanced part of contact forces of the touching links that sum to one [-], shape [N]: zero where they
    oppose each other (``closure_residual``).

    Args:
        grasps: N grasps of one object.
        model: the object.
    """
    count = len(grasps)
    scene = CollisionScene.settled([model.name] * count, grasps.object_rest_pose, {model.name: model})
    joints = transform_points(invert(grasps.object_pose), grasps.hand_joints)
    surface, normals = project_to_surface(scene.bank, scene.grid, joints)
    length = 0.5 * float(np.linalg.norm(model.size))
    residuals = np.ones(count)
    for row in range(count):
        touching = FAR_JOINTS[grasps.link_contacts[row]]
        points = surface[row, touching] - model.center_of_mass
        residuals[row] = closure_residual(
            primitive_wrenches(points, -normals[row, touching], length, NOMINAL_FRICTION)
        )
    return residuals
