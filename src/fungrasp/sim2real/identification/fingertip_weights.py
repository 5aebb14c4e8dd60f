"""Known weights on a hand's fingertips, which tell the scale of its dynamics.

Stiffness, damping, friction and drive inertia of a joint may be scaled together and move it the same, but for
the weight and inertia of what it carries. Where links are light against their drives only a known weight adds
enough: 0.2 kg on a fingertip add half the drive inertia of an Inspire's joint, and 0.15 N m of weight.
"""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands import Hand


def hang_weights(model: mujoco.MjModel, hand: Hand, mass: float) -> None:
    """Fix a point mass to the middle of each fingertip, in place.

    Args:
        model: compiled, of the hand or of a scene with it.
        hand: whose fingertips they are.
        mass: of each [kg].
    """
    for finger in hand.fingers.values():
        body, place = _fingertip(model, finger.tip)
        own, center = float(model.body_mass[body]), model.body_ipos[body].copy()
        both = own + mass
        middle = (own * center + mass * place) / both
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        axes = rotation.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += _about(own, center - middle) + _about(mass, place - middle)
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
        model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = both, middle, moments
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _fingertip(model: mujoco.MjModel, tip: str) -> tuple[int, np.ndarray]:
    """Body and place in its frame [m] of a site or body."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip)
    if site < 0:
        return int(model.body(tip).id), np.zeros(3)
    return int(model.site_bodyid[site]), model.site_pos[site].copy()


def _about(mass: float, offset: np.ndarray) -> np.ndarray:
    """Inertia of a point mass about a place [kg m^2], shape [3, 3]. offset: from there [m], shape [3]."""
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
