"""Many human grasps of objects of many shapes and sizes, from which to learn how people hold things.

The built-in objects and their specifications in other sizes, and boxes, cylinders and spheres with automatic
ones. Each good candidate is taken, not only the best of a specification: people don't take the best either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGraspSet
from fungrasp.objects import (
    ObjectModel,
    builtin_object,
    is_plain_shape,
    plain_shape,
    scaled_name,
    scaled_object,
)
from fungrasp.synthesis.automatic_specifications import automatic_specifications
from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS
from fungrasp.synthesis.grasp_specification import GraspSpecification, Vector3
from fungrasp.synthesis.synthesize import BATCH_SIZE, SynthesisSettings, synthesize_candidates

SIZES = (0.75, 1.3)
"""Range of factors on the sizes of built-in objects: also what hands of other sizes make of them."""

SHAPES_PART = 0.4
"""Part of the specifications that are of boxes, cylinders and spheres."""

SHAPE_SIZES = {"box": (18.0, 120.0), "cylinder": (15.0, 95.0), "sphere": (25.0, 100.0)}
"""Range of the widths and diameters of shapes [mm]."""

SHAPE_HEIGHTS = (25.0, 240.0)
"""Range of the heights of boxes and cylinders [mm]."""

VARIED = SynthesisSettings(starts=4, shift=0.010, turn=0.2)
"""Starts that differ more than those of the built-in grasps."""

SHAPE_MASS = 0.3
"""Of shapes [kg]; it hardly matters for how they are held."""


def varied_grasps(
    seed: int, number: int, held_out: Sequence[str] = (), settings: SynthesisSettings = VARIED
) -> HumanGraspSet | None:
    """A batch of grasps of a dozen specifications; their objects are found by ``varied_object``.

    Args:
        seed: of all batches.
        number: of this one, from 0; the same seed and number give the same grasps.
        held_out: names of built-in objects that are left out.
        settings: of the synthesis.

    Returns:
        The grasps; None if none of the specifications could be met.
    """
    builtin = [spec for spec in BUILTIN_SPECIFICATIONS if spec.object not in held_out]
    rng = np.random.default_rng([seed, number])
    specs: list[GraspSpecification] = []
    models: dict[str, ObjectModel] = {}
    while len(specs) < BATCH_SIZE:
        more, model = _shape(rng) if rng.random() < SHAPES_PART else _other_size(builtin, rng)
        specs += more
        models[model.name] = model
    found = synthesize_candidates(specs, int(rng.integers(2**31)), settings, models)
    rows = np.flatnonzero(found.good(settings.max_penetration, settings.max_cost))
    if not len(rows):
        return None
    chosen = [specs[i] for i in found.specification[rows].tolist()]
    pose = np.array([spec.rest_pose(models[spec.object]) for spec in chosen])
    return HumanGraspSet(
        object_name=np.array([spec.object for spec in chosen]),
        object_mass=np.array([models[spec.object].mass for spec in chosen]),
        object_pose=pose,
        object_rest_pose=pose,
        hand_joints=transform_points(pose, found.joints[rows]),
        link_contacts=found.contacts[rows],
        task=np.array([spec.task for spec in chosen]),
    )


def varied_object(name: str) -> ObjectModel:
    """The object of such a grasp: "mug", "mug x0.9" or "box:60x28x30"."""
    if is_plain_shape(name):
        return plain_shape(name, SHAPE_MASS)
    base, _, factor = name.partition(" x")
    return scaled_object(builtin_object(base), float(factor or 1.0))


def _other_size(
    specs: Sequence[GraspSpecification], rng: np.random.Generator
) -> tuple[list[GraspSpecification], ObjectModel]:
    """One specification of a built-in object, both in another size."""
    spec = specs[int(rng.integers(len(specs)))]
    factor = round(float(np.exp(rng.uniform(*np.log(SIZES)))), 2)

    def larger(place: Vector3) -> Vector3:
        return (factor * place[0], factor * place[1], factor * place[2])

    model = scaled_object(builtin_object(spec.object), factor)
    places = {link: larger(place) for link, place in spec.places.items()}
    spec = replace(spec, object=scaled_name(spec.object, factor), at=larger(spec.at), places=places)
    return [spec], model


def _shape(rng: np.random.Generator) -> tuple[list[GraspSpecification], ObjectModel]:
    """Up to three specifications of a box, cylinder or sphere."""
    while True:
        kind = ("box", "cylinder", "sphere")[rng.choice(3, p=(0.5, 0.35, 0.15))]
        widths = np.exp(rng.uniform(*np.log(SHAPE_SIZES[kind]), size=2 if kind == "box" else 1))
        height = np.exp(rng.uniform(*np.log(SHAPE_HEIGHTS), size=int(kind != "sphere")))
        sizes = "x".join(f"{size:.0f}" for size in (*widths, *height))
        model = plain_shape(f"{kind}:{sizes}", SHAPE_MASS)
        specs = automatic_specifications(model)
        if specs:
            return [specs[i] for i in rng.permutation(len(specs))[:3]], model
