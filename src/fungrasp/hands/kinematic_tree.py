"""The kinematic tree of a model and its linear couplings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np


def body_name(model: mujoco.MjModel, body: int | np.integer) -> str:
    """Return the name of a body; "body 7" if it has none."""
    return model.body(int(body)).name or f"body {body}"


def joint_name(model: mujoco.MjModel, joint: int | np.integer) -> str:
    """Return the name of a joint; "joint 7" if it has none."""
    return model.joint(int(joint)).name or f"joint {joint}"


def carrier_of(model: mujoco.MjModel, name: str) -> int:
    """Return the id of the body that a site is on; if there is no such site, of the body of that name."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    return int(model.site_bodyid[site]) if site >= 0 else int(model.body(name).id)


def place_of(data: mujoco.MjData, name: str) -> np.ndarray:
    """Return the position of a site or, if there is none, of that body, world frame [m], shape [3]."""
    site = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_SITE, name)
    return (data.site_xpos[site] if site >= 0 else data.body(name).xpos).copy()


def ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the body and its ancestors, from the body upwards, without the world."""
    chain = []
    while body:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain


def subtree(model: mujoco.MjModel, root: int) -> list[int]:
    """Return the body and its descendants in model order."""
    inside = {root}
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return sorted(inside)


class Drive(NamedTuple):
    """Linear coupling ``joint = constant + slope * driver``."""

    driver: int
    """Id of the driving joint."""
    constant: float
    """Position of the driven joint if the driver is at zero [rad]."""
    slope: float
    """Ratio of the driven joint's motion to the driver's."""


def drives(model: mujoco.MjModel) -> dict[int, Drive]:
    """Return the linear part of each joint equality between two joints, by the id of the driven joint."""
    return {
        int(model.eq_obj1id[e]): Drive(int(model.eq_obj2id[e]), *map(float, model.eq_data[e, :2]))
        for e in range(model.neq)
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0
    }


def coupling_matrix(count: int, driven: Mapping[int, Drive]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return matrix, shape [M, U], and offset [rad], shape [M], with ``joints = matrix @ independent +
    offset``, and the ids of the independent joints in model order, shape [U].

    Args:
        count: M, the number of joints.
        driven: couplings by driven joint; all other joints are independent.

    Raises:
        ValueError: joints drive each other in a loop.
    """
    free = np.array([joint for joint in range(count) if joint not in driven], dtype=int)
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
    return matrix, offset, free


def independent_limits(
    matrix: np.ndarray, offset: np.ndarray, limits: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return limits of the independent joints within which all joints keep theirs, shape [U] each."""
    lower = np.full(matrix.shape[1], -np.inf)
    upper = np.full(matrix.shape[1], np.inf)
    for row, shift, (low, high) in zip(matrix, offset, limits, strict=True):
        for u in np.flatnonzero(row):
            bounds = sorted(((low - shift) / row[u], (high - shift) / row[u]))
            lower[u], upper[u] = max(lower[u], bounds[0]), min(upper[u], bounds[1])
    return lower, upper


def coupled_positions(model: mujoco.MjModel, positions: np.ndarray) -> np.ndarray:
    """Return joint positions [rad], shape [nq], with driven joints computed from their drivers by the whole
    polynomial of the equality."""
    positions = positions.copy()
    driven = [
        e for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0
    ]
    # The longest possible chain of couplings has as many links.
    for _ in driven:
        for e in driven:
            driver = positions[model.jnt_qposadr[model.eq_obj2id[e]]]
            positions[model.jnt_qposadr[model.eq_obj1id[e]]] = np.polynomial.polynomial.polyval(
                driver, model.eq_data[e, :5]
            )
    return positions
