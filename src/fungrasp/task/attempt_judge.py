"""Judge from observations alone whether an attempt has failed, in simulation and on robots.

A hand hides the object that it holds, and a lost object is visible once the hand is away. An object that the
tracker does not see is therefore taken to be held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import transform_points
from fungrasp.objects import ObjectModel
from fungrasp.task.grasp_plan import GraspPlan
from fungrasp.task.object_placement import lowest_above_origin
from fungrasp.task.policy import Observation
from fungrasp.task.protocol import LiftProtocol

FRAMES = 10
"""Control steps of observing a resting object (1 s): averaging reduces 2 mm of jitter to less than 1 mm."""
FRESH = 0.3
"""Largest age of a usable tracked pose [s]: more than the tracker's delay and two missing frames."""
NEWEST = 5
"""Latest frames whose median judges an attempt; an object dropped in the last half second of the hold has
fallen in most of them."""
LEAST_RISE = LiftProtocol.success_height
"""Smallest tracked rise of the center of mass of a held object [m]. In 84 development grasps of the reality
protocol, held objects were seen at 10.4 cm or more, and all others but one (at 10.1 cm) below this."""
AT_REST = 0.005
"""Largest distance between the mean positions of the first and the second half of the frames of a resting
object [m]; jitter moves means of five frames by less than 2 mm."""


class TrackedFrames:
    """The last ``FRAMES`` tracked poses of W objects."""

    def __init__(self, count: int):
        """count: W."""
        self._pose = np.full((FRAMES, count, 7), np.nan)
        self._age = np.full((FRAMES, count), np.inf)
        self._time = np.full(count, -np.inf)

    def add(self, observation: Observation, which: np.ndarray) -> None:
        """Add a control step in the worlds where it is new.

        Args:
            observation: W rows.
            which: observed worlds, shape [W] bool.
        """
        new = which & (observation.time > self._time)
        self._time[new] = observation.time[new]
        for kept, now in ((self._pose, observation.object_pose), (self._age, observation.object_pose_age)):
            kept[:-1, new] = kept[1:, new]
            kept[-1, new] = now[new]

    def seen(self, newest: int = FRAMES) -> np.ndarray:
        """Return whether most of the last frames are fresh, shape [W] bool. newest: number of frames."""
        return (self._age[-newest:] <= FRESH).sum(axis=0) > newest // 2

    @property
    def at_rest(self) -> np.ndarray:
        """Whether the object is seen and has not moved during the frames, shape [W] bool."""
        half = FRAMES // 2
        position = self._pose[..., :3]
        apart = np.linalg.norm(position[:half].mean(axis=0) - position[half:].mean(axis=0), axis=1)
        return self.seen() & (np.nan_to_num(apart, nan=np.inf) < AT_REST)

    def pose(self, newest: int = FRAMES) -> np.ndarray:
        """Return the average fresh pose (``average_pose``) of the last frames, world frame, shape [W, 7].
        newest: number of frames."""
        pose, fresh = self._pose[-newest:], self._age[-newest:] <= FRESH
        return np.stack([average_pose(pose[fresh[:, w], w]) for w in range(len(self._time))])


def average_pose(poses: np.ndarray) -> np.ndarray:
    """Return the median position and mean rotation of similar poses, shape [7]; NaN without poses.

    Args:
        poses: shape [N, 7].
    """
    if not len(poses):
        return np.full(7, np.nan)
    turns = poses[:, 3:] * np.sign(poses[:, 3:] @ poses[-1, 3:])[:, None]
    turn = turns.mean(axis=0)
    return np.concatenate([np.median(poses[:, :3], axis=0), turn / np.linalg.norm(turn)])


@dataclass(frozen=True, eq=False, repr=False)
class AttemptVerdict(BatchRecord):
    """Verdicts on W attempts."""

    seen: np.ndarray
    """Whether the object is seen, shape [W] bool."""
    missed: np.ndarray
    """Whether the object is seen to have risen by less than ``LEAST_RISE``, shape [W] bool."""
    rise: np.ndarray
    """Rise of its center of mass [m], NaN if it is not seen, shape [W]."""
    gap: np.ndarray
    """Height of its lowest point above the table [m], zero if it is not seen, shape [W]."""


class AttemptJudge:
    """Watches W attempts until the end of the hold, and judges them by its last half second."""

    def __init__(self, plan: GraspPlan, objects: Mapping[str, ObjectModel]):
        """
        Args:
            plan: plans that are followed, W of them; their object poses are the rest poses.
            objects: believed object models, by name.
        """
        self._plan = plan
        self._models = [objects[name] for name in plan.object_name.tolist()]
        self._frames = TrackedFrames(len(plan))

    def watch(self, observation: Observation) -> None:
        """Add a control step. observation: observation of the W worlds."""
        self._frames.add(observation, observation.time_since_lift >= 0)

    def verdict(self) -> AttemptVerdict:
        """Return the current verdicts."""
        seen = self._frames.seen(NEWEST)
        pose = np.where(seen[:, None], self._frames.pose(NEWEST), self._plan.object_pose)
        rise = center_height(self._models, pose) - center_height(self._models, self._plan.object_pose)
        gap = lowest_height(self._models, pose) - lowest_height(self._models, self._plan.object_pose)
        missed = seen & (rise < LEAST_RISE)
        return AttemptVerdict(seen, missed, np.where(seen, rise, np.nan), np.maximum(gap, 0.0))


def center_height(models: list[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Return heights of centers of mass [m], shape [W]. models: length W; pose: world frame, shape [W, 7]."""
    center = np.array([model.center_of_mass for model in models])
    return transform_points(pose, center[:, None])[:, 0, 2]


def lowest_height(models: list[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Return heights of the objects' lowest points [m], shape [W]. models: length W; pose: world frame, shape
    [W, 7]."""
    return pose[:, 2] + lowest_above_origin(models, pose)
