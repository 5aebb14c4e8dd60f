"""The phases of one grasp on a robot, from idle to home, and the 10 Hz loop of the policy."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment_result import DeadlineMonitor, DeploymentResult
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import PreparedGrasp, Preparer
from fungrasp.deployment.scripted_motion import ScriptedMotion, locate_object
from fungrasp.deployment.spec import LAST_PHASES, DeploymentSpec, Phase
from fungrasp.grasps import RobotGraspSet
from fungrasp.planning.attempts import AttemptCarrier, make_attempts
from fungrasp.robots.device import DeviceStatus, RobotCommand, RobotError, RobotState, SafetyStop, StopKind
from fungrasp.robots.robot import Robot
from fungrasp.robots.safety import action_problem, check_pose
from fungrasp.task import Policy
from fungrasp.task.attempt_judge import AttemptJudge

MOVED = 0.02
"""Change of an arm joint beyond which the arm has moved [rad]."""

AWAKE = 1.0
"""Time within which drivers that held without readings follow again [s]."""


class Deployment(AttemptCarrier):
    """Carries one grasp through all phases. Errors end in FAULT with the robot stopped; only errors of the
    first plan are raised instead. For ``make_attempts``, this robot is the only world, with index 0."""

    def __init__(
        self,
        robot: Robot,
        policy: Policy,
        preparer: Preparer,
        spec: DeploymentSpec | None = None,
        observers: Sequence[DeploymentObserver] = (),
    ):
        """
        Args:
            robot: connected.
            spec: settings, of which attempts, until, speed and look_time are used; the defaults if None.
            observers: notified of all events, in this order.

        Raises:
            FungraspError: the speed is not allowed (``Robot.slow_down``).
        """
        self.robot, self.policy, self._preparer = robot, policy, preparer
        self.spec, self._observers = DeploymentSpec.given(spec), observers
        self.phase, self.fault = Phase.IDLE, ""
        """The current phase, and the reason of FAULT, as a phrase."""
        late = robot.cell.watchdog.late_tick
        self.ticks, self.setpoint_ticks = DeadlineMonitor(late), DeadlineMonitor(late)
        robot.slow_down(self.spec.speed)
        self.scripted = ScriptedMotion(robot, self.ticks)
        """Motions without the policy."""
        self._times: dict[str, float] = {}
        self._prepared: PreparedGrasp | None = None
        self._object_pose = np.full(7, np.nan)
        self._last_goal = np.full((1, 7), np.nan)
        self._attempts, self._missed, self._why_no_more = 0, False, ""
        self._grasp: RobotGraspSet | None = None
        self._state: RobotState | None = None
        self._gap = np.zeros(1)
        self._postures: list[np.ndarray] = []

    def run(self, grasp: RobotGraspSet) -> DeploymentResult:
        """Carry out all phases with one grasp. Faults of the robot are in the result; unexpected errors stop
        the robot and are raised. Raises: FungraspError: the grasp can't be planned or reached, or this
        deployment has run already, as faults are latched. Nothing has moved then."""
        if self.phase is not Phase.IDLE:
            said = f" ({self.fault})" if self.fault else ""
            raise RobotError(f"the robot is in the state '{self.phase}'{said}: look at it, then start again")
        robot, self._grasp = self.robot, grasp
        robot.watch = self._watch
        robot.due = lambda planned: self.setpoint_ticks.record(planned, robot.clock.now())
        try:
            self._times[Phase.IDLE] = robot.clock.now()
            object_pose, state = locate_object(robot, self.spec.look_time)
            self._prepare(object_pose, state.arm.positions)
            if self.goes_on_to(Phase.MOVE_TO_START):
                self._carry_out(grasp.object_name.tolist(), object_pose, state)
            else:
                self.phase = Phase.DONE
        except SafetyStop as stop:
            self._fail(stop.reason, stop.kind)
        except RobotError as error:
            self._fail(str(error), StopKind.HOLD)
        except FungraspError:
            # Errors of planning before anything has moved are not faults.
            if self.phase is Phase.IDLE:
                raise
            self._fail("an unexpected error", StopKind.HOLD)
            raise
        except OSError as error:
            self._fail(f"the log can't be written: {error.strerror or error}", StopKind.HOLD)
        except KeyboardInterrupt as error:
            self._fail(f"interrupted ({str(error) or 'Ctrl-C'})", StopKind.HOLD)
        except BaseException as error:
            # A programming error: the robot stops before the error is reported.
            self._fail(f"{type(error).__name__}: {error}", StopKind.HOLD)
            raise
        finally:
            gc.unfreeze()
        return DeploymentResult(
            self.spec,
            self.phase,
            self.fault,
            self._prepared,
            self.ticks,
            self.setpoint_ticks,
            self._attempts,
            self._missed,
            self._why_no_more,
            dict(self._times),
            dict(self.robot.guard.longest_silence),
        )

    def _carry_out(self, names: list[str], object_pose: np.ndarray, state: RobotState) -> None:
        """Carry out the phases with motion. names: name of the object, length 1."""
        robot = self.robot
        self._ask(Phase.MOVE_TO_START)
        self._postures = [self._awake(state).arm.positions]
        make_attempts(self, self.spec.attempts, object_pose[None], names, self._preparer.objects)
        if not self._missed and self.goes_on_to(Phase.PUT_DOWN):
            self._ask(Phase.PUT_DOWN)
            self._begin(Phase.PUT_DOWN)
            self.scripted.put_down(self.prepared, self._last_goal)
        if not (self._missed or self.goes_on_to(Phase.HOME)):
            robot.stop()
            self.phase = Phase.DONE
            return
        self._ask(Phase.HOME)
        self._begin(Phase.HOME)
        back = [robot.palm_follower_joints, *self._postures[-2::-1]]
        self.scripted.move(back, self.prepared.start_fingers)
        self._begin(Phase.DONE)

    def goes_on_to(self, phase: Phase) -> bool:
        """Return whether ``spec.until`` includes a phase."""
        order = list(Phase)
        return order.index(phase) <= order.index(LAST_PHASES[self.spec.until])

    @property
    def may_hold(self) -> bool:
        """Whether the hand may hold something: the robot has moved, and it did not end in DONE before the
        grasp or after the release."""
        if Phase.MOVE_TO_START not in self._times:
            return False
        empty = Phase.GRASP not in self._times or any(p in self._times for p in (Phase.PUT_DOWN, Phase.HOME))
        return not (self.phase is Phase.DONE and empty)

    @property
    def prepared(self) -> PreparedGrasp:
        """The latest plan; exists after planning only."""
        assert self._prepared is not None
        return self._prepared

    def _begin(self, phase: Phase) -> None:
        self.phase = phase
        now = self._times[phase] = self.robot.clock.now()
        for observer in self._observers:
            observer.phase(now, phase)

    def _fail(self, reason: str, kind: StopKind) -> None:
        self.robot.stop(kind)
        self.phase, self.fault = Phase.FAULT, reason
        now = self.robot.clock.now()
        self._times.setdefault(Phase.FAULT, now)
        for observer in self._observers:
            # The log or the terminal may itself have failed.
            with suppress(Exception):
                observer.fault(now, reason)

    def _prepare(self, object_pose: np.ndarray, arm: np.ndarray, attempt: int = 0) -> None:
        assert self._grasp is not None, "run() comes first"
        prepared = self._preparer.prepare(self._grasp, object_pose, arm, attempt=attempt)
        self._prepared, self._object_pose = prepared, object_pose
        for observer in self._observers:
            observer.planned(self.robot, prepared)
        # Garbage collection of everything made so far would take 0.1 s or more while the robot moves.
        gc.freeze()

    def _awake(self, state: RobotState) -> RobotState:
        """Return the state once all devices follow again after planning. Drivers without readings hold, and
        follow again once they are read. Any other stop is latched, as a person must look. Raises: RobotError:
        a device stopped, or the arm or the object moved."""
        robot, waited = self.robot, self.robot.clock.now() + AWAKE
        while True:
            robot.check_switch()
            now = robot.state()
            joints = {"arm": now.arm, "hand": now.hand}
            for name, said in joints.items():
                if said.status is DeviceStatus.READY:
                    continue
                if said.status is not DeviceStatus.STOPPED or robot.clock.now() > waited:
                    why = f"{said.status}: {said.message}" if said.message else said.status
                    raise RobotError(f"the {name} stopped while the grasp was planned ({why}): start again")
            problem = check_pose(now.tracked, self._object_pose, now.time, robot.cell)
            if problem and robot.clock.now() > waited:
                raise RobotError(f"{problem} while the grasp was planned: start again")
            if not problem and all(said.status is DeviceStatus.READY for said in joints.values()):
                break
            robot.clock.sleep_until(robot.clock.now() + 0.02)
        if np.abs(now.arm.positions - state.arm.positions).max() > MOVED:
            raise RobotError("the arm was moved while the grasp was planned: start again")
        robot.take_control()
        return now

    def _ask(self, phase: Phase) -> float:
        """Ask the observers whether a phase may begin; return the time that this took [s]. Meanwhile the
        robot stands still and is monitored as in motion."""
        robot, moving = self.robot, Phase.MOVE_TO_START in self._times
        asked = when = robot.now()

        def meanwhile() -> None:
            nonlocal when
            # The last setpoint of the previous phase may have been sent just now.
            when += robot.setpoints.period
            robot.wait(when)
            robot.check_switch()
            if moving:
                robot.send(robot.palm_follower_joints, robot.setpoints.fingers[0])
            else:
                robot.state()

        for observer in self._observers:
            observer.confirm(phase, meanwhile)
        if moving and when > asked:
            robot.wait(when + robot.setpoints.period)
        return robot.now() - asked

    def _follow_policy(self, judge: AttemptJudge | None) -> None:
        """Grasp, lift and hold with the policy. judge: watches the attempt, if not None."""
        robot, p, plan = self.robot, self.robot.protocol, self.prepared.plan
        self._ask(Phase.GRASP)
        self._begin(Phase.GRASP)
        state = robot.state()
        start, step, held_since = robot.begin(state, p.lift_height), 0, np.inf
        closing = float(plan.closing_step[0]) * plan.control_period
        while True:
            now = self.scripted.wait_for_tick(start, step)
            if now - held_since >= p.hold_time - 1e-6:
                return
            if step:
                state = robot.state()
            if robot.plan_time(state.time) < closing:
                self._check_object(state)
            observation = robot.observation(state)
            if judge is not None:
                judge.watch(observation)
            if not step:
                self.policy.reset(plan, observation)
            action = self.policy.act(observation)
            problem = action_problem(action, observation.palm_pose[0], robot.cell)
            if problem:
                raise SafetyStop(problem, StopKind.HOLD)
            forced = action.lift | (observation.time >= p.approach_time - 1e-9)
            if forced[0] and not np.isfinite(robot.lift_time):
                if not self.goes_on_to(Phase.LIFT):
                    return
                stood = self._ask(Phase.LIFT)
                robot.stand_still(stood)
                start += stood
            sent = robot.send_action(replace(action, lift=forced), start + step * robot.control_period)
            late = self.ticks.lateness[-1]
            for observer in self._observers:
                observer.step(state.time, self.phase, observation, action, sent, late)
            if self.phase is Phase.GRASP and np.isfinite(robot.lift_time):
                self._begin(Phase.LIFT)
            if self.phase is Phase.LIFT and self.scripted.arrived(action.palm_goal_world, p.lift_height):
                self._begin(Phase.HOLD)
                held_since = robot.now()
            self._last_goal = action.palm_goal_world
            step += 1
            self.scripted.check_length(self.phase, step)

    # Methods of ``AttemptCarrier``.

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """See ``AttemptCarrier.attempt``. If only one attempt is allowed, it is not judged, but counts as
        held."""
        self._attempts, self._missed = number + 1, False
        self._begin(Phase.MOVE_TO_START)
        self.scripted.move([self._postures[-1], *self.prepared.corners], self.prepared.start_fingers)
        self._postures.extend(self.prepared.corners)
        if self.goes_on_to(Phase.GRASP):
            several = self.spec.attempts > 1
            judge = AttemptJudge(self.prepared.plan, self._preparer.objects) if several else None
            self._follow_policy(judge)
            if judge is not None:
                verdict = judge.verdict()
                self._missed, self._gap = bool(verdict.missed[0]), verdict.gap
        return np.array([self._missed])

    def withdraw(self, ids: np.ndarray, number: int) -> None:
        """See ``AttemptCarrier.withdraw``."""
        self._begin(Phase.WITHDRAW)
        self.scripted.withdraw(self.prepared.plan, self._gap)

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See ``AttemptCarrier.look``. Raises what ``locate_object`` raises."""
        pose, self._state = locate_object(self.robot, self.spec.look_time)
        return ids, pose[None]

    def plan(self, ids: np.ndarray, object_pose: np.ndarray, number: int) -> np.ndarray:
        """See ``AttemptCarrier.plan``. The plan begins at the arm's current joints."""
        arm = self.robot.palm_follower_joints
        try:
            self._prepare(object_pose[0], arm, number)
        except FungraspError as error:
            self.give_up(ids, str(error))
            return ids[:0]
        assert self._state is not None, "look() comes first"
        self._awake(self._state)
        self._postures.append(arm)
        return ids

    def give_up(self, ids: np.ndarray, why: str) -> None:
        """Keep the reason for the result, and pass it to the observers."""
        if len(ids):
            self._why_no_more = why
            for observer in self._observers:
                observer.note(self.robot.clock.now(), why)

    def _watch(self, state: RobotState, command: RobotCommand) -> None:
        """Pass a setpoint to the observers."""
        for observer in self._observers:
            observer.setpoint(self.phase, state, command)
        if self.phase is Phase.MOVE_TO_START:
            # The path was planned around the object where it stood.
            self._check_object(state)

    def _check_object(self, state: RobotState) -> None:
        """Raises: SafetyStop: the object is not seen at the pose of the plan."""
        problem = check_pose(state.tracked, self._object_pose, state.time, self.robot.cell)
        if problem:
            raise SafetyStop(problem, StopKind.HOLD)
