"""Named randomizations: what training, planning and the protocols of evaluation draw from."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from fungrasp.core.errors import UnknownNameError
from fungrasp.sim2real.randomization import MeasurementError, Randomization, Range

NOMINAL = Randomization()
"""Every world is the nominal one."""

MODERATE = Randomization(
    joint_damping=(0.7, 1.4),
    servo_stiffness=(0.85, 1.18),
    servo_damping=(0.85, 1.18),
    wrist_stiffness=(0.85, 1.18),
    mass=(0.7, 1.4),
    friction=(0.7, 1.0),
    table_height=(-0.005, 0.005),
    joint_error=MeasurementError(0.01, 0.003),
    palm_position_error=MeasurementError(0.001, 0.0005),
    palm_rotation_error=MeasurementError(0.005, 0.002),
    object_position_error=MeasurementError(0.002, 0.001),
    object_rotation_error=MeasurementError(0.02, 0.01),
    tracker_delay=(0.0, 0.02),
    action_delay=(0.0, 0.02),
    push_phase="lift",
    push_times=((0.0, 3.0),),
    push_force=(0.0, 1.0),
    object_shift=(0.0, 0.005),
    object_turn=0.05,
)
"""What a good policy can overcome without learning to expect the worst: for training and rollouts."""

WIDE = Randomization(
    joint_damping=(0.5, 2.0),
    servo_stiffness=(0.75, 1.33),
    servo_damping=(0.75, 1.33),
    wrist_stiffness=(0.7, 1.4),
    mass=(0.5, 2.0),
    friction=(0.5, 1.1),
    table_height=(-0.01, 0.01),
    joint_error=MeasurementError(0.02, 0.005),
    palm_position_error=MeasurementError(0.003, 0.0005),
    palm_rotation_error=MeasurementError(0.01, 0.002),
    object_position_error=MeasurementError(0.004, 0.002),
    object_rotation_error=MeasurementError(0.05, 0.02),
    tracker_delay=(0.0, 0.1),
    action_delay=(0.0, 0.1),
    push_phase="lift",
    push_times=((0.0, 3.0),),
    push_force=(0.0, 2.0),
    object_shift=(0.0, 0.01),
    object_turn=0.1,
)
"""About what separates simulations from robots (section IV.C.3 of the paper)."""

THREE_PUSHES: tuple[Range, ...] = ((0.5, 0.5), (1.5, 1.5), (2.5, 2.5))
"""When the robustness protocol pushes the object, from the beginning of the hold [s]."""

REALITY = Randomization(
    servo_stiffness=(0.85, 1.15),
    servo_damping=(0.7, 1.3),
    joint_damping=(0.7, 1.3),
    joint_friction=(0.0, 0.04),
    encoder_bias=0.01,
    backlash=(0.01, 0.01),
    wrist_position_offset=0.003,
    wrist_rotation_offset=float(np.deg2rad(1)),
    wrist_lag=(0.02, 0.06),
    mass=(0.5, 2.0),
    center_of_mass_shift=0.15,
    object_scale=(0.99, 1.01),
    friction=(0.5, 1.1),
    table_height=(-0.01, 0.01),
    table_tilt=(0.0, float(np.deg2rad(1))),
    object_position_error=MeasurementError(bias=0.003, uniform=0.005, jitter=0.002),
    object_rotation_error=MeasurementError(
        offset_deviation=float(np.deg2rad(3)), jitter=float(np.deg2rad(1))
    ),
    tracker_delay=(0.06, 0.12),
    tracker_dropout=0.05,
    tracker_freeze=0.3,
    action_delay=(0.03, 0.1),
    push_times=THREE_PUSHES,
    push_weights=(0.5, 0.5),
    push_duration=0.2,
    object_shift=(0.01, 0.02),
    shift_probability=0.3,
)
"""The reality protocol: everything at once, as on a robot whose belief is the nominal world. Where each range
comes from: docs/evaluate.md."""

REALITY_ROLLOUTS = replace(REALITY, table_height=(0.0, 0.0), object_scale=(1.0, 1.0), object_shift=(0.0, 0.0))
"""What the rollouts of planning draw from where worlds are those of the reality protocol. The table's height
is seen with the object that stands on it, so that the error of its pose covers it; where the object is moved
after planning, the hand follows before rollouts begin; a percent of the size is less than the pose's error,
and would take a mesh for each size."""

PRESETS: dict[str, Randomization] = {
    "nominal": NOMINAL,
    "moderate": MODERATE,
    "wide": WIDE,
    "reality": REALITY,
}
"""What training can draw from, by name."""


def preset(name: str) -> Randomization:
    """One of ``PRESETS``.

    Raises:
        UnknownNameError: there is none of this name.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset of worlds", name, PRESETS)
    return PRESETS[name]


ROBUSTNESS: dict[str, Randomization] = {
    "nominal": NOMINAL,
    "mass x0.5": Randomization(mass=(0.5, 0.5)),
    "mass x2": Randomization(mass=(2.0, 2.0)),
    "friction 0.6": Randomization(friction=(0.6, 0.6)),
    "table +2 cm": Randomization(table_height=(0.02, 0.02)),
    "table -2 cm": Randomization(table_height=(-0.02, -0.02)),
    "pose noise 1 cm, 10 deg": Randomization(
        object_position_error=MeasurementError(offset=0.01),
        object_rotation_error=MeasurementError(offset=float(np.deg2rad(10))),
    ),
    "latency 50 ms": Randomization(action_delay=(0.05, 0.05)),
    "latency 100 ms": Randomization(action_delay=(0.1, 0.1)),
    "pushes": Randomization(push_times=THREE_PUSHES, push_weights=(1.0, 1.0)),
    "hidden shift 2 cm": Randomization(object_shift=(0.02, 0.02)),
}
"""The robustness protocol: one thing at a time, by name (docs/evaluate.md)."""

ProtocolName = Literal["nominal", "reality", "robustness"]
"""Names of the protocols of evaluation (docs/evaluate.md)."""


def protocol_conditions(protocol: ProtocolName) -> dict[str, Randomization]:
    """What a protocol draws from, by the name of the condition, "" where there is only one."""
    return {"nominal": {"": NOMINAL}, "reality": {"": REALITY}, "robustness": ROBUSTNESS}[protocol]


def protocol_name(randomization: Randomization) -> str:
    """Name of the protocol of which this is the only condition: "nominal", "reality", or "custom"."""
    return {NOMINAL: "nominal", REALITY: "reality"}.get(randomization, "custom")
