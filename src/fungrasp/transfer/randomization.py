"""What differs between trials that the policy isn't told: ranges, and values drawn from them.

The paper (section IV.C.3) randomises joint damping, servo gains, friction, object mass, table height and the
observed state of the hand; the tracked object, delays, pushes and an object that was moved since it was seen
are additions.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.errors import FungraspError

Range = tuple[float, float]
"""Smallest and largest value."""

_SCALES = ("damping", "stiffness", "servo_damping", "wrist_stiffness", "mass")


@dataclass(frozen=True)
class Spread:
    """Standard deviations of an error with zero mean, per coordinate."""

    bias: float = 0.0
    """Of the part that stays the same during a trial."""
    jitter: float = 0.0
    """Of the part that is new at every step."""


@dataclass(frozen=True)
class Randomisation:
    """Ranges to draw from, for every world and trial anew.

    Factors are drawn log-uniformly, so that half is as likely as double; other values uniformly; noise is
    normal.
    """

    damping: Range = (0.5, 2.0)
    """Factor on the damping of each finger joint."""
    stiffness: Range = (0.75, 1.33)
    """Factor on the stiffness (kp) of each finger servo."""
    servo_damping: Range = (0.75, 1.33)
    """Factor on the damping (kd) of each finger servo."""
    wrist_stiffness: Range = (0.7, 1.4)
    """Factor on stiffness and damping of the wrist's servos, the same for all six, so that the wrist keeps up
    with its moving set point as before."""
    mass: Range = (0.5, 2.0)
    """Factor on the mass of the object."""
    friction: Range | None = (0.5, 1.1)
    """Sliding friction of hand, object and table; the scene's if None."""
    table_height: Range = (-0.01, 0.01)
    """Of the table's top [m]."""
    joint_noise: Spread = Spread(0.02, 0.005)
    """Of the measured finger joints [rad]."""
    wrist_position_noise: Spread = Spread(0.003, 0.0005)
    """Of the measured wrist [m]."""
    wrist_rotation_noise: Spread = Spread(0.01, 0.002)
    """Of the measured wrist, per axis [rad]."""
    object_position_noise: Spread = Spread(0.004, 0.002)
    """Of the tracked object [m]."""
    object_rotation_noise: Spread = Spread(0.05, 0.02)
    """Of the tracked object, per axis, about its centre of mass [rad]."""
    observation_delay: Range = (0.0, 0.1)
    """Age of what the policy sees [s]."""
    action_delay: Range = (0.0, 0.1)
    """From the policy's decision to the servos [s]."""
    push_force: Range = (0.0, 2.0)
    """Of one push on the object's centre of mass, in a random direction [N]."""
    push_start: Range = (0.0, 3.0)
    """From the beginning of the lift to that push [s]."""
    push_duration: float = 0.2
    """[s]."""
    object_shift: float = 0.01
    """The object has moved on the table by up to this since the grasp was planned [m], anywhere in the
    disc."""
    object_turn: float = 0.1
    """And turned about the vertical by up to this, either way [rad]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            if value is None:
                continue
            numbers = (value.bias, value.jitter) if isinstance(value, Spread) else np.ravel(value)
            if not np.isfinite(numbers).all():
                raise FungraspError(f"randomisation: {name} must be finite, not {value}")
            if isinstance(value, tuple) and value[0] > value[1]:
                raise FungraspError(f"randomisation: {name} must rise from low to high, not {value}")
            if name in (*_SCALES, "friction") and min(numbers) <= 0:
                raise FungraspError(f"randomisation: {name} must be positive, not {value}")
            if name != "table_height" and min(numbers) < 0:
                raise FungraspError(f"randomisation: {name} must not be negative, not {value}")


NONE = Randomisation(
    damping=(1.0, 1.0),
    stiffness=(1.0, 1.0),
    servo_damping=(1.0, 1.0),
    wrist_stiffness=(1.0, 1.0),
    mass=(1.0, 1.0),
    friction=None,
    table_height=(0.0, 0.0),
    joint_noise=Spread(),
    wrist_position_noise=Spread(),
    wrist_rotation_noise=Spread(),
    object_position_noise=Spread(),
    object_rotation_noise=Spread(),
    observation_delay=(0.0, 0.0),
    action_delay=(0.0, 0.0),
    push_force=(0.0, 0.0),
    push_start=(0.0, 0.0),
    object_shift=0.0,
    object_turn=0.0,
)
"""Every world as the scene says."""

MILD = Randomisation(
    damping=(0.7, 1.4),
    stiffness=(0.85, 1.18),
    servo_damping=(0.85, 1.18),
    wrist_stiffness=(0.85, 1.18),
    mass=(0.7, 1.4),
    friction=(0.7, 1.0),
    table_height=(-0.005, 0.005),
    joint_noise=Spread(0.01, 0.003),
    wrist_position_noise=Spread(0.001, 0.0005),
    wrist_rotation_noise=Spread(0.005, 0.002),
    object_position_noise=Spread(0.002, 0.001),
    object_rotation_noise=Spread(0.02, 0.01),
    observation_delay=(0.0, 0.02),
    action_delay=(0.0, 0.02),
    push_force=(0.0, 1.0),
    object_shift=0.005,
    object_turn=0.05,
)
"""What a good policy can overcome without learning to expect the worst."""


@dataclass(frozen=True, eq=False)
class Sample:
    """What was drawn for W trials of a hand with M joints."""

    damping: np.ndarray
    """Factor for each joint, shape [W, M]."""
    stiffness: np.ndarray
    """Factor for the servo of each joint, shape [W, M]."""
    servo_damping: np.ndarray
    """Factor for the servo of each joint, shape [W, M]."""
    wrist_stiffness: np.ndarray
    """Factor, shape [W]."""
    mass: np.ndarray
    """Factor, shape [W]."""
    friction: np.ndarray | None
    """Shape [W]; the scene's if None."""
    table_height: np.ndarray
    """[m], shape [W]."""
    joint_bias: np.ndarray
    """[rad], shape [W, M]."""
    wrist_bias: np.ndarray
    """Offset [m], world frame, and rotation vector [rad], shape [W, 6]."""
    object_bias: np.ndarray
    """Offset [m], world frame, and rotation vector [rad], shape [W, 6]."""
    observation_delay: np.ndarray
    """[s], shape [W]."""
    action_delay: np.ndarray
    """[s], shape [W]."""
    push: np.ndarray
    """Force [N], world frame, shape [W, 3]."""
    push_start: np.ndarray
    """From the beginning of the lift [s], shape [W]."""
    push_duration: np.ndarray
    """[s], shape [W]."""
    object_shift: np.ndarray
    """In the table's plane, x and y [m] and a turn about the vertical [rad], shape [W, 3]."""

    def __len__(self) -> int:
        return len(self.mass)

    def select(self, rows: np.ndarray) -> Sample:
        """Some trials. rows: indices or flags."""
        return replace(self, **{name: value[rows] for name, value in self._arrays().items()})

    def replaced(self, rows: np.ndarray, other: Sample) -> Sample:
        """This sample with some trials drawn anew.

        Args:
            rows: indices, shape [I].
            other: I trials.

        Raises:
            FungraspError: only one of the two leaves the friction to the scene.
        """
        if (self.friction is None) != (other.friction is None):
            raise FungraspError("friction is randomised in one of the two samples only")
        arrays = {name: value.copy() for name, value in self._arrays().items()}
        for name, value in other._arrays().items():
            arrays[name][rows] = value
        return replace(self, **arrays)

    def _arrays(self) -> dict[str, np.ndarray]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def sample(randomisation: Randomisation, count: int, joints: int, rng: np.random.Generator) -> Sample:
    """Draw the differences of some trials.

    Args:
        randomisation: what to draw from.
        count: W, number of trials.
        joints: M, number of the hand's joints, coupled ones included.
        rng: the same state gives the same sample.
    """
    r = randomisation

    def factor(bounds: Range, *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(*np.log(bounds), size=(count, *shape)))

    def pose_bias(position: Spread, rotation: Spread) -> np.ndarray:
        return rng.normal(size=(count, 6)) * np.repeat([position.bias, rotation.bias], 3)

    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    around = rng.uniform(0.0, 2 * np.pi, count)
    distance = r.object_shift * np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(-r.object_turn, r.object_turn, count)
    return Sample(
        damping=factor(r.damping, joints),
        stiffness=factor(r.stiffness, joints),
        servo_damping=factor(r.servo_damping, joints),
        wrist_stiffness=factor(r.wrist_stiffness),
        mass=factor(r.mass),
        friction=None if r.friction is None else rng.uniform(*r.friction, size=count),
        table_height=rng.uniform(*r.table_height, size=count),
        joint_bias=rng.normal(size=(count, joints)) * r.joint_noise.bias,
        wrist_bias=pose_bias(r.wrist_position_noise, r.wrist_rotation_noise),
        object_bias=pose_bias(r.object_position_noise, r.object_rotation_noise),
        observation_delay=rng.uniform(*r.observation_delay, size=count),
        action_delay=rng.uniform(*r.action_delay, size=count),
        push=direction * rng.uniform(*r.push_force, size=(count, 1)),
        push_start=rng.uniform(*r.push_start, size=count),
        push_duration=np.full(count, r.push_duration),
        object_shift=np.stack([distance * np.cos(around), distance * np.sin(around), turn], axis=1),
    )
