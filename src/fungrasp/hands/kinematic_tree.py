"""Walking the kinematic tree of a model; its linear couplings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np


def body_name(model: mujoco.MjModel, body: int | np.integer) -> str:
    """Name of a body; "body 7" if it has none."""
    return model.body(int(body)).name or f"body {body}"


def joint_name(model: mujoco.MjModel, joint: int | np.integer) -> str:
    """Name of a joint; "joint 7" if it has none."""
    return model.joint(int(joint)).name or f"joint {joint}"


def carrier_of(model: mujoco.MjModel, name: str) -> int:
    """Id of the body that a site is on; of the body of that name if there is no such site."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    return int(model.site_bodyid[site]) if site >= 0 else int(model.body(name).id)


def place_of(data: mujoco.MjData, name: str) -> np.ndarray:
    """Where a site is, or the body of that name if there is no such site, world frame [m], shape [3]."""
    site = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_SITE, name)
    return (data.site_xpos[site] if site >= 0 else data.body(name).xpos).copy()


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


class Drive(NamedTuple):
    """``joint = constant + slope * driver``."""

    driver: int
    """Id of the joint that drives."""
    constant: float
    """Position where the driver is at zero [rad]."""
    slope: float
    """Change per change of the driver."""


def drives(model: mujoco.MjModel) -> dict[int, Drive]:
    """What drives each joint that a joint equality ties to another one: the equality's linear part."""
    return {
        int(model.eq_obj1id[e]): Drive(int(model.eq_obj2id[e]), *map(float, model.eq_data[e, :2]))
        for e in range(model.neq)
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0
    }


def coupling_matrix(count: int, driven: Mapping[int, Drive]) -> tuple[np.ndarray, np.ndarray]:
    """``joints = matrix @ independent + offset`` of ``count`` joints [rad]; matrix: shape [M, U], offset:
    shape [M]. The U independent joints are those not driven, in model order.

    Raises:
        ValueError: joints drive each other in a loop.
    """
    free = [joint for joint in range(count) if joint not in driven]
    matrix, offset = np.zeros((count, len(free))), np.zeros(count)
    matrix[free, range(len(free))] = 1.0
    pending = dict(driven)
    while pending:
        ready = [joint for joint, drive in pending.items() if drive.driver not in pending]
        if not ready:
            raise ValueError("the couplings form a loop")
        for joint in ready:
            driver, constant, slope = pending.pop(joint)
            matrix[joint] = slope * matrix[driver]
            offset[joint] = constant + slope * offset[driver]
    return matrix, offset


def coupled_positions(model: mujoco.MjModel, positions: np.ndarray) -> np.ndarray:
    """Joint positions with the driven joints set from their drivers, shape [nq]."""
    positions = positions.copy()
    driven = [
        e for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0
    ]
    # As often as the longest possible chain of couplings.
    for _ in driven:
        for e in driven:
            driver = positions[model.jnt_qposadr[model.eq_obj2id[e]]]
            positions[model.jnt_qposadr[model.eq_obj1id[e]]] = np.polynomial.polynomial.polyval(
                driver, model.eq_data[e, :5]
            )
    return positions
