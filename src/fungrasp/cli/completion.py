"""``fungrasp completion``: what a shell needs to complete commands and options."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from typing import Annotated, Any, Literal, Union

import tyro


@dataclass(frozen=True)
class Completion:
    """Print a script that completes fungrasp's commands and options in a shell."""

    shell: Annotated[Literal["bash", "zsh"], tyro.conf.Positional] = "bash"
    """Which one."""

    def run(self) -> None:
        from fungrasp.cli.main import every_command

        choices = _choices(every_command())
        config = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff)
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            arguments = ["--tyro-print-completion", self.shell]
            tyro.cli(choices, prog="fungrasp", args=arguments, config=config)
        print(said.getvalue())


def _choices(commands: Mapping[str, Any]) -> Any:
    """A type of which each command is a choice, and each table of commands one that leads to more."""
    kinds = []
    for name, command in commands.items():
        if isinstance(command, Mapping):
            command = make_dataclass(f"{name} commands", [("command", _choices(command))])
        kinds.append(Annotated[command, tyro.conf.subcommand(name)])
    return Union[tuple(kinds)]  # noqa: UP007 - made at run time


COMMAND = Completion
