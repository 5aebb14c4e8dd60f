"""``fungrasp train --sweep --seeds``: several trainings, each in a folder of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, fields, is_dataclass, replace
from difflib import get_close_matches
from io import StringIO
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import Answer, table
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, part_key

if TYPE_CHECKING:
    from fungrasp.cli.train import Train

NOT_SWEPT = ("out", "seed", "seeds", "sweep", "json", "ray", "threads", "device", "buffers")
"""Options that do not tell trainings apart, or for which there is another way to do it."""


@dataclass(frozen=True)
class Sweep:
    """One setting, and the values that it is given in turn."""

    setting: str
    """As on the command line, "_" for "-"."""
    values: tuple[str, ...]
    """At least one."""

    @classmethod
    def parse(cls, text: str, command: Train) -> Sweep:
        """``setting=value,value``.

        Args:
            text: one word after ``--sweep``.
            command: whose settings there are.

        Raises:
            FungraspError: another form, an unknown setting, or a value twice.
        """
        name, equals, values = text.partition("=")
        setting, each = name.strip("-").replace("-", "_"), tuple(values.split(","))
        if not equals or not all(each):
            raise FungraspError(f"--sweep takes SETTING=VALUE,VALUE..., not '{text}'")
        known = [one for one in _settings(command) if one not in NOT_SWEPT]
        if setting not in known:
            near = get_close_matches(setting, known, n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise FungraspError(
                f"--sweep: there is no setting '{setting}'.{hint} 'fungrasp train --help' lists them"
            )
        if len(set(each)) < len(each):
            raise FungraspError(f"--sweep {text}: give each value once")
        return cls(setting, each)


@dataclass(frozen=True, eq=False)
class Trainings(Job["Train"]):
    """Several trainings. What each has done is kept in its own folder, so that nothing else is."""

    trainings: tuple[Train, ...]
    """What to run."""

    def parts(self) -> list[Train]:
        """A training each."""
        return list(self.trainings)

    def key(self, part: Train) -> str:
        """Of its folder."""
        return part_key("training", str(part.folder))

    def on_one_processor(self) -> Trainings:
        """With one thread each."""
        return Trainings(tuple(replace(training, threads=1) for training in self.trainings))

    def run(self, parts: Sequence[Train], progress: Callable[[float], None]) -> list[Arrays]:
        """Train."""
        for training in parts:
            training.run()
        return [{} for _ in parts]


def each_training(command: Train) -> list[Train]:
    """The trainings of ``--sweep`` and ``--seeds``: every combination of the values, with each seed, in
    ``<out>/<setting>=<value>,.../seed-<N>``.

    Raises:
        FungraspError: a setting twice or one that does not exist, or a value that it can't have.
    """
    sweeps = [Sweep.parse(text, command) for text in command.sweep]
    if len({sweep.setting for sweep in sweeps}) < len(sweeps):
        raise FungraspError("--sweep takes each setting once")
    if len(set(command.seeds)) < len(command.seeds):
        raise FungraspError("--seeds must be different ones")
    alone = replace(command, sweep=(), seeds=(), ray=None)
    found: dict[Path, Train] = {}
    for values in product(*(sweep.values for sweep in sweeps)):
        chosen = dict(zip((sweep.setting for sweep in sweeps), values, strict=True))
        folder = command.folder.absolute()
        if chosen:
            folder /= ",".join(f"{name}={_in_a_path(value)}" for name, value in chosen.items())
        training = replace(_with_values(alone, chosen), out=folder)
        for seed in command.seeds or (None,):
            one = training
            if seed is not None:
                one = replace(training, out=folder / f"seed-{seed}", seed=seed)
            if one.folder in found:
                raise FungraspError(f"--sweep: two trainings would be kept in {one.folder}")
            found[one.folder] = one
    return list(found.values())


def trained(trainings: Sequence[Train], root: Path) -> Answer:
    """What the finished trainings reached.

    Args:
        trainings: that are done.
        root: folder of all of them.
    """
    from fungrasp.policies.checkpoint.checkpoint_file import load_policy
    from fungrasp.training.run import EXPLORING, POLICY

    value, rows = [], [("training", "steps", "minutes", "success, exploring")]
    for training in trainings:
        card = load_policy(training.folder / POLICY).card
        value.append({"policy": training.folder / POLICY, "card": card.to_json()})
        success = f"{card.measured[EXPLORING]['success']:.1%}"
        rows.append(
            (_name(training, root), f"{card.budget.steps:,}", f"{card.budget.seconds / 60:.1f}", success)
        )
    return Answer(value, table(rows))


def draw_each_curve(trainings: Sequence[Train], root: Path) -> None:
    """One drawing of the learning curves of all trainings.

    Args:
        trainings: that are done.
        root: folder of all of them, and of the drawing.

    Raises:
        FungraspError: a curve is damaged, or the drawing can't be written.
    """
    from fungrasp.training.learning_curve import CURVE, DRAWING, draw_curves

    curves = {
        _name(training, root): training.folder / CURVE for training in trainings if training.curve.every
    }
    if curves:
        draw_curves(root / DRAWING, curves)


def _name(training: Train, root: Path) -> str:
    return str(training.folder.relative_to(root.absolute()))


def _settings(command: Any, before: str = "") -> Iterator[str]:
    """Names of all single settings."""
    for field in fields(command):
        value = getattr(command, field.name)
        if is_dataclass(value):
            yield from _settings(value, f"{before}{field.name}.")
        else:
            yield before + field.name


def _with_values(command: Train, values: dict[str, str]) -> Train:
    """The command as if the values had been given on its command line."""
    import tyro

    for name, value in values.items():
        words = StringIO()
        try:
            with redirect_stderr(words):
                command = tyro.cli(
                    type(command),
                    prog="fungrasp train",
                    args=[f"--{name}", *value.split()],
                    default=command,
                    config=(tyro.conf.FlagConversionOff, tyro.conf.HelptextFromCommentsOff),
                )
        except SystemExit:
            raise FungraspError(f"--sweep: '{value}' is no value of {name}") from None
    return command


def _in_a_path(value: str) -> str:
    """A value as part of the name of a folder: of a path the name of its file."""
    name = Path(value).name if "/" in value or "\\" in value else value
    return "-".join(name.split())
