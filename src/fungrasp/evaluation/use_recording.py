"""Recorded use tests: recordings of their own, as the wrist's joints count in another frame than before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.evaluation.trajectory import PHASES, Trajectory
from fungrasp.grasps import RobotGraspSet
from fungrasp.task import LiftEnvironment
from fungrasp.task.use import UseMotion, UseOutcomes


class UseRecorder:
    """Watches the use tests of W worlds (``fungrasp.task.use.play_use``) and keeps their states."""

    def __init__(
        self, environment: LiftEnvironment, grasps: RobotGraspSet, motions: Sequence[UseMotion | None]
    ):
        """
        Args:
            environment: whose lift tests are over.
            grasps: one per world.
            motions: of each world.
        """
        self._engine, self._grasps = environment.engine, grasps
        self._period = environment.task.setpoints.period
        self._lasts = [0.0 if motion is None else motion.whole_duration for motion in motions]
        self._only_move = [motion is not None and motion.only_moves for motion in motions]
        self._states: list[tuple[np.ndarray, ...]] = []

    def __call__(self, controls: np.ndarray) -> None:
        """Keep the current state; to be called after each setpoint. controls: what the servos were told."""
        engine = self._engine
        numbers = engine.positions, engine.object_pose, engine.palm_pose, engine.joint_positions, controls
        self._states.append((*(array.astype(np.float32) for array in numbers), engine.link_contacts))

    def trajectories(self, rows: np.ndarray, outcomes: UseOutcomes) -> list[Trajectory | None]:
        """One per world, each until its test was over; None where there was none. All their states are of the
        phase "use"; they have controls where nothing but the hand moved the object.

        Args:
            rows: of the grasps in their set, shape [W].
            outcomes: W of them.
        """
        found: list[Trajectory | None] = [None] * len(rows)
        if not self._states:
            return found
        whole = [np.stack(column) for column in zip(*self._states, strict=True)]
        for world in np.flatnonzero(outcomes.motion != "").tolist():
            positions, thing, palm, joints, controls, contacts = (array[:, world] for array in whole)
            # A world whose test is over stands still.
            count = min(round(self._lasts[world] / self._period), len(positions))
            moving = np.flatnonzero((positions[1:count] != positions[: count - 1]).any(axis=1))
            count = int(moving[-1]) + 2 if len(moving) else 1
            found[world] = Trajectory(
                hand=self._grasps.hand,
                object_name=str(self._grasps.object_name[world]),
                object_mass=float(self._grasps.object_mass[world]),
                index=int(rows[world]),
                success=bool(outcomes.success[world]),
                reason=str(outcomes.reason[world]),
                times=self._period * np.arange(1, count + 1),
                qpos=positions[:count],
                wrist_reference=self._engine.wrist_frame[world],
                object_pose=thing[:count],
                palm_pose=palm[:count],
                joint_positions=joints[:count],
                link_contacts=contacts[:count],
                phase=np.full(count, PHASES.index("use"), dtype=np.int8),
                controls=controls[:count] if self._only_move[world] else None,
            )
        return found
