"""How people may hold an object of the set: many specifications, in random order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.grasp_set.objects import SetObject
from fungrasp.synthesis import GraspSpecification
from fungrasp.synthesis.automatic_specifications import automatic_specifications
from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS
from fungrasp.synthesis.grasp_specification import WHOLE, Vector3

TURN, SHIFT = 0.15, 0.005
"""Standard deviations of the random turn of the hand about each axis [rad], and of the place along each
axis [m]."""

OTHER_KINDS = {
    "pinch": ("pinch", "tripod", "prism"),
    "tripod": ("pinch", "tripod", "cover"),
    "disk": ("disk", "prism"),
    "prism": ("prism", "disk", "cover"),
    "fist": ("fist", "wrap"),
}
"""Kinds of grasp that are as likely at the same place."""

WHOLE_TASKS = {"hold": "hand over", "lift": "place"}
"""Tasks of grasps around the whole object, by what ``automatic_specifications`` calls them."""

STRENGTH = {
    "pinch": (6.0, 0.35),
    "tripod": (6.0, 0.35),
    "prism": (12.0, 0.8),
    "disk": (12.0, 0.8),
    "cover": (15.0, 1.5),
}
"""Largest weight [N] and torque about the held place [N m] that people hold for long by their fingertips: a
tenth of the pinch strengths of Mathiowetz et al. (1985), 50 to 100 N, over a lever of some centimeters. Other
kinds close around."""

GRAVITY = 9.81
"""[m/s2]."""

ROUNDS = 3
"""Specifications of an object are tried in so many variations."""


def set_specifications(obj: SetObject, seed: int) -> list[GraspSpecification]:
    """Specifications of plausible grasps, more than are wanted.

    Args:
        obj: the object.
        seed: of kinds, places, directions and order.
    """
    rng = np.random.default_rng([seed, *obj.model.name.encode()])
    usual = _usual(obj)
    varied = [_varied(spec, obj, rng) for _ in range(ROUNDS) for spec in usual]
    order = rng.permutation(len(varied))
    return [varied[i] for i in order if _can_hold(varied[i], obj)]


def _usual(obj: SetObject) -> list[GraspSpecification]:
    """Those of a built-in object at its size; of others those that are found, with the tasks of parts."""
    if obj.stratum == "builtin":
        return [
            replace(
                spec,
                object=obj.model.name,
                at=_vector(obj.scale * np.array(spec.at)),
                places={link: _vector(obj.scale * np.array(p)) for link, p in spec.places.items()},
            )
            for spec in BUILTIN_SPECIFICATIONS
            if spec.object == obj.family
        ]
    found = automatic_specifications(obj.model, obj.up)
    named = [spec for spec in found if spec.part == WHOLE or spec.part in obj.tasks or not obj.tasks]
    return [replace(spec, task=_task(spec, obj)) for spec in named]


def _task(spec: GraspSpecification, obj: SetObject) -> str:
    if spec.part == WHOLE:
        return WHOLE_TASKS.get(spec.task, spec.task)
    return obj.tasks[spec.part]


def _varied(spec: GraspSpecification, obj: SetObject, rng: np.random.Generator) -> GraspSpecification:
    """The same a little elsewhere and otherwise turned, perhaps of another kind."""
    turn = Rotation.from_rotvec(TURN * rng.standard_normal(3))
    at = np.array(spec.at) + SHIFT * rng.standard_normal(3)
    kind = str(rng.choice(OTHER_KINDS.get(spec.kind, (spec.kind,))))
    # What the specification says of single links belongs to its kind.
    kept = spec.parts or spec.places or spec.contacts or obj.stratum == "builtin"
    return replace(
        spec,
        kind=spec.kind if kept else kind,
        at=_vector(at),
        palm=_vector(turn.apply(spec.palm)),
        fingers=_vector(turn.apply(spec.fingers)),
    )


def _can_hold(spec: GraspSpecification, obj: SetObject) -> bool:
    """Whether people are strong enough for it."""
    weight, torque = STRENGTH.get(spec.kind, (np.inf, np.inf))
    up = np.array(spec.up) / np.linalg.norm(spec.up)
    lever = np.array(spec.at) - obj.model.center_of_mass
    load = GRAVITY * obj.model.mass
    return bool(load <= weight and load * np.linalg.norm(np.cross(lever, up)) <= torque)


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
