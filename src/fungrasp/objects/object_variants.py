"""Scaled and mirrored objects, and objects with a shifted center of mass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from fungrasp.objects.object_model import ObjectModel


def scaled_name(name: str, factor: float) -> str:
    """Return the name of a scaled object; unchanged for a factor of 1."""
    return name if factor == 1.0 else f"{name} x{factor:g}"


def scaled_object(model: ObjectModel, factor: float) -> ObjectModel:
    """Scale an object by a factor, with the same mass.

    Args:
        factor: factor on the size, positive.
    """
    if factor == 1.0:
        return model
    return replace(
        model,
        name=scaled_name(model.name, factor),
        vertices=factor * model.vertices,
        construction=(),
        mirror_image=None,
        scaled_from=(model, factor),
    )


def with_sizes(objects: Mapping[str, ObjectModel], factors: Iterable[float]) -> dict[str, ObjectModel]:
    """Return scaled versions of each object, by ``scaled_name``.

    Args:
        factors: factors on the size; 1 is always included.
    """
    return {
        scaled_name(name, factor): scaled_object(model, factor)
        for factor in (1.0, *(f for f in factors if f != 1.0))
        for name, model in objects.items()
    }


def shifted_mass(
    center: np.ndarray, inertia: np.ndarray, mass: np.ndarray, extents: np.ndarray, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return center of mass and inertia of objects with a shifted center of mass.

    A fraction w of the mass m is removed uniformly and concentrated at one point, at d / w from the center in
    the direction of the shift d. w is the largest ratio of d to half the extent along an axis, so that the
    point is on the object's bounding box. About the new center,
    ``J = (1 - w) J0 + m (1 - w) / w (|d|^2 E - d d^T)``. This is always physically valid, and unchanged
    without a shift.

    Args:
        center: center of mass [m], object frame, shape [I, 3].
        inertia: inertia about it, axes of the object frame [kg m2], shape [I, 3, 3].
        mass: [kg], shape [I].
        extents: along the axes of the object frame [m], shape [I, 3].
        shift: shift of the center as a fraction of the extents, within half of them, shape [I, 3].

    Returns:
        center [m], shape [I, 3]; inertia about it [kg m2], shape [I, 3, 3].
    """
    moved = shift * extents
    share = (2.0 * np.abs(shift)).max(axis=1)
    square = np.sum(moved**2, axis=1)[:, None, None] * np.eye(3) - moved[:, :, None] * moved[:, None, :]
    # Without a shift, the second term is zero for any share.
    weight = mass * (1.0 - share) / np.where(share > 0, share, 1.0)
    return center + moved, (1.0 - share)[:, None, None] * inertia + weight[:, None, None] * square


MIRRORED = "_mirrored"
"""Suffix of the names of mirrored objects."""


def mirrored_name(name: str) -> str:
    """Convert ``mug`` to ``mug_mirrored`` and back."""
    return name.removesuffix(MIRRORED) if name.endswith(MIRRORED) else name + MIRRORED


def mirrored_object(model: ObjectModel) -> ObjectModel:
    """Reflect an object in the plane y = 0 of its frame, with the same mass and parts.

    Convex pieces and signed distances are exact reflections.
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
