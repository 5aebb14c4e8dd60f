"""What may differ between a world and the nominal one: one description, one sampler.

Training, the rollouts of planning, single options of ``fungrasp evaluate`` and the robustness protocol all
draw from a ``Randomization``. The paper (section IV.C.3) randomizes joint damping, servo gains, friction,
object mass, table height and the observed state of the hand; the tracked object, delays, pushes and an object
that was moved after planning are additions.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.records import BatchRecord

Range = tuple[float, float]
"""Smallest and largest value; equal ones are a constant."""

LONGEST_DELAY = 0.1
"""Longest delay from a decision to the servos [s]: one control period."""

_FACTORS = ("joint_damping", "servo_stiffness", "servo_damping", "wrist_stiffness", "mass")
_POSITIVE = (*_FACTORS, "friction", "push_duration")
_SIGNED = ("table_height",)


@dataclass(frozen=True)
class MeasurementError:
    """Zero-mean error of a measured quantity, per coordinate. Its unit is that of the quantity."""

    bias: float = 0.0
    """Standard deviation of the normal part that stays the same during an episode."""
    jitter: float = 0.0
    """Standard deviation of the normal part that is new at every measurement."""
    offset: float = 0.0
    """Length of a part that stays the same during an episode, in a uniformly random direction."""


@dataclass(frozen=True)
class Randomization:
    """Ranges to draw from, anew for every episode. The default is none: the nominal world.

    Factors are drawn log-uniformly, so that half is as likely as double; other ranges uniformly.
    """

    joint_damping: Range = (1.0, 1.0)
    """Factor on the damping of each finger joint."""
    servo_stiffness: Range = (1.0, 1.0)
    """Factor on the stiffness (kp) of each finger servo."""
    servo_damping: Range = (1.0, 1.0)
    """Factor on the damping (kd) of each finger servo."""
    wrist_stiffness: Range = (1.0, 1.0)
    """Factor on stiffness and damping of the wrist's servos, the same for all six, so that the wrist keeps up
    with its moving setpoint as before."""
    mass: Range = (1.0, 1.0)
    """Factor on the mass of the object."""
    friction: Range | None = None
    """Sliding friction of hand, object and table; the nominal one if None."""
    table_height: Range = (0.0, 0.0)
    """Height of the table top, and of what stands on it, above the nominal one [m]."""
    joint_error: MeasurementError = MeasurementError()
    """Error of the measured finger joints [rad]."""
    palm_position_error: MeasurementError = MeasurementError()
    """Error of the measured palm position [m]."""
    palm_rotation_error: MeasurementError = MeasurementError()
    """Error of the measured palm rotation, as a rotation vector [rad]."""
    object_position_error: MeasurementError = MeasurementError()
    """Error of the object's estimated and tracked position [m]."""
    object_rotation_error: MeasurementError = MeasurementError()
    """Error of the object's estimated and tracked rotation, as a rotation vector [rad] about its centre of
    mass."""
    tracker_delay: Range = (0.0, 0.0)
    """Age of the tracked object pose when a policy sees it [s]."""
    tracker_dropout: float = 0.0
    """Probability that a frame of the tracker is missing; the policy then sees the last one."""
    tracker_time_constant: float = 0.0
    """Time constant of the tracker's low-pass filter [s], a first-order one on position and rotation; 0 for
    none. A pose that moves steadily is seen late by as much."""
    action_delay: Range = (0.0, 0.0)
    """Time from a policy's decision to the servos [s], at most ``LONGEST_DELAY``."""
    push_phase: Literal["lift", "hold"] = "hold"
    """Phase from whose beginning the times of the pushes count."""
    push_times: tuple[Range, ...] = ()
    """Time of each push on the object's centre of mass, from the beginning of that phase [s]."""
    push_force: Range = (0.0, 0.0)
    """Force of each push [N], in a random direction."""
    push_weights: Range = (0.0, 0.0)
    """Additional force of each push, in multiples of the object's true weight."""
    push_duration: float = 0.2
    """Duration of each push [s]."""
    object_shift: Range = (0.0, 0.0)
    """Distance by which the object is moved on the table after planning [m], in a random direction; drawn
    uniformly over the ring's area."""
    object_turn: float = 0.0
    """Largest angle by which the object is then turned about the vertical, in either direction [rad]."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible.
        """
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, MeasurementError):
                numbers = np.array([value.bias, value.jitter, value.offset])
            elif value is None or isinstance(value, str):
                continue
            else:
                numbers = np.ravel(np.asarray(value, dtype=float))
            name = f.name.replace("_", " ")
            if not np.isfinite(numbers).all():
                raise FungraspError(f"{name} must be finite, not {value}")
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
        if self.action_delay[1] > LONGEST_DELAY:
            raise FungraspError(f"action delay must be 0 to {LONGEST_DELAY:g} s, not {self.action_delay}")
        if self.tracker_dropout > 1:
            raise FungraspError(f"tracker dropout is a probability, not {self.tracker_dropout}")

    @property
    def is_random(self) -> bool:
        """Whether episodes depend on the seed."""
        values = {name: value for name, value in vars(self).items() if not name.startswith("push_")}
        noisy = any(isinstance(v, MeasurementError) and v != MeasurementError() for v in values.values())
        wide = any(isinstance(v, tuple) and v[0] != v[1] for v in values.values())
        pushed = max(*self.push_force, *self.push_weights) > 0 and bool(self.push_times)
        moved = self.object_shift[1] > 0 or self.object_turn > 0
        return noisy or wide or pushed or moved or self.tracker_dropout > 0


@dataclass(frozen=True, eq=False)
class EpisodeSample(BatchRecord):
    """What was drawn for W episodes of a hand with M joints; P pushes."""

    joint_damping: np.ndarray
    """Factor on the damping of each joint, shape [W, M]."""
    servo_stiffness: np.ndarray
    """Factor on the stiffness of each joint's servo, shape [W, M]."""
    servo_damping: np.ndarray
    """Factor on the damping of each joint's servo, shape [W, M]."""
    wrist_stiffness: np.ndarray
    """Factor on stiffness and damping of the wrist's servos, shape [W]."""
    mass: np.ndarray
    """Factor on the mass of the object, shape [W]."""
    table_height: np.ndarray
    """Height of the table top above the nominal one [m], shape [W]."""
    joint_bias: np.ndarray
    """Error of the measured joints [rad], shape [W, M]."""
    palm_bias: np.ndarray
    """Error of the measured palm: offset [m], world frame, and rotation vector [rad], shape [W, 6]."""
    object_bias: np.ndarray
    """Error of the object's estimated and tracked pose: offset [m], world frame, and rotation vector [rad],
    shape [W, 6]."""
    tracker_delay: np.ndarray
    """Age of the tracked object pose [s], shape [W]."""
    action_delay: np.ndarray
    """Time from a decision to the servos [s], shape [W]."""
    push_direction: np.ndarray
    """Directions of the pushes, unit vectors, world frame, shape [W, P, 3]."""
    push_force: np.ndarray
    """Force of each push [N], shape [W, P]."""
    push_weights: np.ndarray
    """Additional force of each push in multiples of the object's true weight, shape [W, P]."""
    push_start: np.ndarray
    """Time of each push from the beginning of the phase [s], shape [W, P]."""
    object_shift: np.ndarray
    """Displacement of the object in the table's plane after planning: x and y [m], and a turn about the
    vertical [rad], shape [W, 3]."""
    friction: np.ndarray | None = None
    """Sliding friction of hand, object and table, shape [W]; the nominal one if None."""


def draw(randomization: Randomization, count: int, joints: int, rng: np.random.Generator) -> EpisodeSample:
    """Draw what differs in some episodes.

    Args:
        randomization: what to draw from.
        count: W, number of episodes.
        joints: M, number of the hand's joints, coupled ones included.
        rng: the same state gives the same sample.
    """
    r, pushes = randomization, len(randomization.push_times)

    def factor(bounds: Range, *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(*np.log(bounds), size=(count, *shape)))

    def bias(position: MeasurementError, rotation: MeasurementError) -> np.ndarray:
        errors = (position, rotation)
        normal = rng.normal(size=(count, 6)) * np.repeat([e.bias for e in errors], 3)
        if any(e.offset for e in errors):
            unit = _unit(rng.normal(size=(count, 2, 3)))
            normal += (unit * np.array([[e.offset] for e in errors])).reshape(count, 6)
        return normal

    direction = _unit(rng.normal(size=(count, pushes, 3)))
    around = rng.uniform(0.0, 2 * np.pi, count)
    # Uniform over the area of a ring: the square of the radius is uniform.
    low, high = r.object_shift
    inner = (low / high) ** 2 if high else 0.0
    distance = high * np.sqrt(inner + (1.0 - inner) * rng.uniform(size=count))
    turn = rng.uniform(-r.object_turn, r.object_turn, count)
    starts = np.array(r.push_times, dtype=float).reshape(pushes, 2)
    return EpisodeSample(
        joint_damping=factor(r.joint_damping, joints),
        servo_stiffness=factor(r.servo_stiffness, joints),
        servo_damping=factor(r.servo_damping, joints),
        wrist_stiffness=factor(r.wrist_stiffness),
        mass=factor(r.mass),
        friction=None if r.friction is None else rng.uniform(*r.friction, size=count),
        table_height=rng.uniform(*r.table_height, size=count),
        joint_bias=rng.normal(size=(count, joints)) * r.joint_error.bias,
        palm_bias=bias(r.palm_position_error, r.palm_rotation_error),
        object_bias=bias(r.object_position_error, r.object_rotation_error),
        tracker_delay=rng.uniform(*r.tracker_delay, size=count),
        action_delay=rng.uniform(*r.action_delay, size=count),
        push_direction=direction,
        push_force=rng.uniform(*r.push_force, size=(count, pushes)),
        push_start=rng.uniform(*starts.T, size=(count, pushes)),
        push_weights=rng.uniform(*r.push_weights, size=(count, pushes)),
        object_shift=np.stack([distance * np.cos(around), distance * np.sin(around), turn], axis=1),
    )


def random_stream(purpose: str, *numbers: int) -> np.random.Generator:
    """A generator of its own for each purpose and numbers (seed, episode, ...): streams of different purposes
    have nothing in common."""
    return np.random.default_rng([zlib.crc32(purpose.encode()), *numbers])


def draw_each(
    randomization: Randomization, seed: int, numbers: Sequence[int] | np.ndarray, joints: int
) -> EpisodeSample:
    """Draw for episodes by their numbers, so that what one gets does not depend on the others.

    Args:
        randomization: what to draw from.
        seed: of everything random.
        numbers: of the episodes, length W.
        joints: M, number of the hand's joints.
    """
    generators = [random_stream("episode", seed, int(number)) for number in numbers]
    return EpisodeSample.join([draw(randomization, 1, joints, rng) for rng in generators])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


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
"""The robustness protocol: one thing at a time, by name (docs/evaluation.md)."""
