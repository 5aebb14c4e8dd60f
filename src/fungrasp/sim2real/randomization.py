"""Randomization: differences between a world and the nominal world.

Training, planning rollouts, options of ``fungrasp evaluate`` and the protocols draw from a ``Randomization``.
The paper (section IV.C.3) randomizes joint damping, servo gains, friction, object mass, table height and the
observed state of the hand; the other parameters are additions.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.records import CheckedRecord

Range = tuple[float, float]
"""Smallest and largest value; equal for a constant."""

LONGEST_DELAY = 0.1
"""Longest delay from a decision to the servos [s]: one control period."""

_FACTORS = ("joint_damping", "servo_stiffness", "servo_damping", "wrist_stiffness", "mass", "object_scale")
_POSITIVE = (*_FACTORS, "friction", "push_duration")
_SIGNED = ("table_height",)
_PROBABILITIES = ("tracker_dropout", "tracker_freeze", "shift_probability")

OBJECT_SCALES = 5
"""Number of sizes of ``Randomization.object_scale``; a scene has a mesh for each."""


@dataclass(frozen=True)
class MeasurementError(CheckedRecord):
    """Zero-mean error of a measured quantity, per coordinate, in the unit of the quantity."""

    bias: float = 0.0
    """Standard deviation of the bias (normal), constant during an episode."""
    jitter: float = 0.0
    """Standard deviation of the noise (normal), new at every measurement."""
    offset: float = 0.0
    """Length of a bias in a random direction, constant during an episode."""
    offset_deviation: float = 0.0
    """Standard deviation of that length."""
    uniform: float = 0.0
    """Half range of a uniform bias, constant during an episode."""

    @property
    def variance(self) -> float:
        """Variance of the bias, for each of three coordinates."""
        return self.bias**2 + (self.offset**2 + self.offset_deviation**2) / 3 + self.uniform**2 / 3


@dataclass(frozen=True)
class Randomization(CheckedRecord):
    """Ranges of parameters, drawn for every episode. Default: the nominal world.

    Factors are drawn log-uniformly (half is as likely as double), other ranges uniformly.
    """

    joint_damping: Range = (1.0, 1.0)
    """Factor on the damping of each finger joint."""
    servo_stiffness: Range = (1.0, 1.0)
    """Factor on the stiffness (kp) of each finger servo."""
    servo_damping: Range = (1.0, 1.0)
    """Factor on the damping (kd) of each finger servo."""
    wrist_stiffness: Range = (1.0, 1.0)
    """Common factor on stiffness and damping of the six wrist servos, so that the lag behind setpoints stays
    the same."""
    joint_friction: Range = (0.0, 0.0)
    """Dry friction of each finger joint, as a fraction of its servo's torque limit."""
    encoder_bias: float = 0.0
    """Largest encoder error of each finger joint, constant during an episode [rad]. Servos use the encoder,
    so the joint position has the same error."""
    backlash: Range = (0.0, 0.0)
    """Largest backlash of each finger joint, in either direction [rad]."""
    wrist_position_offset: float = 0.0
    """Calibration error of the palm position [m], in a random direction, constant during an episode."""
    wrist_rotation_offset: float = 0.0
    """Calibration error of the palm rotation [rad], about a random axis, constant during an episode."""
    wrist_lag: Range = (0.0, 0.0)
    """Time constant of the first-order lag of the wrist behind its setpoints [s]."""
    mass: Range = (1.0, 1.0)
    """Factor on the mass of the object."""
    center_of_mass_shift: float = 0.0
    """Largest displacement of the object's center of mass along each axis of its frame, in either direction,
    as a fraction of its extent."""
    object_scale: Range = (1.0, 1.0)
    """Factor on the size of the object, one of ``object_scales``; the mass is unchanged."""
    friction: Range | None = None
    """Sliding friction of hand, object and table; the nominal one if None."""
    table_height: Range = (0.0, 0.0)
    """Height of the table top above the nominal height [m]; objects move with it."""
    table_tilt: Range = (0.0, 0.0)
    """Slope of the table top [rad], in a random direction."""
    joint_error: MeasurementError = MeasurementError()
    """Error of the measured finger joints [rad]."""
    palm_position_error: MeasurementError = MeasurementError()
    """Error of the measured palm position [m]."""
    palm_rotation_error: MeasurementError = MeasurementError()
    """Error of the measured palm rotation, as a rotation vector [rad]."""
    object_position_error: MeasurementError = MeasurementError()
    """Error of the object's estimated and tracked position [m]."""
    object_rotation_error: MeasurementError = MeasurementError()
    """Error of the object's estimated and tracked rotation, as a rotation vector [rad] about its center of
    mass."""
    tracker_delay: Range = (0.0, 0.0)
    """Delay of the tracked object pose [s]."""
    tracker_dropout: float = 0.0
    """Probability of a missing tracker frame; the policy then sees the previous one."""
    tracker_freeze: float = 0.0
    """Probability that the tracker loses the object at the first touch. The policy then sees the last frame
    until the hand has left the object."""
    tracker_time_constant: float = 0.0
    """Time constant of the tracker's first-order low-pass filter [s], which delays a moving pose by this
    time; 0 for none."""
    action_delay: Range = (0.0, 0.0)
    """Delay from a policy's action to the servos [s], at most ``LONGEST_DELAY``."""
    push_phase: Literal["lift", "hold"] = "hold"
    """Phase whose start is time zero of the pushes."""
    push_times: tuple[Range, ...] = ()
    """Times of pushes on the object's center of mass, from the start of the phase [s]."""
    push_force: Range = (0.0, 0.0)
    """Force of each push [N], in a random direction."""
    push_weights: Range = (0.0, 0.0)
    """Additional force of each push, in multiples of the object's true weight."""
    push_duration: float = 0.2
    """Duration of each push [s]."""
    object_shift: Range = (0.0, 0.0)
    """Displacement of the object on the table after planning [m], in a random direction; uniform over the
    area of the ring."""
    shift_probability: float = 1.0
    """Probability that the object is moved and rotated in an episode."""
    object_turn: float = 0.0
    """Largest rotation of the moved object about the vertical, in either direction [rad]."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: invalid value.
        """
        super().__post_init__()
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, MeasurementError):
                numbers = np.array(list(vars(value).values()))
            elif value is None or isinstance(value, str):
                continue
            else:
                numbers = np.ravel(np.asarray(value, dtype=float))
            name = f.name.replace("_", " ")
            ranges = np.reshape(numbers, (-1, 2)) if isinstance(value, tuple) else np.empty((0, 2))
            if (ranges[:, 0] > ranges[:, 1]).any():
                raise FungraspError(f"{name} must rise from low to high, not {value}")
            if f.name in _POSITIVE and (numbers <= 0).any():
                raise FungraspError(f"{name} must be positive, not {value}")
            if f.name not in _SIGNED and (numbers < 0).any():
                raise FungraspError(f"{name} must not be negative, not {value}")
        if max(np.abs(self.table_height)) > 0.2:
            raise FungraspError(
                f"table height must be within 0.2 m of the nominal one, not {self.table_height}"
            )
        if self.table_tilt[1] > 0.5:
            raise FungraspError(f"table tilt must be at most 0.5 rad, not {self.table_tilt}")
        if self.center_of_mass_shift > 0.5:
            raise FungraspError(
                "center of mass shift must be within half of the extent, not "
                f"{self.center_of_mass_shift} of it"
            )
        if self.action_delay[1] > LONGEST_DELAY:
            raise FungraspError(f"action delay must be 0 to {LONGEST_DELAY:g} s, not {self.action_delay}")
        for name in _PROBABILITIES:
            if getattr(self, name) > 1:
                raise FungraspError(f"{name.replace('_', ' ')} is a probability, not {getattr(self, name)}")

    @property
    def is_random(self) -> bool:
        """Whether episodes depend on the seed."""
        values = {name: value for name, value in vars(self).items() if not name.startswith("push_")}
        noisy = any(isinstance(v, MeasurementError) and v != MeasurementError() for v in values.values())
        wide = any(isinstance(v, tuple) and v[0] != v[1] for v in values.values())
        pushed = max(*self.push_force, *self.push_weights) > 0 and bool(self.push_times)
        directions = (
            self.object_shift[1],
            self.object_turn,
            self.table_tilt[1],
            self.wrist_position_offset,
            self.wrist_rotation_offset,
        )
        chances = (self.tracker_dropout, self.tracker_freeze, self.encoder_bias, self.center_of_mass_shift)
        return noisy or wide or pushed or max(directions) > 0 or max(chances) > 0

    @property
    def object_scales(self) -> tuple[float, ...]:
        """Possible values of ``object_scale``, increasing: ``OBJECT_SCALES`` of them, or one."""
        low, high = self.object_scale
        return (low,) if low == high else tuple(np.linspace(low, high, OBJECT_SCALES).round(6).tolist())

    @property
    def object_pose_covariance(self) -> np.ndarray:
        """Covariance of the bias of the object pose: position [m] and rotation vector [rad], shape [6, 6]."""
        errors = (self.object_position_error, self.object_rotation_error)
        return np.diag(np.repeat([e.variance for e in errors], 3))


NOMINAL = Randomization()
"""The nominal world."""

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
"""Moderate differences, for training and rollouts."""

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
"""Differences about as large as between simulation and robots (section IV.C.3 of the paper)."""

THREE_PUSHES: tuple[Range, ...] = ((0.5, 0.5), (1.5, 1.5), (2.5, 2.5))
"""Times at which the protocols push the object, from the start of the hold [s]."""

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
"""The reality protocol: all differences at once. Sources of the ranges: docs/evaluate.md."""

REALITY_ROLLOUTS = replace(REALITY, table_height=(0.0, 0.0), object_scale=(1.0, 1.0), object_shift=(0.0, 0.0))
"""Randomization of planning rollouts in the reality protocol, without three parameters: the object's pose
error covers the table height, because the table is seen with the object; the hand follows an object shift
before rollouts begin; 1 % of the size is less than the pose error and would need a mesh for each size."""

PRESETS: dict[str, Randomization] = {
    "nominal": NOMINAL,
    "moderate": MODERATE,
    "wide": WIDE,
    "reality": REALITY,
}
"""Presets by name."""


def preset(name: str) -> Randomization:
    """Return one of ``PRESETS``.

    Raises:
        UnknownNameError: unknown preset.
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
"""The robustness protocol: one difference at a time, by name (docs/evaluate.md)."""

ProtocolName = Literal["nominal", "reality", "robustness"]
"""Names of the evaluation protocols (docs/evaluate.md)."""


def protocol_conditions(protocol: ProtocolName) -> dict[str, Randomization]:
    """Return the randomizations of a protocol by condition; the name of a single condition is ""."""
    return {"nominal": {"": NOMINAL}, "reality": {"": REALITY}, "robustness": ROBUSTNESS}[protocol]


def protocol_name(randomization: Randomization) -> str:
    """Return the name of the protocol with only this condition: "nominal", "reality" or "custom"."""
    return {NOMINAL: "nominal", REALITY: "reality"}.get(randomization, "custom")
