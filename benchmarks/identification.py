"""``python -m benchmarks.identification``: identified dynamics of twins' hands against their truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import main
from benchmarks.twins.twin_identification import ALL_ERRORS, identify_on_twin
from fungrasp.cli.console import table
from fungrasp.core.provenance import machine, run_record
from fungrasp.evaluation.result_files import write_result
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, load_object
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.twin.parameters import TwinParameters, cell_twin
from fungrasp.sim2real.joint_dynamics import QUANTITIES, JointDynamics


@dataclass(frozen=True)
class BenchIdentify:
    """Identify hands of twins whose dynamics are drawn."""

    twins: int = 2
    """Twins of each robot."""
    robots: tuple[str, ...] = ("ur5e-allegro", "ur5e-inspire")
    """Cells that are twins."""
    weight: float = 0.0
    """Mass that is fixed to each fingertip in as many logs more [kg]."""
    json: Path | None = None
    """Write the numbers here (.json, with a .csv beside)."""

    def run(self) -> None:
        rows: list[dict] = []
        for name in self.robots:
            cell = load_cell(name)
            hand, obj = load_hand(cell.hand), load_object("wine_glass")
            for twin in range(self.twins):
                truth = cell_twin(cell, hand, twin)
                fit = twin_fit(cell, hand, obj, truth, ALL_ERRORS, self.weight)
                rows.append({"hand": hand.name, "twin": twin, **asdict(fit)})
        if self.json is not None:
            write_result(self.json, run_record(0), rows)
        names = list(dict.fromkeys(name for row in rows for name in row))
        print(table([names, *([_text(row.get(name)) for name in names] for row in rows)]))
        print(machine())


@dataclass(frozen=True)
class TwinFit:
    """One identification of a drawn twin's hand; errors are relative, medians over the joints."""

    errors: dict[str, float]
    """By quantity; friction: against that at rest."""
    ratio_errors: dict[str, float]
    """Of damping, friction while sliding and armature, each over the stiffness: all that the motion of joints
    without load depends on."""
    uncertainty: dict[str, float]
    """Standard deviation that the fit says of itself, by quantity."""
    identified: dict[str, float]
    """Share of the joints whose quantity the logs tell; the others keep the model's value."""
    largest_error: float
    """Over all quantities of all joints."""
    model_error: float
    """Of the model's own values: what is known without identification."""
    delay_error: float
    """[s]."""
    held_out_rms: float
    """Of positions in the halves of the logs that were not fitted [rad]."""
    simulations: int
    """Simulated motions."""
    seconds: float
    """Time the fit took [s]."""


def twin_fit(
    cell: RobotCell, hand: Hand, obj: ObjectModel, truth: TwinParameters, settings, weight: float
) -> TwinFit:
    """Identify the hand of a twin.

    Args:
        cell: the robot.
        hand: on its arm.
        obj: lies aside.
        truth: of the twin.
        settings: of the fit.
        weight: mass on each fingertip in as many logs more [kg]; 0 for none.
    """
    identified = identify_on_twin(cell, hand, obj, truth, settings=settings, weight=weight)
    fit, true = identified.found, true_dynamics(hand, truth)
    found, model = fit.dynamics, true_dynamics(hand, None)
    errors = {name: _errors(found, true, name) for name in QUANTITIES}
    actual = {"damping": true.damping, "friction": true.friction * truth.sliding, "armature": true.armature}
    ratios = {
        name: np.abs(getattr(found, name) / found.stiffness * true.stiffness / values - 1.0)
        for name, values in actual.items()
    }
    return TwinFit(
        {name: float(np.median(values)) for name, values in errors.items()},
        {name: float(np.median(values)) for name, values in ratios.items()},
        {name: float(np.median(fit.relative_error[name])) for name in QUANTITIES},
        {name: float(np.mean(fit.identified[name])) for name in QUANTITIES},
        float(np.concatenate(list(errors.values())).max()),
        float(np.median(np.concatenate([_errors(model, true, name) for name in QUANTITIES]))),
        found.delay - truth.hand_delay,
        identified.held_out_rms,
        fit.simulations,
        fit.seconds,
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


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


COMMAND = BenchIdentify


if __name__ == "__main__":
    main("identification", COMMAND)
