"""A hand's model with what it looks like: shells of our own for built-in hands, other hands' own meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.hand_registry import hand_files
from fungrasp.media.hand_shells.frames import HandFrames, Shell

DRESSED = ("allegro", "faive", "inspire", "leap", "shadow")
"""Hands whose shells are made here; each has a module of its name."""

COLLISION_GROUP = 3
"""Geom group of what is not drawn, by MuJoCo's convention."""

SHELL = "shell"
"""Names of the shells begin with this."""


def dressed_spec(hand: Hand) -> mujoco.MjSpec:
    """``hand.spec()`` in which what collides is hidden where there is something that looks like the hand.

    A hand that is not built in, and has no visual meshes, is shown by its collision shapes.
    """
    spec = hand.spec()
    shells = _shells(hand)
    if not shells:
        return spec
    for geom in spec.geoms:
        geom.group = COLLISION_GROUP
    materials: dict[tuple[float, ...], str] = {}
    for number, shell in enumerate(shells):
        color, specular, shininess = shell.look
        name = f"{SHELL}{number}"
        mesh = spec.add_mesh(name=name)
        mesh.uservert = np.ascontiguousarray(shell.solid.vertices).ravel()
        mesh.userface = np.ascontiguousarray(shell.solid.faces, dtype=np.int32).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        key = (*color, specular, shininess)
        if key not in materials:
            materials[key] = f"{SHELL} look {len(materials)}"
            spec.add_material(name=materials[key], rgba=[*color, 1.0], specular=specular, shininess=shininess)
        spec.body(shell.body).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=materials[key],
            rgba=[0.5, 0.5, 0.5, 1.0],
            contype=0,
            conaffinity=0,
            mass=0.0,
            group=1,
        )
    return spec


def dressed_model(hand: Hand) -> mujoco.MjModel:
    """``dressed_spec``, compiled; do not change it. Joints and bodies are those of ``hand.model``."""
    return _compiled(str(hand.path), hand.digest, _Keyed(hand))


def _shells(hand: Hand) -> list[Shell]:
    """Parts of a built-in hand; none for others."""
    known = {Path(path).resolve(): name for name, path in hand_files().items() if name in DRESSED}
    name = known.get(Path(hand.path).resolve())
    if name is None:
        return []
    module = import_module(f"fungrasp.media.hand_shells.{name}")
    make: Callable[[HandFrames], list[Shell]] = getattr(module, f"{name}_shells")
    return make(HandFrames(hand))


class _Keyed:
    """A hand that does not count in a cache's key."""

    def __init__(self, hand: Hand):
        self.hand = hand

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Keyed)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=16)
def _compiled(path: str, digest: str, hand: _Keyed) -> mujoco.MjModel:
    return dressed_spec(hand.hand).compile()
