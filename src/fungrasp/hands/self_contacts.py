"""Which links of a hand penetrate each other, and whether their shapes or their poses are the reason."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.hands.checking.kinematic_tree import body_name, coupled_positions

DEEP = 0.002
"""Penetration that is named [m]."""

POSES = 200
"""Random poses in which shapes are tried."""

BY_SHAPE = 0.25
"""Links that penetrate in this share of all poses do so because of their shapes."""


@dataclass(frozen=True)
class SelfContact:
    """Two links that penetrate each other in some of a number of poses."""

    first: str
    """Name of a body."""
    second: str
    """Name of a body."""
    depth: float
    """Of the deepest penetration [m]."""
    share: float
    """Share of the poses in which they penetrate each other."""


def self_contacts(
    model: mujoco.MjModel, joint_positions: np.ndarray, depth: float = DEEP
) -> list[SelfContact]:
    """Pairs of links that penetrate each other, most frequent first.

    Args:
        model: a bare hand's.
        joint_positions: [rad], shape [N, M].
        depth: contacts less deep don't count [m].
    """
    data = mujoco.MjData(model)
    found: dict[tuple[str, str], list[float]] = {}
    for positions in joint_positions:
        data.qpos[:] = positions
        mujoco.mj_fwdPosition(model, data)
        deepest: dict[tuple[str, str], float] = {}
        for contact in data.contact:
            first, second = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
            if -contact.dist > depth:
                pair = body_name(model, first), body_name(model, second)
                deepest[pair] = max(deepest.get(pair, 0.0), -float(contact.dist))
        for pair, value in deepest.items():
            found.setdefault(pair, []).append(value)
    contacts = [
        SelfContact(*pair, max(depths), len(depths) / len(joint_positions)) for pair, depths in found.items()
    ]
    return sorted(contacts, key=lambda contact: (-contact.share, contact.first, contact.second))


def zero_and_random_poses(model: mujoco.MjModel) -> np.ndarray:
    """The pose nearest to zero, and ``POSES`` random ones over the joints' whole range, couplings kept [rad],
    shape [1 + POSES, M]. model: with limited joints only."""
    low, high = model.jnt_range.T
    random = np.random.default_rng(0).uniform(low, high, (POSES, model.njnt))
    return np.stack(
        [coupled_positions(model, p) for p in (np.clip(np.zeros(model.njnt), low, high), *random)]
    )


def self_contact_words(model: mujoco.MjModel, joint_positions: np.ndarray) -> list[str]:
    """For each pair of links that penetrate in some grasps: how often, how deep, why, and what to do.

    Args:
        model: a bare hand's.
        joint_positions: of the grasps [rad], shape [N, M].
    """
    contacts = self_contacts(model, joint_positions)
    if not contacts:
        return []
    poses = zero_and_random_poses(model)
    at_zero = {(c.first, c.second) for c in self_contacts(model, poses[:1])}
    anywhere = {(c.first, c.second): c.share for c in self_contacts(model, poses[1:])}
    words = []
    for contact in contacts:
        pair = contact.first, contact.second
        share = anywhere.get(pair, 0.0)
        if pair in at_zero:
            reason = "their shapes do so at the zero pose already: " + _remedy(*pair)
        elif share > BY_SHAPE:
            reason = f"their shapes do so in {100 * share:.0f} % of all poses: " + _remedy(*pair)
        else:
            often = f"the shapes allow it in {100 * share:.0f} % of all poses"
            reason = f"{often}: the pose of the grasp is the reason"
        words.append(
            f"'{pair[0]}' and '{pair[1]}' penetrate each other by up to {1e3 * contact.depth:.1f} mm in "
            f"{100 * contact.share:.0f} % of the grasps; {reason}"
        )
    return words


def _remedy(first: str, second: str) -> str:
    return (
        f'shrink them, or if the links don\'t touch in truth, write <contact><exclude body1="{first}" '
        f'body2="{second}"/></contact> into the model'
    )
