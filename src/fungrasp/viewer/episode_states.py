"""The states of one episode, as they come in: from a simulation that runs, or from a recording."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from fungrasp.evaluation import Trajectory
from fungrasp.evaluation.trajectory import PHASES
from fungrasp.geometry.poses import relative


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """A state. World frame; a hand with M joints of which U are driven, and L links."""

    time: float
    """Since the episode began [s]."""
    phase: str
    """What is being done."""
    object_pose: np.ndarray
    """Shape [7]."""
    palm_pose: np.ndarray
    """Shape [7]."""
    joints: np.ndarray
    """All joints [rad], shape [M]."""
    contacts: np.ndarray
    """Links that touch the object, shape [L] bool."""
    forces: np.ndarray | None = None
    """Net force of each link on the object [N], shape [L]; None where it is not known."""
    commanded_palm: np.ndarray | None = None
    """Where the palm was told to be, shape [7]."""
    commanded_joints: np.ndarray | None = None
    """Where all joints were told to be [rad], shape [M]."""
    estimated_contacts: np.ndarray | None = None
    """Links that the policy takes to touch, shape [L] bool."""


@dataclass(frozen=True, eq=False)
class Curves:
    """What is plotted over the time of an episode, F values each."""

    time: np.ndarray
    """[s]."""
    height: np.ndarray
    """Of the object above where it was first [mm]."""
    slip: np.ndarray
    """How far the object has moved in the hand since the lift began [mm]; zero before it and after
    the hold."""
    force: np.ndarray
    """Sum of the forces on the object [N]; NaN where not known."""
    palm_error: np.ndarray
    """Distance of the palm from where it was told to be [mm]; NaN where not known."""


class EpisodeStates:
    """Frames of an episode, to which a simulation adds while a page reads."""

    def __init__(self) -> None:
        self._frames: list[EpisodeState] = []
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> EpisodeState:
        return self._frames[index]

    def add(self, frame: EpisodeState) -> None:
        """Add the next one."""
        with self._lock:
            self._frames.append(frame)

    def index_at(self, time: float) -> int:
        """The last frame that is not after a time [s]."""
        times = [frame.time for frame in self._frames]
        return max(int(np.searchsorted(times, time + 1e-6, side="right")) - 1, 0)

    def curves(self) -> Curves:
        """What is plotted."""
        with self._lock:
            frames = list(self._frames)
        time = np.array([frame.time for frame in frames])
        things = np.array([frame.object_pose for frame in frames])
        palms = np.array([frame.palm_pose for frame in frames])
        held = relative(palms, things)[:, :3]
        # A deployment puts the object down again, which is no slip.
        lifted = np.flatnonzero([frame.phase not in ("approach", "close") for frame in frames])
        slip = np.zeros(len(frames))
        if len(lifted):
            slip[lifted] = np.linalg.norm(held[lifted] - held[lifted[0]], axis=1)
        force = np.array([np.nan if f.forces is None else f.forces.sum() for f in frames])
        off = [
            np.nan if f.commanded_palm is None else np.linalg.norm(f.commanded_palm[:3] - f.palm_pose[:3])
            for f in frames
        ]
        return Curves(time, 1e3 * (things[:, 2] - things[0, 2]), 1e3 * slip, force, 1e3 * np.array(off))

    def as_trajectory(
        self, hand: str, object_name: str, mass: float, success: bool, reason: str
    ) -> Trajectory:
        """The episode as it is recorded by ``evaluate``, without the state of the simulation."""
        frames = list(self._frames)
        return Trajectory(
            hand=hand,
            object_name=object_name,
            object_mass=mass,
            index=0,
            success=success,
            reason=reason,
            times=np.array([f.time for f in frames]),
            qpos=np.zeros((len(frames), 0)),
            wrist_reference=np.array([0.0, 0, 0, 1, 0, 0, 0]),
            object_pose=np.array([f.object_pose for f in frames]),
            palm_pose=np.array([f.palm_pose for f in frames]),
            joint_positions=np.array([f.joints for f in frames]),
            link_contacts=np.array([f.contacts for f in frames]),
            phase=np.array([PHASES.index(f.phase) for f in frames]),
        )


def recorded_states(trajectory: Trajectory) -> EpisodeStates:
    """The frames of a recorded episode."""
    frames = EpisodeStates()
    for i, time in enumerate(trajectory.times):
        frames.add(
            EpisodeState(
                float(time),
                PHASES[int(trajectory.phase[i])],
                trajectory.object_pose[i].astype(float),
                trajectory.palm_pose[i].astype(float),
                trajectory.joint_positions[i].astype(float),
                trajectory.link_contacts[i],
            )
        )
    return frames
