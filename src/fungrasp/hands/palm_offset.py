"""Palm bodies whose origin lies far from the hand, as where a description counts from a robot's flange."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

FARTHEST = 0.15
"""Distance of a palm's origin from the bases of its fingers that a palm of human size can have [m]; of the
built-in hands, 0.02 to 0.14."""


def palm_offset(model: mujoco.MjModel, palm: str, bases: Sequence[str]) -> np.ndarray:
    """From a palm's origin to the place where it would lie if it were near the hand, palm frame [m], shape
    [3]: on the line to the middle of the fingers' bases, ``FARTHEST`` before it. Zero where it is near.

    Args:
        model: a hand.
        palm: the palm body.
        bases: site or body at the base of each finger but the thumb.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    places = []
    for name in bases:
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
        places.append(data.site_xpos[site] if site >= 0 else data.body(name).xpos)
    away = (np.mean(places, axis=0) - data.body(palm).xpos) @ data.body(palm).xmat.reshape(3, 3)
    distance = float(np.linalg.norm(away))
    return max(0.0, distance - FARTHEST) / max(distance, 1e-9) * away
