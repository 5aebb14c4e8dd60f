"""``fungrasp robots bring-up``: what comes before a robot's first grasp, a checklist of commands."""

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
"""The steps; the file explains its fields."""

STOP_AFTER = 4.0
"""Where nobody is at the keyboard, the stop file is made so long after the command was started [s]."""

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
"""How a step ends."""

YES, SKIP = "yes", "skip"
"""Words of an answer; after "skip" comes the reason."""

TITLE = "# Bring-up of "
_SECTION = re.compile(r"^## (?P<step>[a-z-]+): (?P<status>passed|failed|skipped)$", re.MULTILINE)


@dataclass(frozen=True)
class BringUpStep:
    """A line of the checklist."""

    name: str
    """By which the log knows it."""
    sentence: str
    """What is done, and what to look at."""
    words: tuple[str, ...]
    """Command line of fungrasp."""
    question: str = ""
    """To the operator afterwards; "" where the command says whether it is well."""
    stop: str = ""
    """The operator has to stop the command while something moves: "key" or "file"."""
    file: bool = False
    """Whether it needs the file of touched points."""


@dataclass(frozen=True)
class BringUp:
    """Walk through what comes before a robot's first grasp: a list of commands, up to a lift in slow motion.
    What they said and what you answered is written to a log, which goes on where it ended."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package; emulated devices will do, a twin not."""
    log: Path = Path("bring-up.md")
    """Markdown file of what was done. If it is there it goes on after the last step that did not fail."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp of the last steps."""
    policy: str = "plan"
    """What moves the hand: "plan" or "reference"."""
    speed: float = 0.1
    """Share of the cell's speed in the last steps."""
    touched: Path | None = None
    """JSON file of touched points, as `robots check --touched` takes it."""
    start: str = ""
    """Begin with this step though it was passed."""
    yes: bool = False
    """Answer yes to everything; for emulated devices only."""
    seed: int = 0
    """Seed of the plan."""

    def run(self) -> None:
        from fungrasp.core.files import digest
        from fungrasp.robots.cell import is_wired

        cell, hand = wired_cell(self.cell)
        if is_wired(cell) and (self.yes or not sys.stdin.isatty()):
            raise FungraspError("a real robot is brought up by a person at a terminal: no --yes, no pipe")
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
            print(f"the cell has changed since; '--start {names[0]}' begins anew, if that touches it")
        for number, step in enumerate(steps[first:], first + 1):
            print(f"[{number}/{len(names)}] {step.name}: {step.sentence}", flush=True)
            status, lines = self._done(step, cell)
            log.append(step, status, lines)
            print(f"  {status}", flush=True)
            if status == FAILED:
                raise FungraspError(
                    f"the step '{step.name}' failed; the same command goes on there ({self.log})"
                )
        print(f"brought up; the log is {self.log}", flush=True)

    def steps(self, cell: RobotCell, hand: Hand) -> list[BringUpStep]:
        """The checklist of a cell."""
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
        """How a step went, and what the log says of it."""
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
            return FAILED, ["no touched points (--touched FILE): make them by 'fungrasp robots touch'"]
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
            return PASSED, [*lines, f"nobody looked ({step.question})"]
        answer = self._ask(f"  {step.question} Type '{YES}' or 'no': ")
        return PASSED if answer.lower() == YES else FAILED, [*lines, f"operator: {step.question} {answer}"]

    def _ask(self, question: str) -> str:
        """The answer to a question."""

        if self.yes:
            return YES
        try:
            return input(question).strip()
        except EOFError:
            raise FungraspError("there are no more answers") from None


def run_fungrasp(words: Sequence[str], keyboard: bool) -> tuple[int, list[str]]:
    """Run a command in a process of its own, which has the terminal.

    Args:
        keyboard: whether a person answers.

    Returns:
        its exit status, and the lines that it printed, errors included.
    """
    start = "from fungrasp.cli.start import start; raise SystemExit(start())"
    lines = []
    with subprocess.Popen(
        [sys.executable, "-c", start, *words],
        stdin=None if keyboard else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        # What stops the robot is for the command alone, which may hold an object.
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
    """Make the stop file after a moment where nobody else does, and take it away at the end."""
    timer = threading.Timer(STOP_AFTER, file.touch)
    if made:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if made:
            # It may be making the file at this moment.
            timer.join()
            file.unlink(missing_ok=True)


class BringUpLog:
    """A Markdown page with a section for each step, written whole as one ends."""

    def __init__(self, path: Path, cell: str, digest: str):
        """
        Args:
            path: the file; one that is there goes on.
            digest: of the cell and its hand.

        Raises:
            FungraspError: the file is no log, or one of another cell.
        """
        from fungrasp.core import __version__
        from fungrasp.core.formats.checks import read_bytes

        self._path, self._digest, title = path, digest, f"{TITLE}{cell}"
        self._text = (
            f"{title}\n\nWritten by `fungrasp robots bring-up`, fungrasp {__version__}. Of each step the "
            "last section counts; the command goes on after the last one that did not fail.\n"
        )
        if not path.exists():
            return
        self._text = read_bytes(path, "log of a bring-up", 4_000_000).decode("utf-8", errors="replace")
        first = self._text.partition("\n")[0]
        if not first.startswith(TITLE):
            raise FungraspError(f"{path} is no log of a bring-up: give another name")
        if first != title:
            raise FungraspError(f"{path} is of the cell {first.removeprefix(TITLE)}, not {cell}")

    @property
    def done(self) -> dict[str, str]:
        """How each step ended, the last time."""
        return {found["step"]: found["status"] for found in _SECTION.finditer(self._text)}

    @property
    def other_cell(self) -> bool:
        """Whether steps were done before cell or hand were changed."""
        return bool(self.done) and f"cell {self._digest}" not in self._text.rpartition("\n## ")[2]

    def append(self, step: BringUpStep, status: str, lines: Sequence[str]) -> None:
        """Write down how a step went.

        Raises:
            FungraspError: the file can't be written.
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
