"""Rehearsal of a plan with a perfect robot: the safety filter checks every setpoint before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import PreparedGrasp, Preparer
from fungrasp.deployment.scripted_motion import ARRIVED
from fungrasp.deployment.spec import DeploymentSpec, Phase
from fungrasp.geometry.poses import compose, relative
from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.device import (
    Clock,
    DeviceStatus,
    JointDriver,
    JointState,
    PoseSource,
    RobotCommand,
    RobotState,
    StopKind,
    TrackedPose,
    TrackingStatus,
)
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch

LOOK_TIME = 0.1
"""Time in which poses of the object are collected [s]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The whole motion of a plan at full speed: T setpoints, 20 ms apart."""

    times: np.ndarray
    """Time since the first setpoint [s], shape [T]."""
    phases: np.ndarray
    """Phase of each setpoint, shape [T] str."""
    arm: np.ndarray
    """Joints of the arm [rad], shape [T, A]."""
    fingers: np.ndarray
    """Independent joints of the hand [rad], shape [T, U]. The object stops them at their grasp angles."""
    palm: np.ndarray
    """Palm poses, world frame, shape [T, 7]."""
    object_pose: np.ndarray
    """Object poses, world frame, shape [T, 7]; fixed to the palm from the lift until the object is down."""


def rehearse(robot: Robot, grasp: RobotGraspSet, prepared: PreparedGrasp) -> Motion:
    """Rehearse a plan from the move to the start until home, without corrections by a policy with feedback.
    robot: connected, at the joints where the plan begins; it is only read. Raises: FungraspError: the safety
    filter would stop the plan."""
    clock, plan = _SteppedClock(), prepared.plan
    closing = _PerfectJoints(robot.hand_driver, clock)
    rehearsed = Robot(
        robot.cell,
        robot.hand,
        _PerfectJoints(robot.arm, clock),
        closing,
        _StandingObject(plan.object_pose[0], clock),
        clock,
        compensate=False,
        switch=StopSwitch(),
    )
    record = _Record(rehearsed, closing, prepared)
    with rehearsed:
        spec = DeploymentSpec(look_time=LOOK_TIME)
        result = Deployment(rehearsed, OpenLoopPolicy(), _Planned(prepared), spec, [record]).run(grasp)
    rows = record.rows
    if result.fault:
        during = f" while '{rows[-1][1]}'" if rows else ""
        raise FungraspError(f"the safety filter would stop this plan{during}: {result.fault}")
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    # A phase may begin at the time of the previous phase's last setpoint: keep the later one.
    last = np.append(np.diff(columns[0]) > 0, True)
    times, phases, joints, closed, palms = (column[last] for column in columns)
    pose = _carried(plan.object_pose[0], palms, phases)
    return Motion(times - times[0], phases, joints, closed, palms, pose)


def _carried(rest: np.ndarray, palm: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return the object poses [T, 7]: fixed to the palm [T, 7] from the lift until the palm is down again."""
    held = np.flatnonzero(np.isin(phases, [Phase.LIFT, Phase.HOLD, Phase.PUT_DOWN]))
    pose = np.tile(rest, (len(palm), 1))
    first = palm[held[0] - 1]
    apart = np.linalg.norm(palm[held, :3] - first[:3], axis=1)
    down = (phases[held] == Phase.PUT_DOWN) & (apart < ARRIVED)
    held = held[: int(np.argmax(down))]
    pose[held] = compose(palm[held], relative(first, rest))
    return pose


class _Record(DeploymentObserver):
    """Keeps time, phase, joints of arm and hand, and palm pose of every setpoint."""

    def __init__(self, robot: Robot, closing: _PerfectJoints, prepared: PreparedGrasp):
        self._robot, self._closing, self._prepared = robot, closing, prepared
        self.rows: list[tuple[float, str, np.ndarray, np.ndarray, np.ndarray]] = []

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        plan, now = self._prepared.plan, self._robot.clock.now()
        closing = float(plan.closing_step[0]) * plan.control_period
        if phase is Phase.GRASP and self._robot.plan_time(now) >= closing - 1e-9:
            self._closing.stop_at(plan.grasp_joints[0], self._prepared.start_fingers)
        self.rows.append((now, phase, command.arm, self._closing.positions.copy(), command.palm))


class _Planned(Preparer):
    """Returns a given plan."""

    objects: Mapping[str, ObjectModel] = {}

    def __init__(self, prepared: PreparedGrasp):
        self._prepared = prepared

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        return self._prepared


class _SteppedClock(Clock):
    """A clock on which waiting takes no time."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep_until(self, when: float) -> None:
        self._now = max(self._now, when)


class _Unconnected:
    """Methods of a device without a connection."""

    def connect(self) -> None: ...

    def take_control(self) -> None: ...

    def stop(self, kind: StopKind = StopKind.HOLD) -> None: ...

    def close(self) -> None: ...


class _PerfectJoints(_Unconnected, JointDriver):
    """Joints that reach each command at once, unless something stops them."""

    def __init__(self, driver: JointDriver, clock: _SteppedClock):
        """driver: gives the limits and the initial positions."""
        self.name, self._clock, self.limits = driver.name, clock, driver.limits
        self.takes_feedforward, self.lets_go = False, ""
        self._low, self._high = driver.limits.lower, driver.limits.upper
        self.positions = np.clip(driver.read().positions, self._low, self._high)
        """Current positions [rad], shape [U]."""

    def stop_at(self, held: np.ndarray, free: np.ndarray) -> None:
        """From now on, limit joints to the range of their held, free and current positions [rad], shape [U]
        each; the first call counts."""
        if self._low is self.limits.lower:
            both = np.array([held, free, self.positions])
            self._low, self._high = both.min(axis=0), both.max(axis=0)

    def read(self) -> JointState:
        now = self._clock.now()
        return JointState(self.positions, np.zeros_like(self.positions), None, now, now, DeviceStatus.READY)

    def command(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> np.ndarray:
        sent = np.clip(positions, self.limits.lower, self.limits.upper)
        self.positions = np.clip(sent, self._low, self._high)
        return sent


class _StandingObject(_Unconnected, PoseSource):
    """A tracker that sees the object at its pose in the plan."""

    def __init__(self, pose: np.ndarray, clock: _SteppedClock):
        self.name, self._clock, self._pose = "the plan's object", clock, pose

    def read(self) -> TrackedPose:
        return TrackedPose(self._pose, self._clock.now(), 1.0, TrackingStatus.TRACKING)
