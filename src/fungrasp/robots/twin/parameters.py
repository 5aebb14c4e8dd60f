"""True parameters of a twin, which are drawn from a seed and hidden from planner, policy and drivers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.hands import Hand
from fungrasp.robots.cell import RobotCell
from fungrasp.sim2real import random_stream


@dataclass(frozen=True)
class TwinSpread:
    """Distribution of a twin's parameters. Pairs are ranges: uniform, log-uniform for factors. Single numbers
    are largest magnitudes of errors, or constants.

    Object, table, tracker and calibration follow the reality protocol (docs/evaluate.md). The hand's ranges
    are our estimates, not measurements, and wide enough that plans for the model's servos are wrong.
    """

    stiffness: tuple[float, float] = (0.6, 1.1)
    """Factor on the torque constant of the hand's servos."""
    gain: tuple[float, float] = (1.0, 1.0)
    """Factor on stiffness and damping of all servos of the hand, as of another position controller."""
    damping: tuple[float, float] = (0.7, 2.0)
    """Factor on the damping of the hand's joints."""
    friction: tuple[float, float] = (0.02, 0.06)
    """Static friction of the hand's joints, as a share of the torque limit."""
    sliding: tuple[float, float] = (0.6, 0.9)
    """Sliding friction of the hand's joints, as a share of static friction (Stribeck)."""
    stribeck_speed: float = 0.1
    """Speed at which 63 % of the difference between both is gone [rad/s]."""
    torque_limit: tuple[float, float] = (0.85, 1.0)
    """Factor on the torque limits of the hand's servos."""
    armature: tuple[float, float] = (0.7, 1.5)
    """Factor on the rotor inertia of the hand's joints."""
    backlash: float = 0.01
    """Largest backlash of a hand joint, to each side [rad]."""
    encoder_bias: float = 0.01
    """Largest error of a hand joint's encoder [rad]."""
    encoder_step: float = 0.0015
    """Resolution of a hand joint's encoder [rad]: 0.088 degrees."""
    hand_delay: tuple[float, float] = (0.005, 0.03)
    """Delay of setpoints to the hand's servos [s]."""
    arm_delay: tuple[float, float] = (0.01, 0.03)
    """Delay of setpoints to the arm's servos [s]."""
    camera_position: float = 0.003
    """Largest error of the calibration's translation, per axis [m]."""
    camera_rotation: float = 0.017
    """Largest error of the calibration's rotation, about a random axis [rad]."""
    tracker_noise: tuple[float, float] = (0.001, 0.01)
    """Standard deviations of the tracker's white noise: position [m] and rotation [rad], per axis."""
    tracker_delay: tuple[float, float] = (0.06, 0.12)
    """Age of a tracked pose at its delivery [s]."""
    tracker_rate: float = 30.0
    """Frame rate of the tracker [Hz]."""
    tracker_dropout: float = 0.05
    """Share of missing frames."""
    mass: tuple[float, float] = (0.8, 1.25)
    """Factor on the object's mass."""
    center_of_mass: float = 0.1
    """Largest displacement of the center of mass along each axis, as a share of the object's size."""
    object_friction: tuple[float, float] = (0.7, 1.0)
    """Friction coefficient of hand, object and table."""
    surface: float = 0.001
    """Largest error of the object's surface [m]."""
    table_tilt: float = 0.0087
    """Largest tilt of the table [rad]."""
    table_height: float = 0.003
    """Largest error of the table's height [m]."""


@dataclass(frozen=True, eq=False)
class TwinParameters:
    """True parameters of one twin. The hand has M joints, with coupled ones, and U independent joints."""

    spread: TwinSpread
    """Distribution of the parameters, with its constants."""
    stiffness: np.ndarray
    """Factor on each servo's stiffness and damping, shape [U]: ``gain`` times that of its torque constant."""
    gain: float
    """Factor on the gains of all servos."""
    damping: np.ndarray
    """Factor on each joint's damping, shape [M]."""
    armature: np.ndarray
    """Factor on each joint's rotor inertia, shape [M]."""
    friction: np.ndarray
    """Static friction of each independent joint, as a share of its torque limit, shape [U]."""
    sliding: np.ndarray
    """Sliding friction, as a share of static friction, shape [U]."""
    torque_limit: np.ndarray
    """Factor on each servo's torque limit, shape [U]."""
    backlash: np.ndarray
    """Backlash of each independent joint, to each side [rad], shape [U]."""
    encoder_bias: np.ndarray
    """Error of each encoder [rad], shape [U]."""
    hand_delay: float
    """Delay of setpoints to the hand's servos [s]."""
    arm_delay: float
    """Delay of setpoints to the arm's servos [s]."""
    camera_error: np.ndarray
    """Pose of the true world frame in the believed one, shape [7]."""
    tracker_delay: float
    """Age of a tracked pose at its delivery [s]."""
    mass: float
    """Factor on the object's mass."""
    center_of_mass: np.ndarray
    """Displacement of the center of mass, as a share of the object's size, shape [3]."""
    object_friction: float
    """Friction coefficient of hand, object and table."""
    table_tilt: np.ndarray
    """Rotation vector of the table, world frame [rad], shape [3]."""
    table_height: float
    """Height of the table top at the origin [m]."""


def draw_twin(seed: int, joints: int, driven: int, spread: TwinSpread | None = None) -> TwinParameters:
    """Draw the parameters of a twin. joints: M; driven: U; spread: distribution; the default if None."""
    s, rng = spread or TwinSpread(), random_stream("twin", seed)

    # A separate stream, so that the other parameters do not depend on this one.
    gain = float(np.exp(random_stream("twin gain", seed).uniform(*np.log(s.gain))))

    def factor(bounds: tuple[float, float], *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(*np.log(bounds), size=shape))

    direction = rng.normal(size=3)
    turn = rng.uniform(-s.camera_rotation, s.camera_rotation) * direction / np.linalg.norm(direction)
    tilt, around = rng.uniform(0, s.table_tilt), rng.uniform(0, 2 * np.pi)
    offset = rng.uniform(-s.camera_position, s.camera_position, 3)
    return TwinParameters(
        spread=s,
        stiffness=gain * factor(s.stiffness, driven),
        gain=gain,
        damping=factor(s.damping, joints),
        armature=factor(s.armature, joints),
        friction=rng.uniform(*s.friction, driven),
        sliding=rng.uniform(*s.sliding, driven),
        torque_limit=factor(s.torque_limit, driven),
        backlash=rng.uniform(0, s.backlash, driven),
        encoder_bias=rng.uniform(-s.encoder_bias, s.encoder_bias, driven),
        hand_delay=float(rng.uniform(*s.hand_delay)),
        arm_delay=float(rng.uniform(*s.arm_delay)),
        camera_error=np.concatenate([offset, quaternion_from_rotation_vector(turn)]),
        tracker_delay=float(rng.uniform(*s.tracker_delay)),
        mass=float(factor(s.mass)),
        center_of_mass=rng.uniform(-s.center_of_mass, s.center_of_mass, 3),
        object_friction=float(rng.uniform(*s.object_friction)),
        table_tilt=tilt * np.array([np.cos(around), np.sin(around), 0.0]),
        table_height=float(rng.uniform(-s.table_height, s.table_height)),
    )


def cell_twin(cell: RobotCell, hand: Hand, seed: int, spread: TwinSpread | None = None) -> TwinParameters:
    """Draw the parameters of a cell's twin. The option ``gain`` of the cell's hand replaces that of
    ``spread``, which is the default if None. Raises: FungraspError: ``gain`` is no range of positive factors.
    """
    s, given = spread or TwinSpread(), cell.hand_device.options.get("gain")
    if given is not None:
        numbers = [n for n in given if isinstance(n, int | float)] if isinstance(given, list) else []
        if len(numbers) != 2 or not 0 < numbers[0] <= numbers[1] < np.inf:
            raise FungraspError(
                f"cell '{cell.name}': the option 'gain' of a twin's hand is two positive factors, the "
                f"smaller first, not {given!r}"
            )
        s = replace(s, gain=(float(numbers[0]), float(numbers[1])))
    return draw_twin(seed, len(hand.joint_names), len(hand.actuators), s)


def twin_torque_limits(cell: RobotCell, hand: Hand) -> np.ndarray:
    """Return the torque limits of the driver of a twin's hand [N m], shape [U]: the option ``torque_limits``
    of the cell's hand, one number or one for each servo; infinite without it. Raises: FungraspError: an
    invalid option."""
    given, count = cell.hand_device.options.get("torque_limits", np.inf), len(hand.actuators)
    numbers = given if isinstance(given, list) else [given] * count
    if len(numbers) != count or not all(isinstance(n, int | float) and n > 0 for n in numbers):
        raise FungraspError(
            f"cell '{cell.name}': the option 'torque_limits' of a twin's hand is a positive number [N m], or "
            f"{count} of them, not {given!r}"
        )
    return np.array(numbers, dtype=float)
