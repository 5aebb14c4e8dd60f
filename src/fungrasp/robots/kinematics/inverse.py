"""Joints of an arm from poses of the palm: all postures that reach one, found from many starts, and those
that follow a moving palm on one branch, by ``mink`` (extra ``deploy``)."""

from __future__ import annotations

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import norm, quaternion_conjugate, quaternion_multiply, relative, rotation_vector
from fungrasp.robots.kinematics.arm_model import ArmKinematics

DAMPING = 0.02
"""Of the least-squares steps, in units of the Jacobian's."""

LARGEST_STEP = 0.5
"""Longest change of a joint in one step [rad]."""

STEPS = 40
"""Steps from each start; those that reach a pose do so in about ten."""

TOLERANCE = 1e-4
"""Largest error of a posture [m, rad]."""

SAME = 0.05
"""Postures closer than this are the same [rad]."""


def arm_postures(kinematics: ArmKinematics, pose: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Postures with the palm at a pose, by damped least squares from each start.

    Args:
        pose: of the palm, world frame, shape [7].
        starts: joints to start from [rad], shape [S, M].

    Returns:
        Different postures within the joint limits [rad], shape [P, M], all joints within a half turn of zero
        where the limits allow it.
    """
    found: list[np.ndarray] = []
    for start in starts:
        joints = start.copy()
        for _ in range(STEPS):
            error = _error(kinematics.palm_pose(joints), pose)
            if np.abs(error).max() < 0.1 * TOLERANCE:
                break
            jacobian = kinematics.jacobian(joints)
            normal = jacobian @ jacobian.T + DAMPING**2 * min(1.0, float(error @ error)) * np.eye(6)
            step = jacobian.T @ np.linalg.solve(normal + 1e-9 * np.eye(6), error)
            joints = joints + step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        joints = _unwound(joints, kinematics)
        if np.abs(_error(kinematics.palm_pose(joints), pose)).max() > TOLERANCE:
            continue
        if not any(np.abs(joints - other).max() < SAME for other in found):
            found.append(joints)
    return np.reshape(found, (-1, len(kinematics.lower)))


def random_starts(kinematics: ArmKinematics, count: int, rng: np.random.Generator) -> np.ndarray:
    """Postures to start from [rad], shape [count, M]: uniform within a half turn and the joint limits."""
    low, high = np.maximum(kinematics.lower, -np.pi), np.minimum(kinematics.upper, np.pi)
    return rng.uniform(low, high, (count, len(low)))


def _error(pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """From a pose to a goal: translation [m] and rotation vector [rad], world frame, shape [6]."""
    turn = quaternion_multiply(goal[3:], quaternion_conjugate(pose[3:]))
    return np.concatenate([goal[:3] - pose[:3], rotation_vector(turn / norm(turn))])


def _unwound(joints: np.ndarray, kinematics: ArmKinematics) -> np.ndarray:
    """The same posture within a half turn of zero, and within the limits as far as that is possible."""
    turned = (joints + np.pi) % (2 * np.pi) - np.pi
    return np.clip(turned, kinematics.lower, kinematics.upper)


ITERATIONS = 4
"""Steps of the solver for each setpoint; the palm moves by 5 mm at most between two."""

ARRIVED = 1e-5
"""Error at which it stops [m, rad]."""


class PalmFollower:
    """Joints for one palm pose after another. Each step minimizes ``|J dq - e|^2 + damping |dq|^2`` within
    the limits of position and speed, e being the pose error; the damping keeps steps small near
    singularities."""

    def __init__(self, kinematics: ArmKinematics, speed: float):
        """speed: largest speed of a joint [rad/s]. Raises: FungraspError: mink is not installed."""
        try:
            import mink
        except ImportError as error:
            raise FungraspError('moving an arm needs mink: pip install ".[deploy]" in the clone') from error
        self._mink, self._kinematics = mink, kinematics
        model = kinematics.model
        self._configuration = mink.Configuration(model)
        site = model.site(model.nsite - 1).name
        self._task = mink.FrameTask(site, "site", position_cost=2.0, orientation_cost=1.0, lm_damping=1e-6)
        names = [model.joint(i).name for i in range(model.njnt)]
        self._limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, {name: np.array([speed]) for name in names}),
        ]

    def begin(self, joints: np.ndarray) -> None:
        """Start at a posture, whose branch is kept. joints: [rad], shape [M]."""
        self._configuration.update(joints)

    @property
    def joints(self) -> np.ndarray:
        """Where the arm is to be [rad], shape [M]."""
        return self._configuration.q.copy()

    def follow(self, pose: np.ndarray, period: float) -> tuple[np.ndarray, float, float]:
        """Joints a setpoint later. pose: of the palm, world frame, shape [7]; period: time until it should be
        there [s]. Returns: joints [rad], shape [M]; what is left of the error: position [m] and rotation
        [rad]."""
        mink = self._mink
        self._task.set_target(mink.SE3(np.concatenate([pose[3:], pose[:3]])))
        place = turn = np.inf
        for left in range(ITERATIONS, -1, -1):
            error = relative(self._kinematics.palm_pose(self._configuration.q), pose)
            place = float(np.linalg.norm(error[:3]))
            turn = float(np.linalg.norm(rotation_vector(error[3:])))
            if not left or max(place, turn) < ARRIVED:
                break
            step = period / ITERATIONS
            velocity = mink.solve_ik(
                self._configuration, [self._task], step, "daqp", damping=1e-9, limits=self._limits
            )
            self._configuration.integrate_inplace(velocity, step)
        return self.joints, place, turn
