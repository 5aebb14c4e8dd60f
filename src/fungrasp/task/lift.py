"""The dynamic test: reach, grasp, lift, hold, in many worlds at once, each with its own grasp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import compose, invert, norm, rotate
from fungrasp.grasps import RobotGraspSet
from fungrasp.simulation import Scene, Worlds
from fungrasp.task.protocol import Protocol
from fungrasp.task.setpoints import Servos, SetPoints
from fungrasp.task.wrist_limits import WristSetPoint


@dataclass(frozen=True)
class Action:
    """What a policy asks for during the next control period, W worlds."""

    wrist_pose: np.ndarray
    """Goal for the palm body, world frame, before any lift is added, shape [W, 7]."""
    finger_targets: np.ndarray
    """Goal of the independent joints' servos [rad], shape [W, U]."""
    lift: np.ndarray
    """Whether the lift may begin (it can't be taken back), shape [W] bool."""


@dataclass(frozen=True)
class Trials:
    """Outcome of W trials, a number each, shape [W]."""

    success: np.ndarray
    lifted_height_m: np.ndarray
    """Smallest height of the centre of mass above where it settled, during the hold [m]."""
    contact_ratio: np.ndarray
    """Share of the target links in contact, mean over the hold."""
    contact_precision: np.ndarray
    """Share of the links in contact that are targets, mean over the hold; zero without contact."""
    contact_f1: np.ndarray
    sim_distance_world_mm_s: np.ndarray
    """Displacement of the object per second of the hold, in the world."""
    sim_distance_hand_mm_s: np.ndarray
    """The same relative to the palm: slip."""
    pushed_m: np.ndarray
    """Displacement of the object in the table's plane before the lift [m]."""
    reason: np.ndarray
    """Why the trial failed, "" on success, str."""


class LiftTask:
    """W trials of the dynamic test."""

    def __init__(self, scene: Scene, grasps: RobotGraspSet, worlds: Worlds, protocol: Protocol | None = None):
        """
        Args:
            scene: made for the grasps' hand and objects.
            grasps: one per world.
            worlds: W worlds of the scene.
            protocol: the published one if None.
        """
        self.scene, self.grasps, self.worlds = scene, grasps, worlds
        self.protocol = protocol or Protocol()
        self.matrix, self.offset = scene.hand.coupling
        self._independent = np.linalg.pinv(self.matrix)
        self.wrist_in_object = compose(invert(grasps.object_pose), grasps.wrist_pose)
        """Pose of the palm in the grasped object's frame, shape [W, 7]."""
        count, links = len(worlds), grasps.link_contacts.shape[1]
        self.settled_pose = np.zeros((count, 7))
        """Of the objects at the start, world frame, shape [W, 7]."""
        self.target_pose = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        """Where the palm should grasp, world frame, shape [W, 7]."""
        self.target_contacts = np.zeros((count, links), dtype=bool)
        """Links that should touch, shape [W, L]."""
        self.servos = Servos(scene, count, self.protocol)
        self.settled_height = np.zeros(count)
        self.time = np.zeros(count)
        """Of each trial [s], shape [W]."""
        self.lift_time = np.full(count, np.inf)
        """When the lift began [s], shape [W]."""
        self.hold_time = np.full(count, np.inf)
        """When the hold began [s], shape [W]."""
        self.done = np.zeros(count, dtype=bool)
        self._lifted = np.full(count, np.inf)
        self._touched_table = np.zeros(count, dtype=bool)
        self._pushed = np.zeros(count)
        self._samples = np.zeros((7, count))
        self._previous = np.full((count, 3), np.nan), np.full((count, 3), np.nan)

    def independent(self, joint_positions: np.ndarray) -> np.ndarray:
        """Servo targets [W, U] of full joint vectors [W, M]."""
        return (joint_positions - self.offset) @ self._independent.T

    @property
    def set_point(self) -> WristSetPoint:
        """Where the wrists were last told to be."""
        return self.servos.wrist

    @property
    def finger_set_point(self) -> np.ndarray:
        """Where the independent joints were last told to be [rad], shape [W, U]."""
        return self.servos.fingers

    @property
    def latency(self) -> np.ndarray:
        """How late actions take effect (see ``Servos``) [s], shape [W]."""
        return self.servos.latency

    @property
    def control_step(self) -> np.ndarray:
        """Control steps that each trial has behind it, shape [W] int."""
        return np.rint(self.time / self.protocol.control_period).astype(int)

    @property
    def tracked_object_pose(self) -> np.ndarray:
        """Where a policy sees the objects, world frame, shape [W, 7]."""
        pose = self.worlds.object_pose
        pose[:, 3:] /= norm(pose[:, 3:])
        return pose

    def reset(self) -> None:
        """Let the objects settle, then put the hands at their start."""
        worlds, count = self.worlds, len(self.worlds)
        worlds.reset()
        worlds.object_pose = self.grasps.object_rest_pose
        parked = np.tile([0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
        worlds.wrist_reference = parked
        start_joints = self.protocol.start_closing * self.grasps.joint_positions
        limits = self.scene.hand.joint_limits
        start_targets = self.independent(np.clip(start_joints, limits[:, 0], limits[:, 1]))
        worlds.joint_positions = start_targets @ self.matrix.T + self.offset
        worlds.ctrl[:, self.scene.finger_actuators] = start_targets
        worlds.step(round(self.protocol.settle_time / self.scene.settings.timestep))

        settled = worlds.object_pose.copy()
        settled[:, 3:] /= np.linalg.norm(settled[:, 3:], axis=1, keepdims=True)
        target = compose(settled, self.wrist_in_object)
        start = target.copy()
        away = target[:, :3] - settled[:, :3]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        start[:, :3] = settled[:, :3] + self.protocol.start_distance * away
        self.begin(np.arange(count), settled, target, start, start_targets, self.grasps.link_contacts)

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
        """Start trials in some worlds, I of them: objects at rest, hands at their start.

        Args:
            ids: worlds, shape [I].
            settled_pose: of the objects, world frame, shape [I, 7].
            target_pose: where the palm should grasp, world frame, shape [I, 7].
            start_pose: of the palm, world frame, shape [I, 7].
            start_fingers: servo targets [rad], shape [I, U].
            target_contacts: links that should touch, shape [I, L] bool.
            start_velocity: of the wrist [m/s], shape [I, 3]; zero if None.
            start_time: where on the trial's clock to start [s], shape [I]; zero if None.
        """
        worlds = self.worlds
        self.settled_pose[ids], self.target_pose[ids] = settled_pose, target_pose
        self.target_contacts[ids] = target_contacts
        worlds.mocap_pos[ids, 0], worlds.mocap_quat[ids, 0] = target_pose[:, :3], target_pose[:, 3:]
        velocity = np.zeros((len(ids), 3)) if start_velocity is None else start_velocity
        self.servos.begin(ids, target_pose, start_pose, velocity, start_fingers)
        worlds.qvel[ids] = 0.0
        if start_velocity is not None:
            slides = rotate(invert(target_pose)[:, 3:], start_velocity)
            worlds.qvel[np.ix_(ids, worlds.wrist_qvel[:3])] = slides
        worlds.qpos[np.ix_(ids, worlds.object_qpos)] = settled_pose
        worlds.qpos[np.ix_(ids, worlds.finger_qpos)] = start_fingers @ self.matrix.T + self.offset
        wrist = self.servos.wrist_coordinates(self.set_point.pose)
        worlds.qpos[np.ix_(ids, worlds.wrist_qpos)] = wrist[ids]
        worlds.ctrl[:, self.servos.actuators] = self.servos.commands()
        worlds.forward(ids)
        self.settled_height[ids] = worlds.center_of_mass[ids, 2]
        self.time[ids] = 0.0 if start_time is None else start_time
        self.lift_time[ids] = self.hold_time[ids] = np.inf
        self.done[ids] = False
        self._lifted[ids] = np.inf
        self._touched_table[ids] = False
        self._pushed[ids] = 0.0
        self._samples[:, ids] = 0.0
        self._previous[0][ids], self._previous[1][ids] = np.nan, np.nan

    def step(self, action: Action, watch: Callable[[], None] | None = None) -> None:
        """Advance all unfinished worlds by one control period. watch: called after each substep, to
        record."""
        p, servos = self.protocol, self.servos
        points = self.set_points(action)
        active = np.flatnonzero(~self.done)
        for i in range(servos.number):
            servos.wrist.pose, servos.fingers = points.palm[i], points.fingers[i]
            self.worlds.ctrl[:, servos.actuators] = points.commands[i]
            self.worlds.step(servos.substeps, active)
            self.time += np.where(self.done, 0.0, servos.period)
            self._observe_hold(points.goal)
            if watch is not None:
                watch()
        self._sample()
        self.done |= self.time >= self.hold_time + p.hold_time - 1e-9

    def set_points(self, action: Action) -> SetPoints:
        """What the servos are told during the next control period; a lift begins where it may."""
        p = self.protocol
        may_lift = action.lift | (self.time >= p.approach_time - 1e-9)
        begins = may_lift & np.isinf(self.lift_time)
        if begins.any():
            self.lift_time[begins] = self.time[begins]
            moved = np.linalg.norm(self.worlds.object_pose[:, :2] - self.settled_pose[:, :2], axis=1)
            self._pushed[begins] = moved[begins]
        goal = action.wrist_pose.copy()
        goal[:, 2] += p.lift_height * np.isfinite(self.lift_time)
        return self.servos.plan(goal, action.finger_targets)

    def _observe_hold(self, goal: np.ndarray) -> None:
        risen = np.isfinite(self.lift_time) & (
            np.linalg.norm(goal[:, :3] - self.set_point.pose[:, :3], axis=1) < 2e-3
        )
        self.hold_time = np.where(risen & ~np.isfinite(self.hold_time), self.time, self.hold_time)
        holding = np.isfinite(self.hold_time) & ~self.done
        height = self.worlds.center_of_mass[:, 2] - self.settled_height
        height = np.where(np.isfinite(height) & ~self.worlds.broken, height, -1.0)
        self._lifted = np.where(holding, np.minimum(self._lifted, height), self._lifted)
        self._touched_table |= holding & self.worlds.object_on_table

    def _sample(self) -> None:
        """Once a control period: contacts and displacement during the hold."""
        holding = np.isfinite(self.hold_time) & ~self.done
        position, palm = self.worlds.object_pose, self.worlds.palm_pose
        in_palm = compose(invert(palm), position)[:, :3]
        actual, target = self.worlds.link_contacts, self.target_contacts
        both = (actual & target).sum(axis=1)
        recall = both / np.maximum(target.sum(axis=1), 1)
        precision = both / np.maximum(actual.sum(axis=1), 1)
        f1 = 2 * both / np.maximum(target.sum(axis=1) + actual.sum(axis=1), 1)
        travel = np.linalg.norm(position[:, :3] - self._previous[0], axis=1)
        slip = np.linalg.norm(in_palm - self._previous[1], axis=1)
        sample = np.stack([np.ones(len(holding)), recall, precision, f1, travel, slip, actual.any(axis=1)])
        self._samples += np.where(holding & np.isfinite(travel), np.nan_to_num(sample), 0.0)
        self._previous = position[:, :3].copy(), in_palm

    def trials(self) -> Trials:
        """The outcome, once all worlds are done."""
        p = self.protocol
        number, recall, precision, f1, travel, slip, touching = self._samples
        number = np.maximum(number, 1)
        high = self._lifted >= p.success_height
        success = high & ~self._touched_table
        reason = np.where(
            success,
            "",
            np.where(
                self._lifted < -0.5,
                "the simulation diverged",
                np.where(
                    high,
                    "the object touched the table during the hold",
                    np.where(
                        touching / number > 0.9,
                        "held too low",
                        np.where(touching > 0, "dropped during the hold", "lost before the hold"),
                    ),
                ),
            ),
        )
        per_second = 1e3 / (number * p.control_period)
        return Trials(
            success,
            self._lifted,
            recall / number,
            precision / number,
            f1 / number,
            travel * per_second,
            slip * per_second,
            self._pushed,
            reason,
        )
