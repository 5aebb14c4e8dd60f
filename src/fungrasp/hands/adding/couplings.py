"""Joints that move together: by the file, by the user, by closed loops."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.findings import Finding, listed, note, warning
from fungrasp.hands.kinematic_tree import (
    Drive,
    ancestors,
    body_name,
    coupling_matrix,
    joint_name,
    subtree,
)

LEAST_ROOM = 0.1
"""A coupling that leaves less of its driver's range can't be meant."""

TIGHT_TENDON = 0.05
"""A fixed tendon that lets its joints move by less is a rigid coupling [rad]."""


class GivenCoupling(NamedTuple):
    """``joint = offset + slope * driver``, as the user says it."""

    joint: str
    """Name of the joint that is driven."""
    slope: float
    """Change of the driven joint per change of the driver."""
    driver: str
    """Name of the joint that drives it."""
    offset: float = 0.0
    """Position of the driven joint where the driver is at zero [rad]."""


def from_reference(model: mujoco.MjModel, joint: int, drive: Drive) -> float:
    """The constant of a coupling where positions count from the model's reference pose [rad]."""
    reference = model.qpos0[model.jnt_qposadr]
    return float(drive.constant - reference[joint] + drive.slope * reference[drive.driver])


def find_couplings(
    model: mujoco.MjModel, findings: list[Finding], given: Sequence[GivenCoupling] = ()
) -> dict[int, Drive]:
    """All linear couplings of a model by the joint that is driven, no loop among them.

    Args:
        findings: what is left out or assumed is added.
        given: further couplings, that come before the model's.

    Raises:
        FungraspError: a given coupling names a joint that does not exist, or closes a loop.
    """
    found: dict[int, Drive] = {}

    def add(joint: int, driver: int, constant: float, slope: float) -> bool:
        above, steps = driver, 0
        while above in found and steps <= len(found):
            above, steps = found[above].driver, steps + 1
        if joint in found or above == joint:
            return False
        found[joint] = Drive(driver, constant, slope)
        return True

    def tie(joint: int, driver: int, change: float, slope: float) -> bool:
        """MuJoCo couples changes from the reference pose; ``change`` is that of the joint where the driver's
        is zero."""
        reference = model.qpos0[model.jnt_qposadr]
        return add(joint, driver, change + float(reference[joint] - slope * reference[driver]), slope)

    names = {joint_name(model, j): j for j in range(model.njnt)}
    for joint, slope, driver, offset in given:
        for name in (joint, driver):
            if name not in names:
                raise FungraspError(f"--couple: {UnknownNameError('joint', name, names)}")
        if not add(names[joint], names[driver], offset, slope):
            raise FungraspError(f"--couple: '{joint}' is already driven, or drives '{driver}'")
    for e in range(model.neq):
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[e]:
            joint, driver = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            constant, slope, *curve = model.eq_data[e, :5]
            if driver < 0:
                # Held still: it follows any other joint with slope 0.
                driver, slope, curve = next(j for j in range(model.njnt) if j != joint), 0.0, [0.0]
            off = 0.0
            if np.abs(curve).max() > 1e-9:
                reference = model.qpos0[model.jnt_qposadr]
                x = (
                    np.linspace(model.jnt_range[driver, 0], model.jnt_range[driver, 1], 50)
                    - reference[driver]
                )
                y = np.clip(
                    np.polynomial.polynomial.polyval(x, model.eq_data[e, :5]),
                    *(model.jnt_range[joint] - reference[joint]),
                )
                slope, constant = np.polyfit(x, y, 1)
                off = float(np.abs(constant + slope * x - y).max())
            if not tie(joint, driver, float(constant), float(slope)):
                findings.append(
                    warning(
                        f"the coupling of '{joint_name(model, joint)}' to '{joint_name(model, driver)}' "
                        "repeats or contradicts another: ignored"
                    )
                )
            elif off:
                findings.append(
                    warning(
                        f"joint '{joint_name(model, joint)}' follows a curve: replaced by the best line, "
                        f"with an error of up to {off:.2f} rad"
                    )
                )
    for tendon in range(model.ntendon):
        _tendon(model, tendon, tie, add, findings)
    return dict(sorted(found.items()))


def _tendon(
    model: mujoco.MjModel,
    tendon: int,
    tie: Callable[[int, int, float, float], bool],
    add: Callable[[int, int, float, float], bool],
    findings: list[Finding],
) -> None:
    span = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    if not (model.wrap_type[span] == mujoco.mjtWrap.mjWRAP_JOINT).all() or model.tendon_num[tendon] < 2:
        return
    terms = sorted(zip(model.wrap_objid[span].tolist(), model.wrap_prm[span].tolist(), strict=True))
    low, high = model.tendon_range[tendon]
    # A tendon's length is in meters where its coefficients are: in radians of its joints it tells.
    slack = (high - low) / max(abs(factor) for _, factor in terms)
    rigid = len(terms) == 2 and bool(model.tendon_limited[tendon]) and slack < TIGHT_TENDON
    rigid |= len(terms) == 2 and bool(
        np.any((model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & (model.eq_obj1id == tendon))
    )
    name = model.tendon(tendon).name or f"tendon {tendon}"
    if rigid:
        (near, a), (far, b) = terms
        # Where limits leave such a coupling no room, it is read as two joints of one motor.
        if _room(model, far, near, -a / b) > LEAST_ROOM:
            if not tie(far, near, 0.0, -a / b):
                tie(near, far, 0.0, -b / a)
            return
        findings.append(
            warning(
                f"the tendon '{name}' and the limits leave '{joint_name(model, near)}' and "
                f"'{joint_name(model, far)}' nowhere to go"
            )
        )
    of_motor = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == tendon)
    if model.tendon_limited[tendon] and not rigid and not of_motor.any():
        names = listed([joint_name(model, j) for j, _ in terms])
        findings.append(
            warning(
                f"the tendon '{name}' lets {names} move apart, and no motor pulls it: left out; if they "
                "move together, give it with --couple JOINT=OFFSET+SLOPE*DRIVER"
            )
        )
        return
    near, sign = terms[0]
    for far, factor in terms[1:]:
        # The joints of one motor are taken to reach the ends of their ranges together.
        width = np.ptp(model.jnt_range[far]) / max(float(np.ptp(model.jnt_range[near])), 1e-6)
        slope = float(width) if rigid else float(np.sign(sign * factor)) * float(width)
        start = float(model.jnt_range[far, 0] - slope * model.jnt_range[near, 0]) if rigid else 0.0
        if add(far, near, start, slope):
            findings.append(
                note(
                    f"the tendon '{name}' moves '{joint_name(model, near)}' and '{joint_name(model, far)}' "
                    f"together: tied as {slope:.3g} * '{joint_name(model, near)}', so that both reach the "
                    "ends of their ranges at once"
                )
            )


def _room(model: mujoco.MjModel, joint: int, driver: int, slope: float) -> float:
    """Share of a driver's range in which the joint it drives keeps its own."""
    reference = model.qpos0[model.jnt_qposadr]
    ends = np.sort((model.jnt_range[joint] - reference[joint]) / slope + reference[driver])
    low, high = model.jnt_range[driver]
    return float((min(high, ends[1]) - max(low, ends[0])) / max(high - low, 1e-9))


STEPS = 60
"""In which a loop is followed over the range of its driver."""

CLOSED = 1e-3
"""Gap within which a loop is closed [m]."""

LEAST_MOTION = 0.1
"""A loop that lets its driver turn less holds it still [rad]."""

STRAIGHT = 0.15
"""Deviation of a followed joint from its line that is mentioned [rad]."""

TURNING = 0.1
"""Joints that turn by less than this share of the one that turns most don't drive a loop."""

FREE = 1e-2
"""Singular values of a loop's Jacobian smaller than this share of the largest leave a motion free."""


@dataclass(frozen=True)
class Loop:
    """Closing constraint of a loop."""

    equality: int
    """Id in the model."""
    name: str
    """For messages."""
    ends: tuple[int, int]
    """The two bodies that it ties."""
    joints: frozenset[int]
    """Joints between its ends."""


def closed_loops(model: mujoco.MjModel, palm: int) -> list[Loop]:
    """The loops of a hand, those through the palm included."""
    below, loops = set(subtree(model, palm)), []
    for e in range(model.neq):
        kind = int(model.eq_type[e])
        if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD) or not model.eq_active0[e]:
            continue
        ids = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
            ids = int(model.site_bodyid[ids[0]]), int(model.site_bodyid[ids[1]])
        paths = [set(ancestors(model, max(0, body))) for body in ids]
        joints = frozenset(
            j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in (paths[0] ^ paths[1]) & below - {palm}
        )
        if joints:
            between = " - ".join(body_name(model, body) if body > 0 else "world" for body in ids)
            loops.append(Loop(e, model.equality(e).name or between, ids, joints))
    return loops


def solve_loops(
    model: mujoco.MjModel, loops: list[Loop], couplings: dict[int, Drive], findings: list[Finding]
) -> dict[int, Drive]:
    """All couplings, those of the loops included. Limits of the loops' joints in the model become those
    between which the loops stay closed.

    Args:
        couplings: of the model or given; loops that they tie already are left alone.
        findings: what was solved is added.

    Raises:
        FungraspError: a loop leaves more than one motion, or none.
    """
    result = dict(couplings)
    matrix, offset = coupling_matrix(model.njnt, couplings)
    for group in _groups(loops, matrix):
        names = listed([loop.name for loop in group], limit=3)
        joints = sorted(set().union(*(loop.joints for loop in group)))
        moved = np.flatnonzero(np.abs(matrix[joints]).sum(axis=0) > 0)
        if len(moved) < 2:
            continue
        follower = _Follower(model, group, matrix, offset, moved)
        free, motion = follower.motions()
        # The columns' own joints, in the order of ``moved``.
        own = [int(np.argmax(matrix[:, u] == 1.0)) for u in moved]
        if free != 1:
            freedom = "no motion" if free == 0 else f"{free} motions that mix"
            raise FungraspError(
                f"the closed loop {names} leaves its {len(own)} joints {freedom}; a hand's joint follows one "
                "driver or none: tie the joints behind it with --couple JOINT=OFFSET+SLOPE*DRIVER, or give a "
                "model without loops"
            )
        # Of the joints that the motion turns, the one that carries most.
        carried = [len(subtree(model, int(model.jnt_bodyid[j]))) for j in own]
        driver = int(np.argmax(np.where(motion > TURNING * motion.max(), carried, 0)))
        path = follower.follow(driver, model.jnt_range[own[driver]])
        if np.ptp(path[:, driver]) < LEAST_MOTION:
            raise FungraspError(
                f"the closed loop {names} lets '{joint_name(model, own[driver])}' turn by only "
                f"{np.ptp(path[:, driver]):.2f} rad; is it put together right in the file's pose?"
            )
        model.jnt_range[own[driver]] = path[:, driver].min(), path[:, driver].max()
        others = [i for i in range(len(own)) if i != driver]
        curved = []
        for i in others:
            slope, constant = np.polyfit(path[:, driver], path[:, i], 1)
            line = constant + slope * path[:, driver]
            if np.ptp(line) < 1e-3:
                slope, constant = 0.0, float(line.mean())
            off = float(np.abs(line - path[:, i]).max())
            if off > STRAIGHT:
                curved.append(f"{joint_name(model, own[i])} by {off:.2f}")
            result[own[i]] = Drive(own[driver], float(constant), float(slope))
            model.jnt_range[own[i]] = min(line.min(), line.max() - 1e-6) - 1e-6, line.max() + 1e-6
        slopes = [f"{joint_name(model, own[i])} = {result[own[i]].slope:.2f}" for i in others]
        low, high = model.jnt_range[own[driver]]
        findings.append(
            note(
                f"the closed loop {names} was solved into couplings to '{joint_name(model, own[driver])}', "
                f"which turns from {low:.2f} to {high:.2f} rad: {', '.join(slopes[:4])}"
                f"{' and more' if len(slopes) > 4 else ''} times it"
            )
        )
        if curved:
            findings.append(
                warning(
                    f"joints in closed loops follow curves; errors of the lines [rad]: {', '.join(curved)}"
                )
            )
    return result


def _groups(loops: list[Loop], matrix: np.ndarray) -> list[list[Loop]]:
    """Loops that move together."""
    groups: list[tuple[set[int], list[Loop]]] = []
    for loop in loops:
        moved = set(np.flatnonzero(np.abs(matrix[sorted(loop.joints)]).sum(axis=0)).tolist())
        members = [loop]
        for group in [group for group in groups if group[0] & moved]:
            groups.remove(group)
            moved |= group[0]
            members = [*group[1], *members]
        groups.append((moved, members))
    return [members for _, members in groups]


class _Follower:
    """Keeps a group of loops closed."""

    def __init__(
        self,
        model: mujoco.MjModel,
        group: list[Loop],
        matrix: np.ndarray,
        offset: np.ndarray,
        moved: np.ndarray,
    ):
        """moved: the independent joints that the loops hold, columns of the matrix."""
        self._model = copy.copy(model)
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._data = mujoco.MjData(self._model)
        self._data.eq_active[:] = 0
        self._data.eq_active[[loop.equality for loop in group]] = 1
        self._offset, self._columns = offset, matrix[:, moved]
        self._start = np.linalg.pinv(matrix) @ (model.qpos0 - offset)
        self._rest = matrix @ self._start - self._columns @ self._start[moved]
        self._start = self._start[moved]

    def _gap(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is missing to close the loops [m, or m for a turn], and its derivative."""
        data = self._data
        data.qpos[:] = self._rest + self._columns @ position + self._offset
        mujoco.mj_fwdPosition(self._model, data)
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        jacobian = data.efc_J.reshape(data.nefc, self._model.nv)[rows]
        return data.efc_pos[rows].copy(), jacobian @ self._columns

    def close(self, position: np.ndarray, held: int | None = None) -> tuple[np.ndarray, float]:
        """The nearest position with closed loops, one joint held; and the gap that is left [m]."""
        position = position.copy()
        free = np.array([i for i in range(len(position)) if i != held])
        for _ in range(30):
            gap, jacobian = self._gap(position)
            if np.abs(gap).max(initial=0.0) < 1e-7:
                break
            step = np.linalg.lstsq(jacobian[:, free], -gap, rcond=1e-4)[0]
            position[free] += step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-9))
        return position, float(np.abs(self._gap(position)[0]).max(initial=0.0))

    def motions(self) -> tuple[int, np.ndarray]:
        """How many motions the loops leave at a place that is not special, and by how much the last of them
        turns each joint, shape [J]."""
        rng, count, size = np.random.default_rng(0), 0, len(self._start)
        motion = np.zeros(size)
        for spread in (0.0, 0.1, 0.1, 0.1):
            position, gap = self.close(self._start + spread * rng.standard_normal(size))
            if gap < CLOSED:
                _, values, rows = np.linalg.svd(self._gap(position)[1])
                count = max(count, int(np.sum(values > FREE * values[0])))
                motion = np.maximum(motion, np.abs(rows[-1]))
        return size - count, motion

    def follow(self, driver: int, limits: np.ndarray) -> np.ndarray:
        """Positions with closed loops over the range of one joint, as far as they close, shape [P, J]."""
        first, gap = self.close(self._start)
        paths = [first[None]] if gap < CLOSED else [self._start[None]]
        for end in limits:
            position, path = paths[0][0], []
            for value in np.linspace(position[driver], end, STEPS + 1)[1:]:
                trial = position.copy()
                trial[driver] = value
                if path:
                    ahead = position - (path[-2] if len(path) > 1 else paths[0][0])
                    trial += np.where(np.arange(len(trial)) == driver, 0.0, ahead)
                trial, gap = self.close(trial, driver)
                if gap > CLOSED or np.abs(trial - position).max() > 0.5:
                    break
                position = trial
                path.append(position)
            paths.append(np.array(path).reshape(-1, len(first)))
        return np.concatenate([paths[1][::-1], paths[0], paths[2]])
