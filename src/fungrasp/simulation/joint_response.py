"""How the bare hand moves when its joints are commanded: many copies with different dynamics at once."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from mujoco import rollout

STEP = 0.002
"""Of the integration [s]."""


def joint_response(
    model: mujoco.MjModel,
    changes: Sequence[Callable[[mujoco.MjModel], None]],
    start: np.ndarray,
    controls: np.ndarray,
    every: int = 1,
) -> np.ndarray:
    """Positions of all joints, shape [W, S // every, M].

    Args:
        model: a hand with position servos, its palm fixed.
        changes: made to each world's copy of the model, length W.
        start: positions of all joints [rad], shape [M] or, one for each world, [W, M]; at rest.
        controls: of the servos at each step of the model [rad], shape [W, S, U].
        every: positions are returned every so many steps, the first after so many.
    """
    models = []
    for change in changes:
        world = copy.copy(model)
        change(world)
        models.append(world)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    data = mujoco.MjData(model)
    begin = np.zeros((len(models), mujoco.mj_stateSize(model, kind)))
    for world, positions in enumerate(np.broadcast_to(start, (len(models), model.nq))):
        data.qpos[:] = positions
        mujoco.mj_getState(model, data, begin[world], kind)
    threads = [mujoco.MjData(model) for _ in range(min(len(models), os.cpu_count() or 1))]
    states, _ = rollout.rollout(models, threads, begin, controls)
    # Full physics begins with the time, then the positions.
    return states[:, every - 1 :: every, 1 : 1 + model.nq]
