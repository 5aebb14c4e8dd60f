"""A process with the emulators of a cell and one twin: ``python -m benchmarks.wire.emulation_worker``.

Standard input carries the pickled task and stays open: its end ends the emulation. Standard output carries
one line of JSON when the emulators are ready, and one with the truth when they have ended.
"""

from __future__ import annotations

import json
import pickle
import struct
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.control_loop.loop_driver import worker_environment
from fungrasp.robots.twin.judge import HoldSample, hold_sample
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp_emulators.cell import CellEmulation

LENGTH = struct.Struct("<I")
SAMPLE_PERIOD = 0.02
"""Time between two looks at the truth [s]."""
END_TIMEOUT = 20.0
"""An emulation that takes longer to end is killed [s]."""


@dataclass(frozen=True, eq=False)
class EmulationTask:
    """What is emulated."""

    cell: RobotCell
    """Whose addresses are on the loopback."""
    thing: ObjectModel
    """The object as it is believed."""
    placement: np.ndarray
    """Where it is put, world frame, shape [7]."""
    twin: int
    """Which twin."""


@dataclass(frozen=True)
class EmulationRecord:
    """What was true, from the emulators' readiness to their end."""

    samples: list[HoldSample]
    """Every 20 ms."""
    processor_time: float
    """Of the process meanwhile [s]."""
    seconds: float
    """Meanwhile [s]."""
    late: float
    """How far the twin fell behind the clock at worst [s]."""
    lost: float
    """Time that it lost in all [s]."""


class EmulationProcess:
    """Emulates a cell in a process of its own; a context manager."""

    def __init__(self, task: EmulationTask):
        """task: what is emulated."""
        self._child = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.wire.emulation_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=Path(__file__).parents[2],
            env=worker_environment(),
            start_new_session=True,
        )
        self._data = pickle.dumps(task)

    def __enter__(self) -> Self:
        assert self._child.stdin is not None
        self._child.stdin.write(LENGTH.pack(len(self._data)) + self._data)
        self._child.stdin.flush()
        answer = self._line()
        if "error" in answer:
            self.__exit__()
            raise FungraspError(answer["error"])
        return self

    def __exit__(self, *error: object) -> None:
        assert self._child.stdin is not None and self._child.stdout is not None
        self._child.stdin.close()
        try:
            self._child.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._child.stdout.close()

    def end(self) -> EmulationRecord:
        """End the emulation; what was true."""
        assert self._child.stdin is not None
        self._child.stdin.close()
        answer = self._line()
        samples = [HoldSample(**sample) for sample in answer.pop("samples")]
        return EmulationRecord(samples=samples, **answer)

    def _line(self) -> dict[str, Any]:
        assert self._child.stdout is not None
        line = self._child.stdout.readline()
        if not line:
            raise FungraspError("the process of the emulators has ended by itself")
        return json.loads(line)


def run_emulation() -> None:
    """Run the task that stands on standard input."""
    source = sys.stdin.buffer
    # From the process that started this one, through its own pipe.
    task: EmulationTask = pickle.loads(source.read(LENGTH.unpack(source.read(LENGTH.size))[0]))
    ended = threading.Event()

    def watch() -> None:
        source.read()
        ended.set()

    hand = load_hand(task.cell.hand)
    truth = cell_twin(task.cell, hand, task.twin)
    world = TwinWorld(task.cell, hand, task.thing, truth)
    world.settle(task.placement)
    settled = float(world.center_of_mass()[2])
    samples: list[HoldSample] = []
    try:
        with CellEmulation(task.cell, world, task.thing.name) as emulation:
            _say({"ready": True})
            threading.Thread(target=watch, daemon=True).start()
            began, busy = time.monotonic(), time.process_time()
            while not ended.wait(SAMPLE_PERIOD):
                samples.append(hold_sample(world, settled))
            record = EmulationRecord(
                samples,
                time.process_time() - busy,
                time.monotonic() - began,
                emulation.twin.latest,
                emulation.twin.lost,
            )
    except FungraspError as error:
        _say({"error": str(error)})
        return
    _say(asdict(record))


def _say(what: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    run_emulation()
