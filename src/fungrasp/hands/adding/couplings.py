"""Couplings of joints, from the file, the user and closed loops."""

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
"""A coupling is wrong if it leaves less than this share of its driver's range."""

TIGHT_TENDON = 0.05
"""A fixed tendon is a rigid coupling if it leaves its joints less [rad]."""


class GivenCoupling(NamedTuple):
    """Coupling ``joint = offset + slope * driver`` given by the user."""

    joint: str
    """Name of the driven joint."""
    slope: float
    """Ratio of the driven joint's motion to the driver's."""
    driver: str
    """Name of the driving joint."""
    offset: float = 0.0
    """Position of the driven joint if the driver is at zero [rad]."""


def from_reference(model: mujoco.MjModel, joint: int, drive: Drive) -> float:
    """Return the constant of a coupling for positions relative to the model's reference pose [rad]."""
    reference = model.qpos0[model.jnt_qposadr]
    return float(drive.constant - reference[joint] + drive.slope * reference[drive.driver])


def find_couplings(
    model: mujoco.MjModel, findings: list[Finding], given: Sequence[GivenCoupling] = ()
) -> dict[int, Drive]:
    """Return the linear couplings of a model by driven joint; they form no loop.

    Args:
        findings: ignored and assumed couplings are added.
        given: couplings with precedence over the model's.

    Raises:
        FungraspError: a given coupling names an unknown joint, repeats another or closes a loop.
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
        """Add a coupling of motions from the reference pose, as in MuJoCo. change: the joint's motion where
        the driver's is zero [rad]."""
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
                # A fixed joint follows any other joint with slope 0.
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
    # Divided by its largest coefficient, the range is in radians even for coefficients in meters.
    slack = (high - low) / max(abs(factor) for _, factor in terms)
    rigid = len(terms) == 2 and bool(model.tendon_limited[tendon]) and slack < TIGHT_TENDON
    rigid |= len(terms) == 2 and bool(
        np.any((model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & (model.eq_obj1id == tendon))
    )
    name = model.tendon(tendon).name or f"tendon {tendon}"
    if rigid:
        (near, a), (far, b) = terms
        # If limits leave such a coupling no room, it becomes two joints of one motor.
        if _room(model, far, near, -a / b) > LEAST_ROOM:
            if not tie(far, near, 0.0, -a / b):
                tie(near, far, 0.0, -b / a)
            return
        findings.append(
            warning(
                f"the tendon '{name}' and the limits leave '{joint_name(model, near)}' and "
                f"'{joint_name(model, far)}' no common range"
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
        # Assumption: the joints of one motor reach their limits together.
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
    """Return the share of a driver's range in which the driven joint keeps its limits."""
    reference = model.qpos0[model.jnt_qposadr]
    ends = np.sort((model.jnt_range[joint] - reference[joint]) / slope + reference[driver])
    low, high = model.jnt_range[driver]
    return float((min(high, ends[1]) - max(low, ends[0])) / max(high - low, 1e-9))


STEPS = 60
"""Number of steps from the file's pose to each limit of a loop's driver."""

CLOSED = 1e-3
"""Largest gap of a closed loop [m]."""

LEAST_MOTION = 0.1
"""Smallest range of a loop's driver [rad]."""

STRAIGHT = 0.15
"""Largest unreported deviation of a coupled joint from its line [rad]."""

TURNING = 0.1
"""Smallest motion of a loop's driver, as a share of the largest motion of a joint."""

FREE = 1e-2
"""Singular values of a loop's Jacobian below this share of the largest count as zero: a free motion each."""


@dataclass(frozen=True)
class Loop:
    """The constraint that closes a loop."""

    equality: int
    """Id of the equality."""
    name: str
    """Name for messages."""
    ends: tuple[int, int]
    """Ids of the two connected bodies."""
    joints: frozenset[int]
    """Joints between these bodies."""


def closed_loops(model: mujoco.MjModel, palm: int) -> list[Loop]:
    """Return the loops of a hand, including those through the palm."""
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
    """Return the couplings and those that replace loops.

    Args:
        model: the limits of the loops' joints are set to the range in which the loops stay closed.
        couplings: known couplings; loops whose joints they couple already are ignored.
        findings: solved loops are added.

    Raises:
        FungraspError: a loop leaves more than one motion, none, or one with too small a range.
    """
    result = dict(couplings)
    matrix, offset, independent = coupling_matrix(model.njnt, couplings)
    for group in _groups(loops, matrix):
        names = listed([loop.name for loop in group], limit=3)
        joints = sorted(set().union(*(loop.joints for loop in group)))
        moved = np.flatnonzero(np.abs(matrix[joints]).sum(axis=0) > 0)
        if len(moved) < 2:
            continue
        follower = _Follower(model, group, matrix, offset, moved)
        free, motion = follower.motions()
        own = independent[moved].tolist()
        if free != 1:
            freedom = "no motion" if free == 0 else f"{free} degrees of freedom instead of one"
            raise FungraspError(
                f"the closed loop {names} leaves its {len(own)} joints {freedom}; a hand's joint follows one "
                "driver or none: tie the joints behind it with --couple JOINT=OFFSET+SLOPE*DRIVER, or give a "
                "model without loops"
            )
        # Of the joints that move, the driver is the one that carries most bodies.
        carried = [len(subtree(model, int(model.jnt_bodyid[j]))) for j in own]
        driver = int(np.argmax(np.where(motion > TURNING * motion.max(), carried, 0)))
        path = follower.follow(driver, model.jnt_range[own[driver]])
        if np.ptp(path[:, driver]) < LEAST_MOTION:
            raise FungraspError(
                f"the closed loop {names} lets '{joint_name(model, own[driver])}' turn by only "
                f"{np.ptp(path[:, driver]):.2f} rad; are its bodies connected correctly in the file's pose?"
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
    """Group loops that share independent joints."""
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
        """moved: independent joints of the loops, as columns of the matrix, length J."""
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
        """Return the loops' constraint violations [m], rotations scaled to lengths, and their Jacobian."""
        data = self._data
        data.qpos[:] = self._rest + self._columns @ position + self._offset
        mujoco.mj_fwdPosition(self._model, data)
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        jacobian = data.efc_J.reshape(data.nefc, self._model.nv)[rows]
        return data.efc_pos[rows].copy(), jacobian @ self._columns

    def close(self, position: np.ndarray, held: int | None = None) -> tuple[np.ndarray, float]:
        """Return the nearest position with closed loops, one joint held, and the remaining gap [m]."""
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
        """Return the number of free motions at generic positions, and by how much the last one moves each
        joint, shape [J]."""
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
        """Return positions over the range of one joint, as far as the loops close, shape [P, J]."""
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
