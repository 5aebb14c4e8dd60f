"""Joints of a foreign model that move together: equalities, mimic joints and tendons as one linear map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.checking.finding import Finding, note, warning
from fungrasp.hands.checking.kinematic_tree import joint_name

LEAST_ROOM = 0.1
"""A coupling that leaves less of its driver's range can't be meant."""

TIGHT_TENDON = 0.05
"""A fixed tendon whose length may vary by less is a rigid coupling [rad]."""


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


@dataclass(frozen=True)
class Coupling:
    """``joint = constant + slope * driver`` [rad], positions as the model counts them."""

    joint: int
    """Id of the joint that is driven."""
    driver: int
    """Id of the joint that drives it."""
    constant: float
    """Position of the driven joint where the driver is at zero [rad]."""
    slope: float
    """Change of the driven joint per change of the driver."""

    def from_reference(self, model: mujoco.MjModel) -> float:
        """The constant where positions count from the model's reference pose [rad]."""
        reference = model.qpos0[model.jnt_qposadr]
        return float(self.constant - reference[self.joint] + self.slope * reference[self.driver])


def find_couplings(
    model: mujoco.MjModel, findings: list[Finding], given: Sequence[GivenCoupling] = ()
) -> list[Coupling]:
    """All linear couplings of a model, no joint driven twice and no loop.

    Args:
        model: any.
        findings: what is left out or assumed is added.
        given: further couplings, that come before the model's.

    Raises:
        FungraspError: a given coupling names a joint that does not exist, or closes a loop.
    """
    found: dict[int, Coupling] = {}

    def add(joint: int, driver: int, constant: float, slope: float) -> bool:
        above, steps = driver, 0
        while above in found and steps <= len(found):
            above, steps = found[above].driver, steps + 1
        if joint in found or above == joint or slope == 0.0:
            return False
        found[joint] = Coupling(joint, driver, constant, slope)
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
            raise FungraspError(f"--couple: '{joint}' is driven already, or drives '{driver}'")
    for e in range(model.neq):
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[e] >= 0 and model.eq_active0[e]:
            joint, driver = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            constant, slope, *curve = model.eq_data[e, :5]
            if not tie(joint, driver, float(constant), float(slope)):
                findings.append(
                    warning(
                        f"the coupling of '{joint_name(model, joint)}' to '{joint_name(model, driver)}' "
                        "repeats or contradicts another: left out"
                    )
                )
            elif np.abs(curve).max() > 1e-9:
                findings.append(
                    warning(
                        f"joint '{joint_name(model, joint)}' follows by a curve: its straight part is kept"
                    )
                )
    for tendon in range(model.ntendon):
        _tendon(model, tendon, tie, add, findings)
    return [found[joint] for joint in sorted(found)]


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
    rigid = len(terms) == 2 and model.tendon_limited[tendon] and high - low < TIGHT_TENDON
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


def coupling_matrix(count: int, couplings: list[Coupling]) -> tuple[np.ndarray, np.ndarray]:
    """``joints = matrix @ independent + offset``; matrix: shape [M, U], offset: [rad], shape [M]."""
    driven = {coupling.joint: coupling for coupling in couplings}
    free = [joint for joint in range(count) if joint not in driven]
    matrix, offset = np.zeros((count, len(free))), np.zeros(count)
    matrix[free, range(len(free))] = 1.0

    def fill(joint: int) -> None:
        if joint in driven:
            coupling = driven.pop(joint)
            fill(coupling.driver)
            matrix[joint] = coupling.slope * matrix[coupling.driver]
            offset[joint] = coupling.constant + coupling.slope * offset[coupling.driver]

    for joint in range(count):
        fill(joint)
    return matrix, offset
