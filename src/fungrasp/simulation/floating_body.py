"""MuJoCo's fields of a body that floats freely, from its mass, center of mass and inertia."""

from __future__ import annotations

import mujoco
import numpy as np


def floating_body_fields(
    mass: np.ndarray, center: np.ndarray, inertia: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Fields of I bodies with a free joint, as MuJoCo's compiler derives them.

    A free joint moves the body's origin along the world's axes and turns the body about its own, so that in
    these coordinates ``M^-1`` has the blocks ``1/m - c^ J^-1 c^`` (linear) and ``J^-1`` (angular), with
    ``c^`` the matrix of the cross product with the center of mass. MuJoCo's inverse weights are means of
    their diagonals.

    Args:
        mass: [kg], shape [I].
        center: of mass [m], body frame, shape [I, 3].
        inertia: about it, axes of the body frame [kg m2], shape [I, 3, 3].

    Returns:
        Fields of the body by name, one row each; fields of its six degrees of freedom, shape [I, 6].
    """
    # The axes of eigh are those of a rotation only if their determinant is positive.
    moments, axes = np.linalg.eigh(inertia)
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    turns = np.zeros((len(mass), 4))
    for turn, matrix in zip(turns, axes, strict=True):
        mujoco.mju_mat2Quat(turn, matrix.ravel())
    x, y, z = center.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    lightness = np.linalg.inv(inertia)
    linear = 1.0 / mass - np.trace(cross @ lightness @ cross, axis1=1, axis2=2) / 3
    angular = np.trace(lightness, axis1=1, axis2=2) / 3
    about_origin = inertia - mass[:, None, None] * (cross @ cross)
    diagonal = np.diagonal(about_origin, axis1=1, axis2=2)
    body = {
        "body_mass": mass,
        "body_ipos": center,
        "body_iquat": turns,
        "body_inertia": moments,
        "body_invweight0": np.stack([1.0 / mass, angular], axis=1),
    }
    joint = {
        "dof_invweight0": np.repeat(np.stack([linear, angular], axis=1), 3, axis=1),
        "dof_M0": np.concatenate([np.repeat(mass[:, None], 3, axis=1), diagonal], axis=1),
    }
    return body, joint
