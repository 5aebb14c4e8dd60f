"""Objects in a mirror, as a left hand meets what a right hand's grasp was made for."""

from __future__ import annotations

import numpy as np

from fungrasp.objects.object_model import ObjectModel

MIRRORED = "_mirrored"
"""At the end of the name of an object that is the mirror image of another."""


def mirrored_name(name: str) -> str:
    """``mug`` to ``mug_mirrored`` and back."""
    return name.removesuffix(MIRRORED) if name.endswith(MIRRORED) else name + MIRRORED


def mirrored_object(model: ObjectModel) -> ObjectModel:
    """The object reflected in the plane y = 0 of its frame, where it keeps its mass and its parts.

    Convex pieces and the signed distance are reflections too, so that they are exactly alike.
    """
    return ObjectModel(
        mirrored_name(model.name),
        model.mass,
        model.vertices * np.array([1.0, -1.0, 1.0]),
        model.faces[:, ::-1].copy(),
        parts=model.parts,
        repairs=model.repairs,
        source=model.source,
        mirror_image=model,
    )
