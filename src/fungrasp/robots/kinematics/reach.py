"""Inverse kinematics of an arm: all postures for a palm pose; the posture that follows a moving palm, by
``mink`` (extra ``deploy``); and the best initial posture for a path of the palm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import norm, quaternion_conjugate, quaternion_multiply, relative, rotation_vector
from fungrasp.robots.cell import RobotCell, plan_speed
from fungrasp.robots.kinematics.arm_model import CLEAR, MARGIN, ArmKinematics, ClearanceModel, outside

DAMPING = 0.02
"""Damping of the least-squares steps, in units of the Jacobian."""

LARGEST_STEP = 0.5
"""Largest change of a joint in one step [rad]."""

STEPS = 40
"""Largest number of steps from each start; successful ones take about ten."""

TOLERANCE = 1e-4
"""Largest error of a posture [m, rad]."""

SAME = 0.05
"""Largest difference of a joint between equal postures [rad]."""


def arm_postures(kinematics: ArmKinematics, pose: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Solve the inverse kinematics by damped least squares from each start.

    Args:
        pose: palm pose, world frame, shape [7].
        starts: initial joints [rad], shape [S, M].

    Returns:
        different postures within the joint limits [rad], shape [P, M]; joints are within a half turn of zero.
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
    """Return random postures [rad], shape [count, M], uniform within a half turn and the joint limits."""
    low, high = np.maximum(kinematics.lower, -np.pi), np.minimum(kinematics.upper, np.pi)
    return rng.uniform(low, high, (count, len(low)))


def _error(pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Return translation [m] and rotation vector [rad] from a pose to a goal, world frame, shape [6]."""
    turn = quaternion_multiply(goal[3:], quaternion_conjugate(pose[3:]))
    return np.concatenate([goal[:3] - pose[:3], rotation_vector(turn / norm(turn))])


def _unwound(joints: np.ndarray, kinematics: ArmKinematics) -> np.ndarray:
    """Turn joints to within a half turn of zero, then clip them to the limits."""
    turned = (joints + np.pi) % (2 * np.pi) - np.pi
    return np.clip(turned, kinematics.lower, kinematics.upper)


ITERATIONS = 4
"""Steps of the solver for each setpoint; the palm moves by at most 5 mm between two setpoints."""

ARRIVED = 1e-5
"""Error at which the solver stops [m, rad]."""


class PalmFollower:
    """Follows palm poses with the arm. Each step minimizes ``|J dq - e|^2 + damping |dq|^2`` for the pose
    error e, within the limits of position and speed; damping keeps steps small near singularities."""

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
        """Start at a posture; its branch of solutions is kept. joints: [rad], shape [M]."""
        self._configuration.update(joints)

    @property
    def joints(self) -> np.ndarray:
        """Current solution [rad], shape [M]."""
        return self._configuration.q.copy()

    def follow(self, pose: np.ndarray, period: float) -> tuple[np.ndarray, float, float]:
        """Follow to the next palm pose. pose: world frame, shape [7]; period: time of the motion [s].
        Returns: joints [rad], shape [M]; remaining errors of position [m] and rotation [rad]."""
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


STARTS = 48
"""Number of random starts for the solutions of a pose; 32 find all eight of a UR5e."""

LEAST_MANIPULABILITY = 0.04
"""Smallest manipulability (``ArmKinematics.manipulability``) along a path."""

TABLE_ROOM = 0.005
"""Additional distance of planned motions from table and obstacles, half of it for the hand [m]: policies
correct the palm by some millimeters, and finger readings are not exact."""

LARGEST_ERROR = 0.002
"""Largest error of the palm's position along a path [m]; that of the rotation [rad] is ten times as large."""

PATIENT = 50
"""Factor on the time of a step to tell an arm that is too slow from one that is too short."""

OUT_OF_REACH = "the start is out of the arm's reach"


@dataclass(frozen=True, eq=False)
class PalmPath:
    """Path of palm and fingers, T steps."""

    palm: np.ndarray
    """Palm poses, world frame, shape [T, 7]."""
    fingers: np.ndarray
    """Independent joints [rad], shape [T, U]."""
    period: float
    """Time between two steps [s]."""


@dataclass(frozen=True, eq=False)
class Reach:
    """How well an arm follows a path from an initial posture."""

    start: np.ndarray
    """Initial posture [rad], shape [M]."""
    end: np.ndarray
    """Last posture reached [rad], shape [M]."""
    margin: float
    """Smallest of self-clearance, manipulability and distance from joint limits along the path, each as a
    share of a comfortable value. Negative if the path can't be followed: minus the share that is left."""
    obstacle: str
    """What prevents the motion, as a phrase; "" if nothing."""


class ReachChecker:
    """Checks whether the arm of a robot can follow paths of the palm."""

    def __init__(
        self, cell: RobotCell, kinematics: ArmKinematics, clearance: ClearanceModel, rng: np.random.Generator
    ):
        """rng: source of random starts."""
        self._cell, self._kinematics, self._clearance, self._rng = cell, kinematics, clearance, rng
        # Plans are checked at full speed; ``plan_speed`` slows them down later.
        self._follower = PalmFollower(kinematics, cell.limits.arm_speed / plan_speed(cell.limits))

    def possible(self, path: PalmPath, home: np.ndarray) -> str:
        """Return what prevents a path from any posture, apart from the hand at the table, as a phrase; "" if
        it can be followed. Faster than ``best``. home: additional start for solutions [rad], shape [M]."""
        beyond = outside(path.palm, self._cell.workspace)
        if beyond:
            return beyond
        nearest = Reach(np.zeros(0), np.zeros(0), -2.0, OUT_OF_REACH)
        for posture in self._postures(path, home, STARTS // 2):
            reach = self.follow(path, posture, hand_matters=False)
            if not reach.obstacle:
                return ""
            nearest = max(nearest, reach, key=lambda r: r.margin)
        return nearest.obstacle

    def best(self, path: PalmPath, home: np.ndarray) -> tuple[list[Reach], str]:
        """Return the postures from which the path can be followed, best first, and what prevents the best of
        the others, "" if a posture was found. home: current posture [rad], shape [M]; among equally good
        postures, nearer ones come first."""
        beyond = outside(path.palm, self._cell.workspace)
        if beyond:
            return [], beyond
        tried = [self.follow(path, posture) for posture in self._postures(path, home)]
        free = [reach for reach in tried if not reach.obstacle]
        free.sort(key=lambda r: min(r.margin, 0.5) - 0.05 * float(np.abs(r.start - home).max()), reverse=True)
        if free:
            return free, ""
        return [], max(tried, key=lambda reach: reach.margin).obstacle if tried else OUT_OF_REACH

    def followed(self, paths: Sequence[PalmPath], home: np.ndarray) -> np.ndarray:
        """Return whether the arm can follow N paths with the same initial pose, from any posture, shape [N]
        bool. home: current posture [rad], shape [M]."""
        postures = list(self._postures(paths[0], home))
        can = np.zeros(len(paths), dtype=bool)
        for i, path in enumerate(paths):
            if outside(path.palm, self._cell.workspace):
                continue
            for number, posture in enumerate(postures):
                if not self.follow(path, posture).obstacle:
                    # A posture that serves one path serves most others.
                    postures.insert(0, postures.pop(number))
                    can[i] = True
                    break
        return can

    def _postures(self, path: PalmPath, home: np.ndarray, count: int = STARTS) -> np.ndarray:
        """Return initial postures of a path, found from home and ``count`` random starts."""
        starts = np.concatenate([home[None], random_starts(self._kinematics, count, self._rng)])
        return arm_postures(self._kinematics, path.palm[0], starts)

    def follow(self, path: PalmPath, posture: np.ndarray, hand_matters: bool = True) -> Reach:
        """Follow a path from an initial posture [rad], shape [M]. hand_matters: whether to check the distance
        of the hand from the table."""
        k, c, box = self._kinematics, self._cell, self._cell.workspace
        follower, margin, joints = self._follower, np.inf, posture
        follower.begin(posture)
        for step, (palm, fingers) in enumerate(zip(path.palm, path.fingers, strict=True)):
            joints, place, turn = follower.follow(palm, path.period)
            gap = self._clearance.measure(joints, fingers)
            share = k.manipulability(joints)
            ends = float(np.minimum(joints - k.lower, k.upper - joints).min())
            obstacle = ""
            if place > LARGEST_ERROR or turn > 10 * LARGEST_ERROR:
                _, place, turn = follower.follow(palm, PATIENT * path.period)
                far = place > LARGEST_ERROR or turn > 10 * LARGEST_ERROR
                speed = f"a joint of the arm would move faster than limits.arm_speed = {c.limits.arm_speed:g}"
                obstacle = "the arm can't reach that far" if far else speed
            elif near := (gap if hand_matters else replace(gap, hand=MARGIN)).fault(box, TABLE_ROOM, CLEAR):
                obstacle = near
            elif share < LEAST_MANIPULABILITY:
                obstacle = "the arm would be near a singularity"
            if obstacle:
                return Reach(posture, joints, step / len(path.palm) - 1.0, obstacle)
            margin = min(margin, gap.itself / MARGIN, share / 0.2, ends / 0.5)
        return Reach(posture, joints, margin, "")
