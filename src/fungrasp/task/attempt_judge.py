"""Whether an attempt has failed, and where the object lies then: judged from observations alone, in
simulation and on robots alike.

A tracker that has not seen the object for a while says nothing: a hand that holds an object covers it, and
what was left behind is seen as soon as the hand is away. So a hand whose object is not seen is taken to hold
it.
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
"""Control steps in which a resting object is looked at, a second: jitter of 2 mm becomes less than 1 mm."""
FRESH = 0.3
"""A tracked pose that is older [s] says nothing: more than the tracker's delay and two missing frames."""
NEWEST = 5
"""The last frames, by whose median an attempt is judged: what is dropped in the last half second of the hold
has fallen in most of them."""
LEAST_RISE = LiftProtocol.success_height
"""An object whose center of mass is seen to have risen by less [m] is not held as it should be. Of 84
development grasps of the reality protocol, held objects were seen at 10.4 cm and more, and of those that were
not all but one (at 10.1 cm) below this."""
AT_REST = 0.005
"""An object rests if the first and the second half of the frames have it no farther apart [m]: jitter moves
means of five frames by less than 2 mm."""


class TrackedFrames:
    """The last ``FRAMES`` tracked poses of W objects."""

    def __init__(self, count: int):
        """count: W."""
        self._pose = np.full((FRAMES, count, 7), np.nan)
        self._age = np.full((FRAMES, count), np.inf)
        self._time = np.full(count, -np.inf)

    def add(self, observation: Observation, which: np.ndarray) -> None:
        """See a control step, in those worlds where it is a new one.

        Args:
            observation: of the W worlds.
            which: worlds that are looked at, shape [W] bool.
        """
        new = which & (observation.time > self._time)
        self._time[new] = observation.time[new]
        for kept, now in ((self._pose, observation.object_pose), (self._age, observation.object_pose_age)):
            kept[:-1, new] = kept[1:, new]
            kept[-1, new] = now[new]

    def seen(self, newest: int = FRAMES) -> np.ndarray:
        """Whether more than half of the last frames are fresh, shape [W] bool. newest: how many frames."""
        return (self._age[-newest:] <= FRESH).sum(axis=0) > newest // 2

    @property
    def at_rest(self) -> np.ndarray:
        """Whether the object is seen at one place all the time, shape [W] bool."""
        half = FRAMES // 2
        position = self._pose[..., :3]
        apart = np.linalg.norm(position[:half].mean(axis=0) - position[half:].mean(axis=0), axis=1)
        return self.seen() & (np.nan_to_num(apart, nan=np.inf) < AT_REST)

    def pose(self, newest: int = FRAMES) -> np.ndarray:
        """Mean of the fresh poses among the last frames, world frame, shape [W, 7]; NaN where there are none.
        newest: how many frames."""
        pose, fresh = self._pose[-newest:], self._age[-newest:] <= FRESH
        return np.stack([average_pose(pose[fresh[:, w], w]) for w in range(len(self._time))])


def average_pose(poses: np.ndarray) -> np.ndarray:
    """Mean of poses that are near one another, the position's median, shape [7]; NaN of none.

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
    """What is thought of W attempts."""

    seen: np.ndarray
    """Whether the object is seen at all, shape [W] bool."""
    missed: np.ndarray
    """Whether the object is seen not to be held as it should be, shape [W] bool."""
    rise: np.ndarray
    """How far its center of mass has risen [m], NaN where it is not seen, shape [W]."""
    gap: np.ndarray
    """How far its lowest point is above the table [m], zero where it is not seen, shape [W]."""


class AttemptJudge:
    """Watches W attempts until the end of the hold, and judges them by its last half second."""

    def __init__(self, plan: GraspPlan, objects: Mapping[str, ObjectModel]):
        """
        Args:
            plan: that is followed, W of them; it says where the objects were at rest.
            objects: by name, as they are believed to be.
        """
        self._plan = plan
        self._models = [objects[name] for name in plan.object_name.tolist()]
        self._frames = TrackedFrames(len(plan))

    def watch(self, observation: Observation) -> None:
        """See a control step. observation: of the W worlds."""
        self._frames.add(observation, observation.time_since_lift >= 0)

    def verdict(self) -> AttemptVerdict:
        """What is thought of the attempts now."""
        seen = self._frames.seen(NEWEST)
        pose = np.where(seen[:, None], self._frames.pose(NEWEST), self._plan.object_pose)
        rise = center_height(self._models, pose) - center_height(self._models, self._plan.object_pose)
        gap = lowest_height(self._models, pose) - lowest_height(self._models, self._plan.object_pose)
        missed = seen & (rise < LEAST_RISE)
        return AttemptVerdict(seen, missed, np.where(seen, rise, np.nan), np.maximum(gap, 0.0))


def center_height(models: list[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Heights of centers of mass [m], shape [W]. models: length W; pose: world frame, shape [W, 7]."""
    center = np.array([model.center_of_mass for model in models])
    return transform_points(pose, center[:, None])[:, 0, 2]


def lowest_height(models: list[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Heights of the objects' lowest points [m], shape [W]. models: length W; pose: world frame, shape
    [W, 7]."""
    return pose[:, 2] + lowest_above_origin(models, pose)
