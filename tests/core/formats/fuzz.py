"""Feeds damaged files to every reader, and counts what does not end in a ``FungraspError`` of one line.

    python tests/core/formats/fuzz.py --cases 1000 --seed 1 --only human-grasps,mesh-obj

A case depends on seed, kind and number alone. It is clean if the reader takes the file or refuses it in one
line, within 10 s of processor time and 2 GB. Prints a table and a line for each kind of fault, with the
number of its first case; exits with 1 if there is one. ``--keep FOLDER`` writes the files.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import logging
import os
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "helpers"))

from damage import damaged
from foreign_files import KINDS, Reader

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats import sandbox

SECONDS, BYTES = 10.0, 2 << 30
"""A case may take so much processor time [s] and memory."""


def processor_seconds() -> float:
    """Of this process, the one that reads files for it, and that one's children."""
    total = time.process_time()
    server = sandbox._server
    if server is not None:
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{server[1].pid}/stat").read_text().rsplit(")", 1)[1].split()
            total += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return total


def verdict(read: Reader, path: Path) -> tuple[str, float]:
    """What a reader does with a file, "" if it is clean, and how long it takes [s]."""
    before, memory = processor_seconds(), _memory()
    fault = ""
    try:
        read(path)
    except FungraspError as error:
        if "\n" in str(error) or not str(error):
            fault = "a message that is not one line"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__} in {Path(place.filename).name}:{place.name}"
    seconds = processor_seconds() - before
    if seconds > SECONDS:
        fault = fault or f"more than {SECONDS:g} s"
    if _memory() > max(memory, BYTES):
        fault = fault or "more than 2 GB"
    return fault, seconds


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def run_kind(
    kind: str, cases: int, seed: int, folder: Path, note: Callable[[int, str, Path], None]
) -> tuple[float, int]:
    """All cases of a kind; the longest time [s] and the largest memory [bytes]. note: is told of faults."""
    name, good, read = KINDS[kind](folder)
    longest = 0.0
    for number in range(cases):
        chance = random.Random(f"{seed} {kind} {number}")
        path = folder / name
        path.write_bytes(damaged(chance, name, good))
        fault, seconds = verdict(read, path)
        longest = max(longest, seconds)
        if fault:
            note(number, fault, path)
    return longest, _memory()


def _in_child(kind: str, options: argparse.Namespace) -> tuple[dict[str, list[int]], float, int, bool]:
    """A kind in a process of its own: faults by their words, longest time, memory, whether it came to its
    end."""
    here, there = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(here)
        faults: dict[str, list[int]] = collections.defaultdict(list)

        def note(number: int, fault: str, path: Path) -> None:
            faults[fault].append(number)
            if options.keep is not None:
                options.keep.mkdir(parents=True, exist_ok=True)
                (options.keep / f"{kind}-{number}-{path.name}").write_bytes(path.read_bytes())

        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            figures = run_kind(kind, options.cases, options.seed, Path(folder), note)
        with os.fdopen(there, "w") as stream:
            json.dump([faults, *figures], stream)
        os._exit(0)
    os.close(there)
    with os.fdopen(here) as stream:
        text = stream.read()
    os.waitpid(child, 0)
    return (*json.loads(text), True) if text else ({}, 0.0, 0, False)


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=100, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(KINDS))
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args(arguments)
    options.keep = None if options.keep is None else options.keep.absolute()
    kinds = options.only.split(",")
    unknown = sorted(set(kinds) - set(KINDS))
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; known: {', '.join(KINDS)}")
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    unclean = 0
    print(f"{'kind':16}{'cases':>8}{'unclean':>9}{'slowest [s]':>13}{'memory [MB]':>13}")
    for kind in kinds:
        faults, longest, memory, ended = _in_child(kind, options)
        count = sum(map(len, faults.values())) + (not ended)
        unclean += count
        print(f"{kind:16}{options.cases:8}{count:9}{longest:13.2f}{memory / 1e6:13.0f}", flush=True)
        for fault, numbers in faults.items():
            print(f"  {len(numbers)} times, first case {numbers[0]}: {fault}")
        if not ended:
            print("  the process ended before its last case")
    print(f"{len(kinds) * options.cases} cases, {unclean} not clean, seed {options.seed}")
    return 1 if unclean else 0


if __name__ == "__main__":
    sys.exit(main())
