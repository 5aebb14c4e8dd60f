"""The lift test: reach, grasp, lift, hold, in many worlds at once, each with its own grasp."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fungrasp.geometry.arrays import copied, is_numpy, may_be_any, moved_to, rows_like
from fungrasp.geometry.poses import Array, array_namespace
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.as_shown import AsShown, ShownContacts, ShownJudge
from fungrasp.simulation import Engine
from fungrasp.task.actuation import Actuation
from fungrasp.task.outcome import PARKED, LiftMeasurements, Outcomes
from fungrasp.task.policy import Action
from fungrasp.task.protocol import LiftProtocol
from fungrasp.task.setpoints import SetpointGenerator, SetpointSequence
from fungrasp.task.start_pose import StartPoses, start_fingers


class LiftTask:
    """W episodes of the lift test on an engine, without randomness or estimation."""

    def __init__(self, engine: Engine, protocol: LiftProtocol | None = None):
        """
        Args:
            protocol: published protocol if None.
        """
        self.engine, self.scene = engine, engine.scene
        self.protocol = LiftProtocol.given(protocol)
        count, links = len(engine), len(self.scene.hand.links)
        on = engine.object_pose
        xp = array_namespace(on)
        self._where, self._isfinite = xp.where, xp.isfinite

        def zeros(*shape: int) -> Array:
            return rows_like(on, np.zeros(shape))

        self.settled_pose = zeros(count, 7)
        """Rest poses of the objects at the start of the episodes, world frame, shape [W, 7]."""
        self.target_contacts = rows_like(on, np.zeros((count, links), dtype=bool))
        """Links that should touch, shape [W, L]."""
        self.setpoints = SetpointGenerator(
            self.scene.servo_limits, count, self.protocol, self.scene.settings.timestep, on
        )
        self.actuation = Actuation(count, len(self.scene.hand.actuators), on)
        """Actuation errors between setpoints and joints."""
        self.measurements = LiftMeasurements(engine, self.protocol, self.setpoints.period)
        self._judge = ShownJudge(
            self.scene.hand, dict(zip(self.scene.objects, self.scene.models, strict=True))
        )
        self.shown: ShownContacts | None = None
        """The person's contacts, W rows; None if unknown."""
        self.controls = zeros(count, 6 + len(self.scene.hand.actuators))
        """Latest controls of the servos (``Engine.controls``), shape [W, 6 + U]."""
        self.time = zeros(count)
        """Time of each episode [s], shape [W]."""
        self.lift_time = zeros(count) + np.inf
        """Start of the lift [s], shape [W]."""
        self.hold_time = zeros(count) + np.inf
        """Start of the hold [s], shape [W]."""
        self.done = rows_like(on, np.zeros(count, dtype=bool))
        """Finished episodes, shape [W]."""
        self.withdrawing = rows_like(on, np.zeros(count, dtype=bool))
        """Worlds between two attempts, in which no lift begins, shape [W]."""

    @property
    def lost(self) -> np.ndarray:
        """Whether the object is low some time after the lift began, or the simulation diverged, shape [W]
        bool."""
        p, height = self.protocol, self.measurements.height
        low = (self.time - self.lift_time > p.lost_after) & (height < p.lost_height)
        return low | (height <= -1.0)

    def settle(self, grasps: RobotGraspSet, table_height: np.ndarray | None = None) -> None:
        """Let the objects settle from their rest poses, then put the hands at their start poses.

        Args:
            grasps: one grasp per world, of the world's object.
            table_height: height of the table top [m], shape [W]; zero if None.
        """
        engine, hand, p = self.engine, self.scene.hand, self.protocol
        fingers = start_fingers(hand, grasps, p.start_closing)
        # The palm is parked while the objects settle.
        parked = np.tile(PARKED, (len(engine), 1))
        engine.reset()
        engine.set_state(
            object_pose=grasps.object_rest_pose, wrist_frame=parked, joint_positions=hand.all_joints(fingers)
        )
        still = engine.controls(parked, np.zeros((len(engine), 3)), fingers)
        engine.step(still, round(p.settle_time / self.scene.settings.timestep))

        settled = engine.object_pose
        height = np.zeros(len(engine)) if table_height is None else table_height
        starts = StartPoses(hand, self.scene.models)
        start, target = starts.facing(grasps, engine.object_index, settled, p.start_distance, fingers, height)
        self.begin(np.arange(len(engine)), settled, target, start, fingers, grasps.link_contacts)

    def begin(
        self,
        ids: np.ndarray,
        settled_pose: np.ndarray,
        target_pose: np.ndarray,
        start_pose: np.ndarray,
        start_fingers: np.ndarray,
        target_contacts: np.ndarray,
        start_velocity: np.ndarray | None = None,
        start_time: np.ndarray | None = None,
    ) -> None:
        """Start episodes in I worlds with objects at rest. NumPy arrays are accepted on any device.

        Args:
            ids: worlds, shape [I].
            settled_pose: poses of the objects, world frame, shape [I, 7].
            target_pose: approximate palm poses of the grasps, world frame, shape [I, 7].
            start_pose: palm poses, world frame, shape [I, 7].
            start_fingers: initial setpoints of the independent joints [rad], shape [I, U].
            target_contacts: links that should touch, shape [I, L] bool.
            start_velocity: velocities of the palms [m/s], shape [I, 3]; zero if None.
            start_time: episode times [s], shape [I]; zero if None.
        """
        on = self.controls
        velocity = np.zeros((len(ids), 3)) if start_velocity is None else start_velocity
        time = np.zeros(len(ids)) if start_time is None else start_time
        ids, settled_pose, target_pose, start_pose, start_fingers, target_contacts, velocity, time = (
            moved_to(on, given)
            for given in (
                *(ids, settled_pose, target_pose, start_pose, start_fingers),
                *(target_contacts, velocity, time),
            )
        )
        self.settled_pose[ids], self.target_contacts[ids] = settled_pose, target_contacts
        self.setpoints.begin(ids, start_pose, velocity, start_fingers)
        palm, fingers = self.actuation.begin(ids, start_pose, velocity, start_fingers)
        self.engine.set_state(
            ids,
            object_pose=settled_pose,
            wrist_frame=target_pose,
            palm_pose=palm,
            palm_velocity=velocity,
            joint_positions=self.scene.hand.all_joints(fingers),
        )
        self.controls = self.engine.controls(
            self.setpoints.wrist.pose, self.setpoints.wrist.velocity, self.setpoints.fingers
        )
        self.measurements.begin(ids)
        self.time[ids] = time
        self.lift_time[ids] = self.hold_time[ids] = np.inf
        self.done[ids] = self.withdrawing[ids] = False

    def show(self, ids: np.ndarray, contacts: ShownContacts | None) -> None:
        """Set the person's contacts in some worlds.

        Args:
            ids: worlds, shape [I].
            contacts: I rows; None if unknown, which clears the contacts of all worlds.
        """
        whole = len(ids) == len(self.engine)
        if contacts is None or whole:
            self.shown = contacts if whole else None
        elif self.shown is not None:
            self.shown = self.shown.replaced(ids, contacts)

    def withdraw(self, ids: np.ndarray) -> None:
        """Continue after an attempt: hands may move, but not lift before ``begin_attempt``. ids: worlds,
        shape [I]."""
        self.lift_time[ids] = self.hold_time[ids] = np.inf
        self.done[ids], self.withdrawing[ids] = False, True

    def begin_attempt(self, ids: np.ndarray, target_pose: np.ndarray) -> None:
        """Begin another attempt from the current state, with objects at rest.

        Args:
            ids: worlds, shape [I].
            target_pose: approximate palm poses of the grasps, world frame, shape [I, 7].
        """
        engine = self.engine
        self.settled_pose[ids] = engine.object_pose[ids]
        engine.set_state(ids, wrist_frame=target_pose, palm_pose=engine.palm_pose[ids])
        self.measurements.begin(ids)
        self.time[ids] = 0.0
        self.lift_time[ids] = self.hold_time[ids] = np.inf
        self.done[ids] = self.withdrawing[ids] = False

    def step(
        self,
        action: Action,
        before: Callable[[], None] = lambda: None,
        after: Callable[[], None] = lambda: None,
    ) -> None:
        """Advance all unfinished worlds by one control period.

        Args:
            before: called before each setpoint, to apply disturbances.
            after: called after each setpoint, to record.
        """
        p, setpoints = self.protocol, self.setpoints
        # Finished worlds keep their state.
        over = copied(self.done)
        kept = (setpoints.state(), self.actuation.state()) if may_be_any(over) else None
        sequence = self.advance_setpoints(action)
        followed = self.actuation.follow(sequence, setpoints.period)
        controls = self.engine.controls(followed.palm, followed.palm_velocity, followed.fingers)
        # On a device, pass the mask: indices would need a synchronization.
        active = np.flatnonzero(~self.done) if is_numpy(self.done) else ~self.done
        for i in range(setpoints.number):
            setpoints.wrist.pose, setpoints.fingers = sequence.palm[i], sequence.fingers[i]
            before()
            self.controls = controls[i]
            self.engine.step(controls[i], setpoints.substeps, active)
            self.time += self._where(self.done, 0.0, setpoints.period)
            self._update_hold(sequence.goal)
            after()
        if kept is not None:
            setpoints.restore(over, kept[0])
            self.actuation.restore(over, kept[1])
        self.measurements.sample(self._isfinite(self.hold_time) & ~self.done, self.target_contacts)
        self.done |= self.time >= self.hold_time + p.hold_time - 1e-9

    def advance_setpoints(self, action: Action) -> SetpointSequence:
        """Return the setpoints of the next control period, and begin lifts that are due."""
        p, where = self.protocol, self._where
        may_lift = (action.lift | (self.time >= p.approach_time - 1e-9)) & ~self.withdrawing
        begins = may_lift & ~self._isfinite(self.lift_time)
        if may_be_any(begins):
            self.lift_time = where(begins, self.time, self.lift_time)
            self.measurements.lift_begins(begins, self.settled_pose)
        goal = copied(action.palm_goal_world)
        goal[:, 2] += p.lift_height * self._isfinite(self.lift_time)
        return self.setpoints.advance(goal, action.finger_targets)

    def _update_hold(self, goal: Array) -> None:
        """Begin the hold once the setpoint has reached its goal or the rise time is over. goal: palm goal,
        shape [W, 7]."""
        way = goal[:, :3] - self.setpoints.wrist.pose[:, :3]
        apart = array_namespace(way).sqrt((way * way).sum(axis=1))
        late = self.time - self.lift_time >= self.protocol.rise_time - 1e-9
        risen = self._isfinite(self.lift_time) & ((apart < 2e-3) | late)
        begins = risen & ~self._isfinite(self.hold_time)
        self.hold_time = self._where(begins, self.time, self.hold_time)
        self.measurements.watch(self._isfinite(self.hold_time) & ~self.done, self.hold_time)

    def outcomes(self) -> Outcomes:
        """Return the outcomes, once all episodes are done."""
        return self.measurements.outcomes(self.as_shown())

    def as_shown(self) -> AsShown | None:
        """Judge the holds at their middle, W rows; None if the person's contacts are unknown."""
        return None if self.shown is None else self.measurements.middle.as_shown(self._judge, self.shown)
