"""Recorded episodes: the states of a scene, for replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.grasps import RobotGraspSet
from fungrasp.sim2real import NOMINAL, Randomization
from fungrasp.task import LiftEnvironment, LiftTask
from fungrasp.task.use import UseMotion, UseOutcomes

_ADDED = ("controls", "differs")
"""Fields that some recordings lack."""

_SHAPES = {
    **dict.fromkeys(("hand", "object_name", "reason", "differs"), ("U", 0)),
    **dict.fromkeys(("object_mass",), ("f", 0)),
    **dict.fromkeys(("index",), ("iu", 0)),
    **dict.fromkeys(("success",), ("b", 0)),
    **dict.fromkeys(("times", "wrist_reference"), ("f", 1)),
    "phase": ("iu", 1),
    "link_contacts": ("b", 2),
    **dict.fromkeys(("qpos", "object_pose", "palm_pose", "joint_positions", "controls"), ("f", 2)),
}
"""Allowed kinds of numbers and number of axes of each array in a file."""

PHASES = ("approach", "lift", "hold", "use")
"""Names of the numbers in ``Trajectory.phase``. A use test is a separate recording
(``fungrasp.evaluation.UseRecorder``)."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode, T states. World frame, z up, table top at z = 0."""

    hand: str
    """Name of the hand."""
    object_name: str
    """Name of the object."""
    object_mass: float
    """Mass of the object [kg]."""
    index: int
    """Row of the grasp in its set."""
    success: bool
    """Whether the lift test (or use test) was passed."""
    reason: str
    """Why the episode failed, "" on success."""
    times: np.ndarray
    """Time of each state [s], shape [T]; 0 at the start of the episode or the use motion."""
    qpos: np.ndarray
    """Positions of the scene of ``fungrasp.simulation.build_scene``, shape [T, nq]."""
    wrist_reference: np.ndarray
    """Pose of the scene's mocap body, shape [7]."""
    object_pose: np.ndarray
    """Pose of the object, world frame, shape [T, 7]."""
    palm_pose: np.ndarray
    """Pose of the palm body, world frame, shape [T, 7]."""
    joint_positions: np.ndarray
    """Angles of the joints in the order of ``Hand.joint_names`` [rad], shape [T, M]."""
    link_contacts: np.ndarray
    """Links that touch the object, in the order of ``Hand.links``, shape [T, L] bool."""
    phase: np.ndarray
    """Phase of each state as an index into ``PHASES``, shape [T]."""
    controls: np.ndarray | None = None
    """Servo controls before each state: the wrist's six joints in its frame [m, rad], then the finger servos
    [rad]; shape [T, 6 + U]. None in old recordings, and in use tests with external forces on the object."""
    differs: str = ""
    """Randomized quantities (names of fields of ``Randomization``, separated by spaces); empty for a nominal
    world. Their values are not recorded, so replayed controls give a different motion."""

    def save(self, path: str | Path) -> None:
        """Write to an ``.npz`` file atomically, numbers as float32.

        Raises:
            FungraspError: the file can't be written.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays = {name: np.asarray(value) for name, value in values.items() if value is not None}
        short = {
            k: v.astype(np.float32) if v.dtype == np.float64 and v.ndim else v for k, v in arrays.items()
        }
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **short)  # pyright: ignore[reportArgumentType]

    @property
    def is_use_test(self) -> bool:
        """Whether this is a use test."""
        return bool((self.phase == PHASES.index("use")).any())

    @property
    def phases(self) -> list[tuple[float, str]]:
        """Start [s] and name of each phase, as accepted by ``fungrasp.media.episode_film``."""
        starts = np.flatnonzero(np.diff(self.phase, prepend=-1))
        return [(float(self.times[i]), PHASES[int(self.phase[i])]) for i in starts]


def replay(path: str | Path) -> Trajectory:
    """Read a recorded episode.

    Raises:
        FungraspError: the file is missing or not a recorded episode.
    """
    names = {field.name for field in fields(Trajectory)}
    arrays = read_npz(path, "recorded episode", names.__contains__)
    missing = sorted(names - set(_ADDED) - set(arrays))
    if missing:
        raise FungraspError(f"{path} is not a recorded episode: it lacks {', '.join(missing)}")
    for name, (kinds, axes) in _SHAPES.items():
        if name in arrays and (arrays[name].dtype.kind not in kinds or arrays[name].ndim != axes):
            raise FungraspError(
                f"{path} is not a recorded episode: {name} has type {arrays[name].dtype} and shape "
                f"{arrays[name].shape}"
            )
    if len({len(array) for name, array in arrays.items() if array.ndim and name != "wrist_reference"}) > 1:
        raise FungraspError(f"{path} is not a recorded episode: its arrays are of different lengths")
    values: dict[str, Any] = {name: value if value.ndim else value.item() for name, value in arrays.items()}
    return Trajectory(**values)


class Recorder:
    """Records the states of a task; pass it to ``LiftEnvironment.step``."""

    def __init__(self, task: LiftTask, grasps: RobotGraspSet, randomization: Randomization = NOMINAL):
        self._task, self._grasps = task, grasps
        other = (f.name for f in fields(randomization))
        names = [name for name in other if getattr(randomization, name) != getattr(NOMINAL, name)]
        self._differs = " ".join(names)
        self._states: list[tuple[np.ndarray, ...]] = []
        self._times: list[np.ndarray] = []
        self()

    def __call__(self) -> None:
        """Record the current state."""
        task, engine = self._task, self._task.engine
        phase = np.isfinite(task.lift_time).astype(np.int8) + np.isfinite(task.hold_time)
        self._times.append(task.time.copy())
        self._states.append(
            (
                ~task.done,
                engine.positions.astype(np.float32),
                engine.object_pose.astype(np.float32),
                engine.palm_pose.astype(np.float32),
                engine.joint_positions.astype(np.float32),
                engine.link_contacts,
                phase.astype(np.int8),
                task.controls.astype(np.float32),
            )
        )

    def trajectories(self, rows: np.ndarray) -> list[Trajectory]:
        """Return one trajectory per world, until its episode was done. rows: rows of the grasps in their set,
        shape [W]."""
        task = self._task
        outcomes, frame = task.outcomes(), task.engine.wrist_frame
        running, *states = (np.stack(column) for column in zip(*self._states, strict=True))
        times = np.array(self._times)
        result = []
        for world, row in enumerate(rows):
            kept = running[:, world]
            qpos, obj, palm, joints, contacts, phase, controls = (state[kept, world] for state in states)
            result.append(
                Trajectory(
                    hand=self._grasps.hand,
                    object_name=str(self._grasps.object_name[world]),
                    object_mass=float(self._grasps.object_mass[world]),
                    index=int(row),
                    success=bool(outcomes.success[world]),
                    reason=str(outcomes.reason[world]),
                    times=times[kept, world],
                    qpos=qpos,
                    wrist_reference=frame[world],
                    object_pose=obj,
                    palm_pose=palm,
                    joint_positions=joints,
                    link_contacts=contacts,
                    phase=phase,
                    controls=controls,
                    differs=self._differs,
                )
            )
        return result


class UseRecorder:
    """Records the use tests of W worlds (``fungrasp.task.use.play_use``)."""

    def __init__(
        self, environment: LiftEnvironment, grasps: RobotGraspSet, motions: Sequence[UseMotion | None]
    ):
        self._engine, self._grasps = environment.engine, grasps
        self._period = environment.task.setpoints.period
        self._lasts = [0.0 if motion is None else motion.whole_duration for motion in motions]
        self._only_move = [motion is not None and motion.only_moves for motion in motions]
        self._states: list[tuple[np.ndarray, ...]] = []

    def __call__(self, controls: np.ndarray) -> None:
        """Record the current state after a setpoint. controls: servo controls."""
        engine = self._engine
        numbers = engine.positions, engine.object_pose, engine.palm_pose, engine.joint_positions, controls
        self._states.append((*(array.astype(np.float32) for array in numbers), engine.link_contacts))

    def trajectories(self, rows: np.ndarray, outcomes: UseOutcomes) -> list[Trajectory | None]:
        """Return one trajectory per world, until its test was over; None if there was none. All states have
        the phase "use". Controls are kept only if no external force moved the object.

        Args:
            rows: rows of the grasps in their set, shape [W].
            outcomes: W outcomes.
        """
        found: list[Trajectory | None] = [None] * len(rows)
        if not self._states:
            return found
        whole = [np.stack(column) for column in zip(*self._states, strict=True)]
        for world in np.flatnonzero(outcomes.motion != "").tolist():
            positions, obj, palm, joints, controls, contacts = (array[:, world] for array in whole)
            # A world whose test is over does not move any more.
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
                object_pose=obj[:count],
                palm_pose=palm[:count],
                joint_positions=joints[:count],
                link_contacts=contacts[:count],
                phase=np.full(count, PHASES.index("use"), dtype=np.int8),
                controls=controls[:count] if self._only_move[world] else None,
            )
        return found
