"""``python -m benchmarks.faults``: how drivers react to faults of emulated devices."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar, table
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.deployment.spec import GraspChoice

if TYPE_CHECKING:
    import numpy as np

    from benchmarks.faults.control_bench import ControlBench
    from benchmarks.faults.reaction_times import ReactionTrial
    from fungrasp_emulators.emulator import Fault


@dataclass(frozen=True)
class BenchFaults:
    """Measure how drivers react to faults of emulated devices, while the joints move."""

    devices: tuple[str, ...] = ()
    """Devices to measure: ur, allegro-v4, allegro-v5, inspire, inspire-serial, inspire-eb90, leap, tracker,
    and control-allegro and control-inspire, the computer that controls a UR5e with that hand; all by
    default."""
    faults: tuple[str, ...] = ()
    """Faults to bring, as the table names them ("frames lost"); all by default."""
    trials: int = 50
    """Of each fault."""
    patience: float = 1.0
    """Times the drivers' usual limits of silence: a machine with other work needs more."""
    seed: int = 0
    """Decides when the faults come."""
    json: Path | None = None
    """Write every trial here (.json, with a .csv beside)."""

    def run(self) -> None:
        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.robots.process_priority import raise_priority

        if self.trials < 1:
            raise FungraspError(f"--trials must be 1 or more, not {self.trials}")
        trials: list[ReactionTrial] = []
        plan = self._plan()
        # Real devices don't wait for a computer's other work.
        raise_priority()
        with progress_bar("faults", float(len(plan) * self.trials)) as show:
            for done, (_, _, series) in enumerate(plan):
                for number, trial in enumerate(series()):
                    trials.append(trial)
                    show(min(done * self.trials + number + 1.0, (done + 1.0) * self.trials))
                if self.json is not None:
                    write_result(self.json, run_record(self.seed), [asdict(trial) for trial in trials])
        print(table(reaction_rows(trials)))
        print(f"against emulated devices, which share this machine; {machine()}")

    def _plan(self) -> list[tuple[str, str, Callable[[], Iterable[ReactionTrial]]]]:
        """Device, fault and trials of each series."""
        import os

        import numpy as np

        from benchmarks.faults.control_bench import CONTROL
        from benchmarks.faults.control_faults import control_reactions
        from benchmarks.faults.control_session import ControlFault
        from benchmarks.faults.reaction_times import PROCESS_KILLED
        from benchmarks.faults.tracker_faults import FAULTS, TRACKER, tracker_reactions
        from fungrasp.robots.cell import load_cell
        from fungrasp_emulators.devices import EMULATED, known_devices
        from fungrasp_emulators.emulator import Fault

        rng, count = np.random.default_rng(self.seed), self.trials
        plan: list[tuple[str, str, Callable[[], Iterable[ReactionTrial]]]] = []
        for name in known_devices(self.devices, (TRACKER, *CONTROL)):
            if name == TRACKER:
                cell, address = load_cell("ur5e-allegro"), f"ipc:///tmp/fungrasp-{os.getpid()}"
                plan += [
                    (name, fault, partial(tracker_reactions, cell, fault, count, rng, address))
                    for fault in FAULTS
                ]
            elif name in CONTROL:
                bench = self._control_bench(*CONTROL[name])
                plan += [
                    (name, fault, partial(control_reactions, bench, fault, count, rng))
                    for fault in ControlFault
                ]
            else:
                device = EMULATED[name](1.0)
                device.emulator.close()
                faults = [f for f in sorted(device.emulator.supported) if f != Fault.WRONG_DEVICE]
                plan += [
                    (name, fault, partial(_trials, name, self.patience, fault, count, rng))
                    for fault in [*faults, PROCESS_KILLED]
                ]
        chosen = [row for row in plan if not self.faults or row[1] in self.faults]
        for fault in self.faults:
            if fault not in [row[1] for row in plan]:
                raise UnknownNameError("fault", fault, dict.fromkeys(row[1] for row in plan))
        return chosen

    def _control_bench(self, robot: str, grasp: str) -> ControlBench:
        from benchmarks.faults.control_bench import ControlBench
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell

        cell = load_cell(robot)
        chosen, objects = GraspChoice(grasp=grasp, threads=1).robot(load_hand(cell.hand))
        return ControlBench(cell, chosen, objects[str(chosen.object_name[0])], self.patience)


def _trials(
    name: str, patience: float, fault: Fault | str, count: int, rng: np.random.Generator
) -> Iterator[ReactionTrial]:
    """Trials of one fault of a device, which is made for them."""
    from benchmarks.faults.reaction_times import reaction_trials
    from fungrasp_emulators.devices import EMULATED

    yield from reaction_trials(EMULATED[name](patience), fault, count, rng)


def reaction_rows(trials: list[ReactionTrial]) -> list[tuple[str, ...]]:
    """Table of trials by device and fault, with its head."""
    import numpy as np

    def times(values: list[float | None]) -> str:
        known = [1e3 * v for v in values if v is not None]
        return f"{np.median(known):.0f} / {max(known):.0f}" if known else "–"

    head = ("device", "fault", "trials", "detected", "median / max [ms]", "stopped", "median / max [ms]")
    rows: list[tuple[str, ...]] = [(*head, "speed / limit", "log read", "restarted")]
    for device, fault in dict.fromkeys((t.device, t.fault) for t in trials):
        group = [t for t in trials if (t.device, t.fault) == (device, fault)]
        seen = [t.detected for t in group]
        stopped = [t.stopped for t in group]
        rows.append(
            (
                device,
                fault,
                str(len(group)),
                str(sum(v is not None for v in seen)),
                times(seen),
                str(sum(v is not None for v in stopped)),
                times(stopped),
                f"{max(t.speed_share for t in group):.2f}",
                str(sum(bool(t.log_readable) for t in group)),
                str(sum(t.restarted for t in group)),
            )
        )
    return rows


COMMAND = BenchFaults
