"""A second attempt where the first one has not caught the object: lift a little, look, open, close again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.task import LiftProtocol, Observation


@dataclass(frozen=True)
class AttemptSettings:
    """How the lift is tested, and how the hand goes back."""

    rise: float = 0.03
    """Height by which the palm rises for the test [m]."""
    test_steps: int = 8
    """Control steps of the test: the wrist takes 0.63 s to rise by 3 cm and stop, and a tracker is late."""
    share: float = 0.25
    """Share of the palm's rise by which a caught object has risen at least; a long one first tilts, and what
    is seen is late."""
    frames: int = 3
    """Tracked heights whose mean is compared, before the test and at its end, as trackers jitter."""
    open_steps: int = 4
    """Control steps in which fingers open and the palm goes back."""
    back: int = 2
    """Control steps before the fingers close to which the plan is taken back."""
    stale: float = 0.25
    """Age from which a tracked pose tells nothing about the lift [s]: two missing frames and the longest
    delay make less."""
    links: int = 1
    """Links in touch with the object from which it is held, where the tracker tells nothing."""


class GraspAttempts:
    """How far W robots are in their plans, which have one test of the lift and one more attempt.

    The hand rises a little before the lift. If the tracked object has risen with it, the lift begins. Where
    the tracker has lost the object, contacts decide, if they are known, else it is lifted. If the object has
    stayed behind, and there is time, the plan is taken back to shortly before the fingers close: its origin
    then goes to where the object is seen now.
    """

    def __init__(self, count: int, settings: AttemptSettings | None = None):
        """
        Args:
            count: W.
            settings: the defaults if None.
        """
        self.settings = settings or AttemptSettings()
        self.step = np.zeros(count, dtype=int)
        """Control step of the plan, shape [W]."""
        self.raised = np.zeros(count)
        """Height by which the palm's goal is raised for the test [m], shape [W]."""
        self.lifting = np.zeros(count, dtype=bool)
        """Whether the lift may begin, shape [W]."""
        self.failed = np.zeros(count, dtype=bool)
        """Whether the first attempt has not caught the object, shape [W]."""
        self.followed = np.zeros(count, dtype=int)
        """Control steps since the plan's origin has begun to follow the object, shape [W]."""
        self._behind = np.zeros(count, dtype=int)
        self._began = np.full(count, -1)
        self._height = np.zeros((2, count))
        """Heights of object and palm before the test [m], shape [2, W]."""
        self._seen = np.full((self.settings.frames, count), np.nan)
        """Last heights of the tracked object [m], the newest last, shape [frames, W]; NaN where none was."""

    def begin(self, ids: np.ndarray, clock: np.ndarray) -> None:
        """New episodes in some worlds.

        Args:
            ids: worlds, shape [I].
            clock: control step at which they begin, shape [W] int.
        """
        self.step[ids], self._began[ids], self._seen[:, ids] = clock[ids], -1, np.nan
        for values in (self.raised, self.lifting, self.failed, self.followed, self._behind):
            values[ids] = 0

    def update(
        self,
        observation: Observation,
        clock: np.ndarray,
        closing_step: np.ndarray,
        lift_step: np.ndarray,
        touching: np.ndarray | None = None,
    ) -> None:
        """Go on by a control step.

        Args:
            observation: of all W worlds.
            clock: control steps since the plans began, shape [W] int.
            closing_step: of the plans, shape [W] int.
            lift_step: of the plans, shape [W] int.
            touching: number of links that touch the object, as far as is known, shape [W]; None if nothing
                is known.
        """
        s = self.settings
        start = closing_step - s.back
        self.step = np.where(self.failed, np.maximum(clock - self._behind, start), clock)
        self.followed += 1
        self._seen = np.concatenate([self._seen[1:], observation.object_pose[None, :, 2]])
        lost_sight = observation.object_pose_age > s.stale
        known = ~lost_sight if touching is None else np.ones(len(clock), dtype=bool)
        last = round(LiftProtocol.approach_time / LiftProtocol.control_period)
        need = s.test_steps + s.open_steps + s.back + lift_step - closing_step
        arrived = ~self.lifting & (self._began < 0) & (self.step >= lift_step)
        tests = arrived & known & ~self.failed & (clock + need <= last)
        self._began = np.where(tests, clock, self._began)
        # Plans are longer than the frames: none is missing by the time of the test.
        heights = np.stack([self._seen.mean(axis=0), observation.palm_pose[:, 2]])
        self._height = np.where(tests, heights, self._height)
        over = (self._began >= 0) & (clock - self._began >= s.test_steps)
        thing, palm = heights - self._height
        caught = thing > s.share * palm
        if touching is not None:
            caught = np.where(lost_sight, touching >= s.links, caught)
        else:
            caught = caught | lost_sight
        missed = over & ~caught
        self.lifting |= (arrived & ~tests) | (over & caught) | (observation.time_since_lift >= 0)
        self._behind = np.where(missed, clock - (start - s.open_steps), self._behind)
        self.step = np.where(missed, start, self.step)
        self.failed |= missed
        self.followed = np.where(missed, 0, self.followed)
        self._began = np.where(over, -1, self._began)
        self.raised = np.where((self._began >= 0) & ~self.lifting, s.rise, 0.0)
