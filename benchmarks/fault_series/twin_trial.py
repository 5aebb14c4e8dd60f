"""A fault on a twin's own clock."""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from benchmarks.fault_series.moments import Scene, TwinRun, twin_run, twin_world
from benchmarks.fault_series.trial import WATCHED, Drawn, FaultTrial, TruthWatch, judged
from fungrasp.deployment.hold_after_stop import endings_as_interrupts
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.twin.devices import TwinClock
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import Action, Observation

SAMPLE = 0.02
"""Time between two looks at the truth [s]."""
HANGING = 0.4
"""How long a computer hangs [s]."""


class FaultClock(TwinClock):
    """A twin's clock on which something happens at a time; from then on the truth is watched."""

    def __init__(self, world: TwinWorld, when: float):
        """
        Args:
            when: it happens [s].
        """
        super().__init__(world)
        self._when, self.happen, self.watch = when, lambda: None, TruthWatch(world)

    happen: Callable[[], None]
    """What happens; may raise."""

    def sleep_until(self, when: float) -> None:
        if not self.watch.times and when >= self._when:
            super().sleep_until(self._when)
            self.watch.look()
            self.happen()
        if not self.watch.times:
            super().sleep_until(when)
            return
        while self.now() < when - 1e-6:
            super().sleep_until(min(when, self.now() + SAMPLE))
            self.watch.look()


class SpoiledPolicy(OpenLoopPolicy):
    """Does something else once it is told to."""

    def __init__(self) -> None:
        self.spoil: Callable[[Action], object] = lambda action: None
        """What it does to its action."""

    def act(self, observation: Observation) -> Action:
        action = super().act(observation)
        self.spoil(action)
        return action


class FullLog(DeploymentObserver):
    """Can't be written once the disk is full."""

    def __init__(self) -> None:
        self.full = False
        """Whether it is."""

    def _write(self, *given: Any) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    planned = setpoint = step = phase = note = _write  # pyright: ignore[reportAssignmentType]


def twin_trial(scene: Scene, drawn: Drawn) -> FaultTrial:
    """A deployment on a fresh twin, with a fault.

    Args:
        drawn: the fault; one that is brought on a twin.
    """
    world = twin_world(scene.cell, scene.hand, scene.obj, scene.twin)
    world.settle(scene.placement)
    event, after = drawn.after(scene)
    clock = FaultClock(world, scene.events[event] + after)
    policy, log = SpoiledPolicy(), FullLog()
    run = twin_run(world, scene.cell, scene.hand, scene.prepared, policy, clock=clock, log=log)
    clock.happen = lambda: _bring(drawn.kind.name, run, policy, log)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with run.robot, endings_as_interrupts():
            # An error of the policy's is raised anew.
            with suppress(ZeroDivisionError):
                run.deployment.run(scene.grasp)
            clock.sleep_until(world.time + WATCHED)
    finally:
        signal.signal(signal.SIGINT, before)
    return judged(
        scene,
        drawn,
        clock.watch,
        ended=run.deployment.phase,
        when=clock.watch.times[0],
        reason=run.deployment.fault,
        lifted=run.judge.success,
    )


def _bring(name: str, run: TwinRun, policy: SpoiledPolicy, log: FullLog) -> None:
    arm, hand = run.robot.arm, run.robot.hand_driver
    if name in ("arm silent", "hand silent"):
        device: Any = arm if name == "arm silent" else hand
        device.read()
        device.frozen = True
    elif name == "fault of the hand":
        hand.fault = "motor hot"  # pyright: ignore[reportAttributeAccessIssue]
    elif name == "tracker jumps":
        _jump(run.world)
    elif name == "tracker silent":
        run.world.tracking = False
    elif name == "disk full":
        log.full = True
    elif name == "Ctrl-C":
        signal.raise_signal(signal.SIGINT)
    elif name == "stop key":
        run.robot.switch.press("the stop key was pressed")
    elif name == "error in the policy":
        policy.spoil = _error
    elif name == "policy returns NaN":
        policy.spoil = lambda action: action.palm_goal_world.fill(np.nan)
    elif name == "computer hangs":
        policy.spoil = lambda action: run.robot.clock.sleep_until(run.world.time + HANGING)
    else:
        raise AssertionError(name)


def _error(action: Action) -> None:
    raise ZeroDivisionError("made up")


def _jump(world: TwinWorld) -> None:
    """From now on every other pose of the tracker is beside the object."""
    original, count = world._track, 0

    def track() -> None:
        nonlocal count
        before = len(world._frames)
        original()
        if len(world._frames) > before:
            count += 1
            world._frames[-1].pose_world_object[0] += 0.2 * (count % 2)

    world._track = track
