"""``fungrasp robots bring-up``: run a checklist of commands before a robot's first grasp."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import strftime
from typing import TYPE_CHECKING

from fungrasp import deployment
from fungrasp.cli.options import CellName, wired_cell
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.deployment.spec import GraspChoice

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.robots.cell import RobotCell

CHECKLIST = Path(deployment.__file__).with_name("bring_up.toml")
"""File of the steps, which explains their fields."""

STOP_AFTER = 4.0
"""Time after the start of a command at which the stop file is made, without an operator [s]."""

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
"""Results of a step."""

YES, SKIP = "yes", "skip"
"""Answers of the operator; a reason follows "skip"."""

TITLE = "# Bring-up of "
_SECTION = re.compile(r"^## (?P<step>[a-z-]+): (?P<status>passed|failed|skipped)$", re.MULTILINE)


@dataclass(frozen=True)
class BringUpStep:
    """A step of the checklist."""

    name: str
    """Name in the log."""
    sentence: str
    """Description of the step and of its check."""
    words: tuple[str, ...]
    """Command line, without "fungrasp"."""
    question: str = ""
    """Question to the operator after the command; "" if the command itself reports success."""
    stop: str = ""
    """How the operator must stop the command during motion: "key", "file", or "" if not at all."""
    file: bool = False
    """Whether the step needs the file of touched points."""


@dataclass(frozen=True)
class BringUp:
    """Run a checklist before a robot's first grasp, up to a lift in slow motion. Output and your answers are
    logged. Run the same command again to continue."""

    cell: CellName
    """A robot cell with real or emulated devices (not a twin): built-in, or a TOML file."""
    log: Path = Path("bring-up.md")
    """Markdown log. If it exists, continue at the first step that neither passed nor was skipped."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp for the last steps."""
    policy: str = "plan"
    """Policy that moves the hand: "plan" or "reference"."""
    speed: float = 0.1
    """Speed of the last steps, as a share of the cell's speed."""
    touched: Path | None = None
    """JSON file of `robots touch`."""
    start: str = ""
    """Start from this step, even if it has passed."""
    yes: bool = False
    """Answer yes to all questions; for emulated devices only."""
    seed: int = 0
    """Seed of the plan."""

    def run(self) -> None:
        from fungrasp.core.files import digest
        from fungrasp.robots.cell import is_wired

        cell, hand = wired_cell(self.cell)
        if is_wired(cell) and (self.yes or not sys.stdin.isatty()):
            raise FungraspError("a real robot needs a person at a terminal: no --yes, no pipe")
        log = BringUpLog(self.log, cell.name, digest(cell, hand)[:12])
        steps = self.steps(cell, hand)
        names = [step.name for step in steps]
        if self.start and self.start not in names:
            raise UnknownNameError("step", self.start, names)
        done = [name for name, status in log.done.items() if status != FAILED]
        undone = (number for number, name in enumerate(names) if name not in done)
        first = names.index(self.start) if self.start else next(undone, len(names))
        if first:
            print(f"{self.log}: {first} of {len(names)} steps are done", flush=True)
        if log.other_cell:
            print(f"the cell has changed since then; '--start {names[0]}' starts over")
        for number, step in enumerate(steps[first:], first + 1):
            print(f"[{number}/{len(names)}] {step.name}: {step.sentence}", flush=True)
            status, lines = self._done(step, cell)
            log.append(step, status, lines)
            print(f"  {status}", flush=True)
            if status == FAILED:
                raise FungraspError(
                    f"the step '{step.name}' failed; run the same command to repeat it ({self.log})"
                )
        print(f"bring-up complete; the log is {self.log}", flush=True)

    def steps(self, cell: RobotCell, hand: Hand) -> list[BringUpStep]:
        """Return the checklist of a cell."""
        from fungrasp.core.formats.text_files import read_toml
        from fungrasp.robots.single_devices import joint_names

        given = {name: value for name, value in vars(self.choice).items() if value is not None}
        given |= {"policy": self.policy, "seed": self.seed}
        options = [word for option, value in given.items() for word in (f"--{option}", str(value))]
        options += ["--picture", str(self.log.with_name(f"{self.log.stem}-plan.png"))]
        meant = {
            "CELL": [self.cell],
            "LAST": [joint_names("arm", cell, hand)[-1]],
            "TOUCHED": ["--touched", str(self.touched)] if self.touched else [],
            "DEPLOY": options,
            "SLOW": [*options, "--speed", f"{self.speed:g}"],
        }
        steps = []
        for step in read_toml(CHECKLIST, "checklist")["step"]:
            step["words"] = tuple(word for name in step["words"] for word in meant.get(name, [name]))
            step["sentence"] = step["sentence"].replace("STOP_FILE", cell.stop_file)
            steps.append(BringUpStep(**step))
        return [step for step in steps if step.name != "stop-file" or cell.stop_file]

    def _done(self, step: BringUpStep, cell: RobotCell) -> tuple[str, list[str]]:
        """Run a step. Return its result and lines for the log."""
        from fungrasp.robots.single_devices import STAYS

        unattended = self.yes or not sys.stdin.isatty()
        if step.file and self.touched is None and unattended:
            return SKIPPED, ["no touched points (--touched FILE)"]
        if step.stop == "key" and unattended:
            return SKIPPED, ["nobody is at the keyboard"]
        answer = self._ask(f"  Type '{YES}' to begin, '{SKIP} WHY' to leave it out: ")
        word, _, why = answer.partition(" ")
        if word.lower() == SKIP:
            return SKIPPED, [why.strip() or "no reason given"]
        if answer.lower() != YES:
            raise FungraspError("ended by the operator")
        if step.file and self.touched is None:
            return FAILED, ["no touched points (--touched FILE): record them with 'fungrasp robots touch'"]
        words = list(step.words)
        if unattended and words[1] in ("hold", "jog"):
            words.append("--yes")
        with _stop_file(Path(cell.stop_file), step.stop == "file" and unattended):
            status, said = run_fungrasp(words, not unattended)
        lines = [f"`fungrasp {shlex.join(words)}`", *said]
        well = any(STAYS in line for line in said) if step.stop else not status
        if not well or not step.question:
            return PASSED if well else FAILED, lines
        if self.yes:
            return PASSED, [*lines, f"not checked by an operator ({step.question})"]
        answer = self._ask(f"  {step.question} Type '{YES}' or 'no': ")
        return PASSED if answer.lower() == YES else FAILED, [*lines, f"operator: {step.question} {answer}"]

    def _ask(self, question: str) -> str:
        """Return the operator's answer to a question."""
        if self.yes:
            return YES
        try:
            return input(question).strip()
        except EOFError:
            raise FungraspError("no answer: the input has ended") from None


def run_fungrasp(words: Sequence[str], keyboard: bool) -> tuple[int, list[str]]:
    """Run a command in its own process.

    Args:
        keyboard: whether the process may read from the terminal.

    Returns:
        Exit status and the printed lines.
    """
    start = "from fungrasp.cli.start import start; raise SystemExit(start())"
    lines = []
    with subprocess.Popen(
        [sys.executable, "-c", start, *words],
        stdin=None if keyboard else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        # Ctrl-C must only stop the command, whose robot may hold an object.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            assert process.stdout is not None
            for line in process.stdout:
                print(f"  {line}", end="", flush=True)
                lines.append(line.rstrip())
            status = process.wait()
        finally:
            signal.signal(signal.SIGINT, before)
    return status, lines


@contextmanager
def _stop_file(file: Path, made: bool) -> Iterator[None]:
    """Make the stop file after ``STOP_AFTER`` if ``made``, and remove it at the end."""
    timer = threading.Timer(STOP_AFTER, file.touch)
    if made:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if made:
            # The timer may be making the file right now.
            timer.join()
            file.unlink(missing_ok=True)


class BringUpLog:
    """A Markdown page with one section per step, rewritten after each."""

    def __init__(self, path: Path, cell: str, digest: str):
        """
        Args:
            path: file of the log; an existing log is continued.
            cell: name of the cell.
            digest: digest of the cell and its hand.

        Raises:
            FungraspError: the file is not a log, or the log of another cell.
        """
        from fungrasp.core import __version__
        from fungrasp.core.formats.checks import read_bytes

        self._path, self._digest, title = path, digest, f"{TITLE}{cell}"
        self._text = (
            f"{title}\n\nWritten by `fungrasp robots bring-up`, fungrasp {__version__}. For each step, the "
            "last section counts.\n"
        )
        if not path.exists():
            return
        self._text = read_bytes(path, "log of a bring-up", 4_000_000).decode("utf-8", errors="replace")
        first = self._text.partition("\n")[0]
        if not first.startswith(TITLE):
            raise FungraspError(f"{path} is not a bring-up log: give another name")
        if first != title:
            raise FungraspError(f"{path} is from the cell {first.removeprefix(TITLE)}, not {cell}")

    @property
    def done(self) -> dict[str, str]:
        """Latest result of each step."""
        return {found["step"]: found["status"] for found in _SECTION.finditer(self._text)}

    @property
    def other_cell(self) -> bool:
        """Whether the cell or hand has changed since the last step."""
        return bool(self.done) and f"cell {self._digest}" not in self._text.rpartition("\n## ")[2]

    def append(self, step: BringUpStep, status: str, lines: Sequence[str]) -> None:
        """Add the result of a step.

        Raises:
            FungraspError: the file cannot be written.
        """
        from fungrasp.core.files import atomic_path
        from fungrasp.core.formats.checks import one_line

        listed = "".join(f"- {one_line(line, 400)}\n" for line in lines)
        when = strftime("%Y-%m-%d %H:%M")
        self._text += (
            f"\n## {step.name}: {status}\n\n{step.sentence} {when}, cell {self._digest}.\n\n{listed}"
        )
        with atomic_path(self._path) as temporary:
            temporary.write_text(self._text, encoding="utf-8")
