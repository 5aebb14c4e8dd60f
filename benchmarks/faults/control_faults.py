"""What arm and hand do when the computer that controls them fails: short deployments over emulated wires,
each spoiled at a random moment."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.faults.control_bench import ControlBench
from benchmarks.faults.control_process import ControlProcess
from benchmarks.faults.control_session import INSIDE, ControlFault, ControlSession, run_session
from benchmarks.faults.reaction_times import ReactionTrial, motion_after
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.log import read_log
from fungrasp.robots.arms.ur import URSettings
from fungrasp.robots.control_loop.loop_driver import DRIVER_TIMEOUT

LIMITS = {
    ControlFault.POLICY_NAN: (0.1, 0.1),
    ControlFault.DISK_FULL: (0.1, 0.1),
    ControlFault.HUNG: (DRIVER_TIMEOUT, DRIVER_TIMEOUT),
    ControlFault.KILLED: (1.0 / URSettings.watchdog, 1.0 / URSettings.watchdog),
    ControlFault.ALL_KILLED: (1.0 / URSettings.watchdog, None),
}
"""When each fault should be over, of arm and hand [s]: answers and the log are checked in every control step;
drivers hold when they hear nothing for ``DRIVER_TIMEOUT``; they end with the input that the control process
holds open, which should take no longer than the watchdog of the arm's controller; where they are gone, too,
there is that watchdog, and nothing of a hand's."""
WATCHED = 1.5
"""Time that is watched after a fault [s]."""
BEGIN_TIMEOUT = 60.0
"""A session that has not begun to move after this never will [s]; a busy machine takes long to connect."""
LOG_PERIOD = 0.1
"""The log is flushed at every control step [s]: so much of it may be missing when its writer is killed."""
MOMENT = (0.5, 1.2)
"""When a fault comes, since the motion began [s]: while palm and fingers move fast."""
SAMPLE = 0.004
"""Time between two looks at the joints [s]."""


def control_reactions(
    bench: ControlBench, fault: ControlFault, count: int, rng: np.random.Generator
) -> Iterator[ReactionTrial]:
    """Trials of one fault, two rows each: of the arm and of the hand.

    Args:
        bench: not entered.
        fault: what happens.
        count: of trials.
        rng: of the time at which the fault comes.
    """
    with bench, TemporaryDirectory(prefix="fungrasp-") as folder:
        pending: list[ReactionTrial] = []
        # Another session than those that are spoiled shows whether the last one could be restarted.
        for number in range(count + 1):
            last = number == count
            log = Path(folder) / f"{number}.mcap"
            bench.put_back()
            with _Session(bench, None if last else fault, log, rng.uniform(*MOMENT)) as session:
                moving = session.begins()
                yield from (replace(trial, restarted=moving) for trial in pending)
                pending = []
                if not last:
                    pending = session.spoiled(fault) if moving else [_false_alarm(session.said)]
            log.unlink(missing_ok=True)


def _false_alarm(said: str) -> ReactionTrial:
    return ReactionTrial("control", f"none: {said}", None, None, "", 0.0, False)


@dataclass(frozen=True, eq=False)
class _Watched:
    """Joints after a fault, and when each device no longer followed commands."""

    times: np.ndarray
    joints: dict[str, np.ndarray]
    let_go: dict[str, float | None]


class _Session(ControlProcess):
    """One process of control and what it says."""

    def __init__(self, bench: ControlBench, fault: ControlFault | None, log: Path, after: float):
        self._bench, self._log, self._after = bench, log, after
        inside = fault if fault in INSIDE else None
        session = ControlSession(bench.cell, bench.grasp, bench.prepared, log, inside, after)
        super().__init__(run_session, session)
        self.said = ""

    def begins(self) -> bool:
        """Wait until it moves; whether it does."""
        deadline = time.monotonic() + BEGIN_TIMEOUT
        while time.monotonic() < deadline and "moving" not in self.heard:
            self.listen(0.05)
            if "ended" in self.heard or not self.alive:
                break
        self.said = str(self.heard["ended"][1]) if "ended" in self.heard else "it did not begin"
        return "moving" in self.heard

    def spoiled(self, fault: ControlFault) -> list[ReactionTrial]:
        """Let the fault come; what arm and hand do."""
        when = self._brought(fault)
        if when is None:
            return [_false_alarm(self.said)]
        seen = self._watch(when)
        self.listen(0.0)
        ended = self.heard.get("ended")
        reacted = None if ended is None or not np.isfinite(ended[2]) else float(ended[2]) - when
        # Those that are stopped say nothing more.
        self.signal(signal.SIGKILL)
        readable = _readable(self._log, when)
        what = "" if ended is None else str(ended[1])
        rows = []
        for name, limit in zip(("arm", "hand"), LIMITS[fault], strict=True):
            stopped, fastest = motion_after(seen.times, seen.joints[name], self._bench.limits[name])
            rows.append(
                ReactionTrial(
                    f"{self._bench.cell.name}: {name}",
                    fault.value,
                    seen.let_go[name] if reacted is None else reacted,
                    stopped,
                    what,
                    fastest,
                    False,
                    limit,
                    readable,
                )
            )
        return rows

    def _brought(self, fault: ControlFault) -> float | None:
        """When the fault came [s]; None where the session ended before."""
        if fault in INSIDE:
            deadline = time.monotonic() + 30.0
            while "fault" not in self.heard and time.monotonic() < deadline:
                self.listen(0.02)
                if "ended" in self.heard and "fault" not in self.heard:
                    break
            return self.heard["fault"][0] if "fault" in self.heard else self._ended_early()
        while time.monotonic() < self.heard["moving"][0] + self._after:
            self.listen(0.01)
        if "ended" in self.heard or not self.alive:
            # Its last words may still be on their way.
            self.listen(0.1)
            return self._ended_early()
        when = time.monotonic()
        if fault is ControlFault.ALL_KILLED:
            # They first: as the control process ends, each would switch its device off.
            self.kill_drivers()
        self.signal(signal.SIGSTOP if fault is ControlFault.HUNG else signal.SIGKILL)
        return when

    def _ended_early(self) -> None:
        self.said = f"false alarm, {self.heard['ended'][1]}" if "ended" in self.heard else "no fault came"

    def _watch(self, since: float) -> _Watched:
        bench = self._bench
        following = {"arm": lambda: bench.arm.program_running, "hand": bench.hand_follows}
        plants = {"arm": bench.arm_plant, "hand": bench.hand_plant}
        times, joints = [], {name: [] for name in plants}
        let_go: dict[str, float | None] = dict.fromkeys(plants)
        while (now := time.monotonic()) - since < WATCHED:
            times.append(now - since)
            for name, plant in plants.items():
                joints[name].append(plant.state(time.monotonic()).positions)
                if let_go[name] is None and not following[name]():
                    let_go[name] = time.monotonic() - since
            time.sleep(SAMPLE)
        return _Watched(np.array(times), {name: np.array(rows) for name, rows in joints.items()}, let_go)


def _readable(log: Path, when: float) -> bool:
    """Whether a log can be read up to a time [s]."""
    try:
        messages = read_log(log).messages["/setpoint"]
    except FungraspError:
        return False
    return bool(messages) and float(messages[-1]["time"]) > when - LOG_PERIOD - 0.1
