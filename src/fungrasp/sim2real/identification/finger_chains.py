"""Which joints of a hand move one another, and where in its finger each is."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.hands import Hand

SMALLEST_SHARE = 0.2
"""A motion that must be made smaller than this share of itself so that the hand doesn't touch itself shows
nothing."""


def chain_of(hand: Hand, joints: Sequence[str]) -> np.ndarray:
    """Number of the chain from the palm that each joint belongs to, shape [J]: with the palm held still, no
    joint moves those of another chain."""
    model, roots = hand.model, []
    palm = model.body(hand.palm).id
    for joint in joints:
        body = int(model.jnt_bodyid[model.joint(joint).id])
        while model.body_parentid[body] not in (palm, 0):
            body = int(model.body_parentid[body])
        roots.append(body)
    return np.unique(roots, return_inverse=True)[1]


def place_in_finger(hand: Hand, joints: Sequence[str]) -> np.ndarray:
    """Number of each joint among those of its chain, from the palm, shape [J]. Where joints with one place
    move alike, fingers stay side by side."""
    finger = chain_of(hand, joints)
    return np.array([np.sum(finger[:j] == finger[j]) for j in range(len(joints))])


def clear_of_itself(hand: Hand, commands: np.ndarray) -> np.ndarray:
    """Commands, made smaller about the first so far that the hand doesn't touch itself: shape [T, U].

    Raises:
        FungraspError: it touches itself in every motion about its first place.
    """
    model, share = hand.model, 1.0
    data = mujoco.MjData(model)
    first = hand.all_joints(commands[0])
    touching = _contacts(model, data, first)
    while share >= SMALLEST_SHARE:
        smaller = commands[0] + share * (commands - commands[0])
        joints = hand.all_joints(smaller[::5])
        if all(_contacts(model, data, row) <= touching for row in joints):
            return smaller
        share *= 0.85
    raise FungraspError(
        f"hand '{hand.name}' touches itself wherever its joints move from this place: put it into a half "
        "open posture first"
    )


def _contacts(model: mujoco.MjModel, data: mujoco.MjData, joints: np.ndarray) -> set[tuple[int, int]]:
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    return {(int(c.geom1), int(c.geom2)) for c in data.contact if c.dist < 0.0}
