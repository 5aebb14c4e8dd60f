"""Samples written into the worlds of a scene."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.simulation import Worlds
from fungrasp.simulation.scene import HAND_PREFIX
from fungrasp.transfer.randomization import Sample

_SAMEFRAME_NONE = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


def apply(sample: Sample, worlds: Worlds, ids: np.ndarray) -> None:
    """Give some worlds the joints, servos, wrist and table that were drawn for them.

    Values are the scene's times the factors, whatever was applied before. State, mass and friction stay as
    they are (``Worlds.assign`` takes ``sample.mass`` times the object's own mass, and ``sample.friction``),
    and so does the height of the object: it should be put down on the new table.

    Args:
        sample: one row for each of these worlds.
        worlds: any.
        ids: world ids, shape [I].

    Raises:
        FungraspError: the sample is of another number of worlds or joints.
    """
    scene, model = worlds.scene, worlds.model
    hand = scene.hand
    if len(sample) != len(ids):
        raise FungraspError(f"a sample of {len(sample)} trials can't be applied to {len(ids)} worlds")
    if sample.damping.shape[1] != len(hand.joint_names):
        raise FungraspError(
            f"the sample was drawn for {sample.damping.shape[1]} joints;"
            f" hand '{hand.name}' has {len(hand.joint_names)}"
        )
    ids = np.asarray(ids)
    joint_dofs = np.array([model.joint(HAND_PREFIX + name).dofadr[0] for name in hand.joint_names])
    _write(worlds, "dof_damping", ids, (joint_dofs,), sample.damping)

    driven = np.array([hand.joint_names.index(name) for name in hand.actuators])
    wrist = np.repeat(sample.wrist_stiffness[:, None], len(scene.wrist_actuators), axis=1)
    actuators = np.concatenate([scene.finger_actuators, scene.wrist_actuators])
    stiffness = np.concatenate([sample.stiffness[:, driven], wrist], axis=1)
    damping = np.concatenate([sample.servo_damping[:, driven], wrist], axis=1)
    # A position servo pulls with gain[0] * ctrl + bias[1] * angle + bias[2] * velocity.
    _write(worlds, "actuator_gainprm", ids, (actuators, 0), stiffness)
    _write(worlds, "actuator_biasprm", ids, (actuators, 1), stiffness)
    _write(worlds, "actuator_biasprm", ids, (actuators, 2), damping)

    move_table(worlds, sample.table_height, ids)


def move_table(worlds: Worlds, height: float | np.ndarray, ids: np.ndarray | None = None) -> None:
    """Put the table's top at another height; what stands on it stays where it is.

    Args:
        worlds: any.
        height: [m], one for all or shape [I].
        ids: world ids, shape [I]; all if None.
    """
    model, which = worlds.model, slice(None) if ids is None else ids
    table = model.geom("table").id
    worlds.batch.expand("geom_pos")[which, table, 2] = model.geom_pos[table, 2] + height
    # MuJoCo skips the position of a geom that the compiler found at its body's origin.
    worlds.batch.expand("geom_sameframe")[which, table] = _SAMEFRAME_NONE


def pushes(
    force: np.ndarray, start: float | np.ndarray, duration: float | np.ndarray, now: np.ndarray
) -> np.ndarray:
    """Forces on the objects at a moment [N], world frame, shape [W, 3]: zero but while a push lasts.

    Args:
        force: of the push [N], world frame, shape [W, 3].
        start: of the push [s], one for all or shape [W].
        duration: of the push [s], one for all or shape [W].
        now: [s], on the clock of ``start``; not finite where that clock has not started, shape [W].
    """
    since = now - start
    active = np.isfinite(now) & (since >= -1e-9) & (since < duration - 1e-9)
    return np.where(active[:, None], force, 0.0)


def push_objects(worlds: Worlds, force: np.ndarray, ids: np.ndarray | None = None) -> None:
    """Pull at the objects' centres of mass, until told otherwise or reset.

    Args:
        worlds: any.
        force: [N], world frame, shape [I, 3].
        ids: world ids, shape [I]; all if None.
    """
    body = worlds.model.body("object").id
    worlds.batch.bind("xfrc_applied")[slice(None) if ids is None else ids, body, :3] = force


def _write(
    worlds: Worlds,
    name: str,
    ids: np.ndarray,
    index: tuple[np.ndarray] | tuple[np.ndarray, int],
    factor: np.ndarray,
) -> None:
    """Set entries of a model field of some worlds to the scene's values times factors [I, ...]."""
    nominal = getattr(worlds.model, name)[index]
    worlds.batch.expand(name)[(ids[:, None], *index)] = nominal * factor
