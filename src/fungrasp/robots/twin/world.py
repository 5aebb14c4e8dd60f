"""The simulated world of a twin: physics, imperfect servos, the tracker, and the outcome of the lift test
(docs/evaluate.md)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from threading import RLock

import mujoco
import numpy as np

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, quaternion_multiply, relative
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.as_shown import AsShown, ShownContacts, ShownJudge
from fungrasp.hands import Hand
from fungrasp.hands.arm import PALM_SITE, arm_spec
from fungrasp.hands.kinematic_tree import subtree
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import TrackedPose, TrackingStatus
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.twin_model import OBJECT, TABLE, twin_model
from fungrasp.sim2real import random_stream
from fungrasp.task import LiftProtocol
from fungrasp.task.outcome import HoldMiddle, lifted_and_held
from fungrasp.task.setpoints import SETPOINT_PERIOD

TORQUE_DELAY = 0.002
"""Delay of torques to the hand's motors [s]: a CAN frame and a period of the motors' controllers. With the
longer ``hand_delay``, which is that of position servos, a torque loop at 333 Hz would oscillate."""

FRICTION_INTERVAL = 4
"""Physics steps between two updates of the joints' friction."""


@dataclass(frozen=True, eq=False)
class TwinTruth:
    """True state of a twin."""

    object_pose: np.ndarray
    """Pose of the object, world frame, shape [7]."""
    palm_pose: np.ndarray
    """Pose of the palm, world frame, shape [7]."""
    on_table: bool
    """Whether the object touches the table, the arm or its base."""
    in_hand: bool
    """Whether the object touches the hand."""
    touching: np.ndarray
    """Links of the hand that touch the object, palm first, shape [L] bool."""
    joint_positions: np.ndarray
    """Positions of all joints of the hand [rad], shape [M]."""


class TwinWorld:
    """The simulated world of one cell. Methods may be called from any thread."""

    def __init__(
        self, cell: RobotCell, hand: Hand, obj: ObjectModel, truth: TwinParameters, *, seed: int = 0
    ):
        """obj: believed model of the object; seed: for the tracker's noise."""
        self.hand, self.truth = hand, truth
        self.model = model = twin_model(cell, hand, obj, truth)
        self.data = data = mujoco.MjData(model)
        self.lock = RLock()
        """Lock for reading or changing the world."""
        arm = [actuator.name for actuator in arm_spec(cell.arm.model).actuators]
        fingers = list(hand.actuators)
        self._arm = np.array([model.actuator(name).id for name in arm])
        self._fingers = np.array([model.actuator(name).id for name in fingers])
        self._arm_qpos = np.array([model.joint(name).qposadr[0] for name in arm])
        self._arm_dofs = np.array([model.joint(name).dofadr[0] for name in arm])
        self._finger_qpos = np.array([model.joint(name).qposadr[0] for name in fingers])
        self._finger_dofs = np.array([model.joint(name).dofadr[0] for name in fingers])
        self._all_qpos = np.array([model.joint(name).qposadr[0] for name in hand.joint_names])
        self._object_qpos = int(model.joint(OBJECT).qposadr[0])
        self._palm = model.site(PALM_SITE).id
        self._object, self._table = model.body(OBJECT).id, model.geom(TABLE).id
        self._is_hand = np.zeros(model.nbody, dtype=bool)
        self._is_hand[subtree(model, int(model.site_bodyid[self._palm]))] = True
        self._links = [[model.body(name).id for name in members] for members in hand.links]
        torque = np.array([hand.actuators[name].force_limit for name in fingers])
        self._kp = np.array([hand.actuators[name].kp for name in fingers])
        self._static_friction = truth.friction * torque
        self._steps = 0
        self._rng = random_stream("twin tracker", seed)
        self._pending: deque[tuple[float, str, np.ndarray]] = deque()
        self._frames: deque[TrackedPose] = deque()
        self._delivered: TrackedPose | None = None
        self._next_frame = 0.0
        self._torque: np.ndarray | None = None
        self.powered = True
        """Whether the hand's servos have torque."""
        self.tracking = True
        """Whether the tracker delivers frames; False in tests of faults."""
        self.offset = 0.0
        """Robot's clock minus simulated time [s]."""
        data.qpos[self._arm_qpos] = cell.arm.home
        data.ctrl[self._arm] = cell.arm.home
        open_hand = hand.open_joints
        data.qpos[self._all_qpos] = hand.all_joints(open_hand)
        self._finger_target = open_hand.copy()
        self._feedforward = np.zeros(len(fingers))
        self._play = open_hand.copy()
        self._update_friction()

    @property
    def time(self) -> float:
        """Time on the robot's clock [s]."""
        return self.data.time + self.offset

    def settle(self, object_pose: np.ndarray) -> np.ndarray:
        """Release the object and let it settle as in the lift test; the clock does not count this time.
        object_pose: initial pose, world frame, shape [7]. Returns: rest pose, world frame, shape [7]."""
        with self.lock:
            before = self.data.time
            self.data.qpos[self._object_qpos : self._object_qpos + 7] = object_pose
            self.data.qvel[:] = 0.0
            mujoco.mj_forward(self.model, self.data)
            self._clear_table()
            for _ in range(round(LiftProtocol.settle_time / self.model.opt.timestep)):
                self._step()
            self.data.time, self._next_frame = before, before
            self._frames.clear()
            return self.data.qpos[self._object_qpos : self._object_qpos + 7].copy()

    def _clear_table(self) -> None:
        """Raise the object out of the tilted table."""
        depth = min(
            (c.dist for c in self.data.contact if self._object in self.model.geom_bodyid[[c.geom1, c.geom2]]),
            default=0.0,
        )
        self.data.qpos[self._object_qpos + 2] -= min(depth, 0.0)

    def command_arm(self, positions: np.ndarray) -> None:
        """Set targets of the arm's servos [rad], shape [6], which take effect after ``arm_delay``."""
        self._post("arm", self.truth.arm_delay, positions)

    def command_hand(self, positions: np.ndarray, feedforward: np.ndarray | None = None) -> None:
        """Set targets [rad] and additional torques [N m] of the hand's servos, shape [U] each, which take
        effect after ``hand_delay``."""
        if feedforward is None:
            feedforward = np.zeros(len(positions))
        self._post("hand", self.truth.hand_delay, np.stack([positions, feedforward]))

    def command_torques(self, torques: np.ndarray) -> None:
        """Set torques of the hand's motors instead of targets [N m], shape [U]."""
        self._post("torque", TORQUE_DELAY, torques)

    def arm_state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions [rad], velocities [rad/s] and torques [N m] of the arm, shape [6] each."""
        with self.lock:
            d = self.data
            return d.qpos[self._arm_qpos], d.qvel[self._arm_dofs], d.actuator_force[self._arm]

    def hand_state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the state of the hand's independent joints, with encoder errors. See ``arm_state``."""
        with self.lock:
            d, step = self.data, self.truth.spread.encoder_step
            measured = d.qpos[self._finger_qpos] + self.truth.encoder_bias
            measured = step * np.round(measured / step)
            return measured, d.qvel[self._finger_dofs], d.actuator_force[self._fingers]

    def finger_positions(self) -> np.ndarray:
        """Return the true positions of the hand's independent joints [rad], shape [U]."""
        with self.lock:
            return self.data.qpos[self._finger_qpos].copy()

    def tracked(self) -> TrackedPose | None:
        """Return the newest delivered pose of the tracker; None before the first."""
        with self.lock:
            while self._frames and self._frames[0].captured + self.truth.tracker_delay <= self.time:
                self._delivered = self._frames.popleft()
            return self._delivered

    def look(self) -> TwinTruth:
        """Return the true state."""
        with self.lock:
            d = self.data
            palm = np.zeros(4)
            mujoco.mju_mat2Quat(palm, d.site_xmat[self._palm])
            others = [self._touching(c) for c in d.contact]
            bodies = [body for body in others if body is not None]
            return TwinTruth(
                object_pose=d.qpos[self._object_qpos : self._object_qpos + 7].copy(),
                palm_pose=np.concatenate([d.site_xpos[self._palm], palm]),
                on_table=any(not self._is_hand[body] for body in bodies),
                in_hand=any(self._is_hand[body] for body in bodies),
                touching=np.array([any(body in bodies for body in members) for members in self._links]),
                joint_positions=d.qpos[self._all_qpos],
            )

    def center_of_mass(self) -> np.ndarray:
        """Return the true center of mass of the object, world frame [m], shape [3]."""
        with self.lock:
            return self.data.xipos[self._object].copy()

    def advance(self, until: float) -> None:
        """Simulate until a time on the robot's clock [s]."""
        while True:
            with self.lock:
                if self.time >= until - 0.5 * self.model.opt.timestep:
                    return
                self._step()

    def _touching(self, contact) -> int | None:  # type: ignore[no-untyped-def]
        """Return the body that touches the object at a contact; None if none does."""
        one, two = self.model.geom_bodyid[[contact.geom1, contact.geom2]]
        if self._object not in (one, two) or contact.dist > 0:
            return None
        return int(two if one == self._object else one)

    def _post(self, what: str, delay: float, values: np.ndarray) -> None:
        with self.lock:
            self._pending.append((self.time + delay, what, values.copy()))

    def _step(self) -> None:
        m, d, now = self.model, self.data, self.time
        # Delays differ between devices, so the queue is not in order of time.
        for _ in range(len(self._pending)):
            due, what, values = self._pending.popleft()
            if due > now + 1e-9:
                self._pending.append((due, what, values))
            elif what == "arm":
                d.ctrl[self._arm] = values
            elif what == "hand":
                (self._finger_target, self._feedforward), self._torque = values, None
            else:
                self._torque = values
        self._drive_fingers()
        if self._steps % FRICTION_INTERVAL == 0:
            self._update_friction()
        mujoco.mj_step(m, d)
        self._steps += 1
        if now >= self._next_frame:
            self._next_frame = now + 1.0 / self.truth.spread.tracker_rate
            self._track()

    def _drive_fingers(self) -> None:
        """Set the controls of the hand's servos, with backlash; feed-forward torques shift the targets."""
        d, slack = self.data, self.truth.backlash
        q, v = d.qpos[self._finger_qpos], d.qvel[self._finger_dofs]
        if not self.powered:
            wanted = np.zeros(len(q))
        elif self._torque is not None:
            wanted = self._torque
        else:
            self._play = np.clip(self._play, self._finger_target - slack, self._finger_target + slack)
            d.ctrl[self._fingers] = self._play + self._feedforward / (self.truth.gain * self._kp)
            return
        constant = self.truth.stiffness / self.truth.gain
        # A servo has the torque gain (ctrl - q) + bias v: solve for the control.
        gain, bias = self.model.actuator_gainprm[self._fingers, 0], self.model.actuator_biasprm[self._fingers]
        d.ctrl[self._fingers] = q + (constant * wanted - bias[:, 2] * v) / gain

    def _update_friction(self) -> None:
        """Set the friction of the fingers, which falls from static to sliding with the speed (Stribeck)."""
        t = self.truth
        speed = self.data.qvel[self._finger_dofs] / t.spread.stribeck_speed
        share = t.sliding + (1.0 - t.sliding) * np.exp(-(speed**2))
        self.model.dof_frictionloss[self._finger_dofs] = share * self._static_friction

    def _track(self) -> None:
        """Add a frame of the tracker, unless it is missing."""
        t, rng = self.truth, self._rng
        noise = rng.normal(size=6) * np.repeat(t.spread.tracker_noise, 3)
        if not self.tracking or rng.random() < t.spread.tracker_dropout:
            return
        seen = compose(t.camera_error, self.data.qpos[self._object_qpos : self._object_qpos + 7])
        seen[:3] += noise[:3]
        seen[3:] = quaternion_multiply(quaternion_from_rotation_vector(noise[3:]), seen[3:])
        self._frames.append(TrackedPose(seen, self.time, 1.0, TrackingStatus.TRACKING))


@dataclass(frozen=True)
class HoldSample:
    """True state at one moment of the hold."""

    time: float
    """Time on the robot's clock [s]."""
    height: float
    """Height of the center of mass above its rest height [m]."""
    alone: bool
    """Whether the object touches neither table nor arm."""
    in_hand: bool
    """Whether the object touches the hand."""
    hand: HoldMiddle
    """Pose and joints of the hand on the object, and links that touch it now, one row."""


def hold_sample(world: TwinWorld, settled: float) -> HoldSample:
    """Return the current sample. settled: rest height of the center of mass [m]."""
    truth = world.look()
    height = float(world.center_of_mass()[2] - settled)
    palm = relative(truth.object_pose, truth.palm_pose)
    hand = HoldMiddle(palm[None], truth.joint_positions[None], truth.touching[None])
    return HoldSample(world.time, height, not truth.on_table, truth.in_hand, hand)


def held_throughout(samples: list[HoldSample], seconds: float) -> bool:
    """Return whether the object was lifted and held (``fungrasp.task.outcome.lifted_and_held``) in a complete
    hold. seconds: duration of the hold [s]."""
    protocol = LiftProtocol()
    lowest = min((s.height for s in samples), default=-np.inf)
    share = sum(s.in_hand for s in samples) / max(len(samples), 1)
    touched = not all(s.alone for s in samples)
    held = lifted_and_held(np.array(lowest), np.array(share), np.array(touched), protocol)
    return bool(held) and seconds >= 0.95 * protocol.hold_time


def held_as_shown(
    samples: list[HoldSample], hand: Hand, obj: ObjectModel, grasp: RobotGraspSet
) -> AsShown | None:
    """Judge at the middle of the hold how the hand held the object, as in the lift test.

    Args:
        samples: samples of the hold.
        obj: believed model of the object.
        grasp: one grasp, which was followed.

    Returns:
        one row; None without a hold, or if the person's contacts are unknown.
    """
    shown = ShownContacts.of(grasp)
    if shown is None or not samples:
        return None
    touched = np.mean([s.hand.touching for s in samples], axis=0) > 0.5
    middle = replace(samples[len(samples) // 2].hand, touching=touched)
    return middle.as_shown(ShownJudge(hand, {obj.name: obj}), shown)


class TwinJudge:
    """Watches one attempt. It must be made while the object rests."""

    def __init__(self, world: TwinWorld):
        self._world = world
        self._settled = float(world.center_of_mass()[2])
        self.samples: list[HoldSample] = []
        """Samples of the hold so far."""

    def watch(self, holding: bool) -> None:
        """Take a sample after a setpoint. holding: whether it belongs to the hold; ignored otherwise."""
        if holding:
            self.samples.append(hold_sample(self._world, self._settled))

    @property
    def height(self) -> float:
        """Smallest rise of the center of mass during the hold [m]; infinite before the hold."""
        return min((s.height for s in self.samples), default=np.inf)

    @property
    def success(self) -> bool:
        """Whether the object was lifted and held (``held_throughout``)."""
        return held_throughout(self.samples, SETPOINT_PERIOD * len(self.samples))
