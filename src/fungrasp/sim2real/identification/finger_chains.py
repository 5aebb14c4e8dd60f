"""Which joints of a hand move one another, and where in its finger each is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.hands import Hand


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
