"""Joints of the arm that follow a moving palm, on one branch of solutions: differential inverse kinematics by
``mink`` (extra ``deploy``)."""

from __future__ import annotations

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import relative, rotation_vector
from fungrasp.robots.kinematics.arm_model import ArmKinematics

ITERATIONS = 4
"""Steps of the solver for each setpoint; the palm moves by 5 mm at most between two."""

ARRIVED = 1e-5
"""Error at which it stops [m, rad]."""


class PalmFollower:
    """Joints for one palm pose after another. Each step minimises ``|J dq - e|^2 + damping |dq|^2`` within
    the limits of position and speed, e being the pose error; the damping keeps steps small near
    singularities."""

    def __init__(self, kinematics: ArmKinematics, speed: float):
        """
        Args:
            kinematics: of the arm.
            speed: largest speed of a joint [rad/s].

        Raises:
            FungraspError: mink is not installed.
        """
        try:
            import mink
        except ImportError as error:
            raise FungraspError('moving an arm needs mink: pip install "fungrasp[deploy]"') from error
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
        """Joints a setpoint later.

        Args:
            pose: of the palm, world frame, shape [7].
            period: time until it should be there [s].

        Returns:
            joints [rad], shape [M]; what is left of the error: position [m] and rotation [rad].
        """
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
