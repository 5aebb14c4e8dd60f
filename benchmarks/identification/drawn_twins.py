"""Identified dynamics of a twin's hand against its truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.twins.twin_identification import ALL_ERRORS, identify_on_twin
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.parameters import TwinParameters, cell_twin
from fungrasp.sim2real.joint_dynamics import QUANTITIES, JointDynamics


@dataclass(frozen=True)
class TwinFit:
    """One identification of a drawn twin's hand."""

    hand: str
    """Name of the hand."""
    twin: int
    """Which twin."""
    method: str
    """Of the fit."""
    median_error: float
    """Over all quantities of all joints, of the truth."""
    errors: dict[str, float]
    """Median over the joints by quantity; friction: against that at rest."""
    ratio_errors: dict[str, float]
    """Median over the joints of the errors of damping, friction while sliding and armature, each over the
    stiffness: all that the motion of joints without load depends on."""
    uncertainty: dict[str, float]
    """Median over the joints of the standard deviation that the fit says of itself, relative, by quantity."""
    identified: dict[str, float]
    """Share of the joints whose quantity the logs tell; the others keep the model's value."""
    identified_errors: dict[str, float | None]
    """Median of the errors of these; of damping, friction and armature of the ratios to the stiffness."""
    largest_error: float
    """Over all quantities of all joints."""
    model_error: float
    """Of the model's own values, as ``median_error``: what is known without identification."""
    delay_error: float
    """[s]."""
    held_out_rms: float
    """Of positions in the halves of the logs that were not fitted [rad]."""
    simulations: int
    """Simulated motions."""
    seconds: float
    """Time the fit took [s]."""
    weight: float
    """Mass on each fingertip in as many logs more [kg]; 0 for none."""


def twin_fit(
    cell: RobotCell,
    hand: Hand,
    thing: ObjectModel,
    twin: int,
    method: str,
    evaluations: int,
    weight: float = 0.0,
) -> TwinFit:
    """Identify the hand of a twin whose parameters are drawn.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: an object, which lies aside.
        twin: which one.
        method: of the fit.
        evaluations: of CMA-ES.
        weight: mass on each fingertip in as many logs more [kg]; 0 for none.
    """
    truth = cell_twin(cell, hand, twin)
    settings = replace(ALL_ERRORS, method=method, evaluations=evaluations)
    identified = identify_on_twin(cell, hand, thing, truth, settings=settings, weight=weight)
    found, true = identified.found.dynamics, true_dynamics(hand, truth)
    model = true_dynamics(hand, None)
    errors = {name: _errors(found, true, name) for name in QUANTITIES}
    unfitted = np.concatenate([_errors(model, true, name) for name in QUANTITIES])
    everything = np.concatenate(list(errors.values()))
    off = {"stiffness": errors["stiffness"], **_ratio_errors(found, true, truth)}
    told = identified.found.identified
    return TwinFit(
        hand.name,
        twin,
        method,
        float(np.median(everything)),
        {name: float(np.median(values)) for name, values in errors.items()},
        {name: float(np.median(off[name])) for name in QUANTITIES[1:]},
        {name: float(np.median(identified.found.relative_error[name])) for name in QUANTITIES},
        {name: float(np.mean(told[name])) for name in QUANTITIES},
        {name: _median(off[name][told[name]]) for name in QUANTITIES},
        float(everything.max()),
        float(np.median(unfitted)),
        found.delay - truth.hand_delay,
        identified.held_out_rms,
        identified.found.simulations,
        identified.found.seconds,
        weight,
    )


def true_dynamics(hand: Hand, truth: TwinParameters | None) -> JointDynamics:
    """Dynamics of a twin's driven joints; those of the model if None."""
    names, servos = list(hand.actuators), list(hand.actuators.values())
    rows = [hand.joint_names.index(name) for name in names]
    dofs = [hand.model.joint(name).dofadr[0] for name in names]
    one = np.ones(len(names))
    torque, damping, armature = (
        (truth.stiffness, truth.damping[rows], truth.armature[rows]) if truth else (one, one, one)
    )
    friction = hand.model.dof_frictionloss[dofs].copy()
    if truth is not None:
        friction = truth.friction * np.array([servo.force_limit for servo in servos])
    return JointDynamics(
        tuple(names),
        torque * np.array([servo.kp for servo in servos]),
        torque * np.array([servo.kd for servo in servos]) + damping * hand.model.dof_damping[dofs],
        friction,
        armature * hand.model.dof_armature[dofs],
        truth.hand_delay if truth else 0.0,
    )


def _errors(found: JointDynamics, true: JointDynamics, name: str) -> np.ndarray:
    return np.abs(getattr(found, name) / getattr(true, name) - 1.0)


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None


def _ratio_errors(found: JointDynamics, true: JointDynamics, truth: TwinParameters) -> dict[str, np.ndarray]:
    """See ``TwinFit.ratio_errors``; of each joint. Motion that never rests shows friction of sliding."""
    actual = {"damping": true.damping, "friction": true.friction * truth.sliding, "armature": true.armature}
    return {
        name: np.abs(getattr(found, name) / found.stiffness * true.stiffness / values - 1.0)
        for name, values in actual.items()
    }
