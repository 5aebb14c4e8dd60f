"""Walking the kinematic tree of a model."""

from __future__ import annotations

import mujoco
import numpy as np


def body_name(model: mujoco.MjModel, body: int | np.integer) -> str:
    """Name of a body; "body 7" if it has none."""
    return model.body(int(body)).name or f"body {body}"


def joint_name(model: mujoco.MjModel, joint: int | np.integer) -> str:
    """Name of a joint; "joint 7" if it has none."""
    return model.joint(int(joint)).name or f"joint {joint}"


def ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """The body, its parent, and so on up to and without the world."""
    chain = []
    while body:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def subtree(model: mujoco.MjModel, root: int) -> list[int]:
    """The body and all that hang on it, in model order."""
    inside = {root}
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return sorted(inside)


def driven_joints(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Joint equalities between two joints, by the joint they drive: joint id to equality ids."""
    driven: dict[int, list[int]] = {}
    for e in range(model.neq):
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0:
            driven.setdefault(int(model.eq_obj1id[e]), []).append(e)
    return driven


def coupled_positions(model: mujoco.MjModel, positions: np.ndarray) -> np.ndarray:
    """Joint positions with the driven joints set from their drivers, shape [nq]."""
    positions = positions.copy()
    driven = driven_joints(model)
    # As often as the longest possible chain of couplings.
    for _ in range(len(driven)):
        for joint, (e, *_) in driven.items():
            driver = positions[model.jnt_qposadr[model.eq_obj2id[e]]]
            positions[model.jnt_qposadr[joint]] = np.polynomial.polynomial.polyval(
                driver, model.eq_data[e, :5]
            )
    return positions
