"""The program ``fungrasp``: finds the command, parses its arguments and runs it.

Only the module of the command is imported. Its ``COMMAND`` is a dataclass with a method ``run``, or a table
of such dataclasses by subcommand. In a table, "module:class" names a command that is imported on use.
"""

from __future__ import annotations

import errno
import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from dataclasses import make_dataclass
from io import StringIO
from typing import Annotated, Any, NoReturn, Union

from fungrasp.cli import INTERRUPTED
from fungrasp.cli.console import STDOUT, CommandResult
from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError, UnknownNameError

COMMANDS: Mapping[str, tuple[str, str]] = {
    "demo": ("fungrasp.cli.demo", "grasp a few built-in objects and write a film and a page"),
    "perceive": ("fungrasp.cli.perceive", "turn an RGB-D image of a held object into a human grasp"),
    "retarget": ("fungrasp.cli.retarget", "turn human grasps into grasps of a robot hand"),
    "evaluate": ("fungrasp.cli.evaluate", "test grasps in simulation: reach, grasp, lift, hold"),
    "train": ("fungrasp.cli.train", "train a policy with PPO: a teacher that knows the contacts"),
    "distill": (
        "fungrasp.cli.train:Distill",
        "distill a teacher into a student that needs no privileged input",
    ),
    "deploy": ("fungrasp.cli.deploy", "grasp an object with a robot or its twin"),
    "view": ("fungrasp.cli.view", "show grasps, episodes, results, logs, captures or hands in a browser"),
    "export": ("fungrasp.cli.export", "write recorded episodes for LeRobot or as MCAP files"),
    "robots": ("fungrasp.cli.robots", "list, check and emulate robot cells; read their logs"),
    "hands": ("fungrasp.cli.hands", "list, show, check, add and export robot hands"),
    "objects": ("fungrasp.cli.objects", "list and show objects"),
    "grasps": ("fungrasp.cli.grasps", "list, show, check, convert, import and make human grasps"),
    "setup": ("fungrasp.cli.doctor:SETUP", "download the hand models that perceive needs"),
    "policies": ("fungrasp.cli.policies", "list and describe trained policies"),
    "doctor": ("fungrasp.cli.doctor", "list what is installed: extras, devices, caches"),
    "identify": ("fungrasp.cli.identify", "record a real hand's motion and fit the dynamics of its joints"),
}
"""Module ("module:name" if not its ``COMMAND``) and summary of each command, in the order of the help."""

COMPLETION = "--tyro-print-completion"
"""Tyro's option that prints a completion script for a shell."""

USAGE_ERROR = 2
BROKEN_PIPE = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: arguments without the program's name. None: those of this process.

    Returns:
        Exit status: 0 for success, 2 for invalid input or a full disk (one line on stderr), 130 if
        interrupted, 141 if the output pipe is closed.

    Raises:
        SystemExit: after help or a usage error, or if a command has its own exit status.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    return _status(lambda: _dispatch(arguments))


def run_command(program: str, command: Any, arguments: Sequence[str]) -> int:
    """Run a command that is not in ``COMMANDS``.

    Args:
        program: program name for the help.
        command: dataclass with a method ``run``, or a table of such dataclasses by subcommand.

    Returns:
        Exit status, see ``main``.
    """
    return _status(lambda: _run(_parse(program, command, list(arguments))))


def _status(work: Callable[[], int]) -> int:
    try:
        status = work()
        sys.stdout.flush()
        return status
    except FungraspError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        print("fungrasp: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The interpreter flushes stdout again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return BROKEN_PIPE
    except MemoryError as error:
        return _fail(f"out of memory: {error}" if str(error) else "out of memory")
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        # Numba reports a full cache without a path.
        full = "; set FUNGRASP_CACHE to move the cache" if error.errno == errno.ENOSPC else ""
        return _fail(f"{where}{error.strerror or error}{full}")


def every_command() -> dict[str, Any]:
    """Import and return all commands or tables of subcommands, by name."""
    commands: dict[str, Any] = {}
    for name, (place, _) in COMMANDS.items():
        command = _loaded(place)
        if isinstance(command, Mapping):
            command = {sub: _loaded(one) for sub, one in command.items()}
        commands[name] = command
    return commands


def parsed(arguments: Sequence[str]) -> Any:
    """Return the command with its arguments, ready to run.

    Raises:
        FungraspError: the command is unknown or a value is invalid.
        SystemExit: after help or a usage error.
    """
    first, *rest = arguments
    if first not in COMMANDS:
        raise UnknownNameError("option" if first.startswith("-") else "command", first, COMMANDS)
    return _parse(f"fungrasp {first}", _loaded(COMMANDS[first][0]), rest)


def _dispatch(arguments: list[str]) -> int:
    if not arguments:
        print(_help(), file=sys.stderr)
        return USAGE_ERROR
    first = arguments[0]
    if first in ("-h", "--help"):
        print(_help())
        return 0
    if first in ("-V", "--version"):
        print(f"fungrasp {__version__}")
        return 0
    if first == COMPLETION:
        _print_completion(arguments)
    return _run(parsed(arguments))


def _print_completion(arguments: list[str]) -> NoReturn:
    """Print the completion script for all commands and options."""
    import tyro

    config = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff)
    tyro.cli(_choices(every_command()), prog="fungrasp", args=arguments, config=config)
    raise SystemExit(0)


def _choices(commands: Mapping[str, Any]) -> Any:
    """Return a union type with one choice per command; tables of commands become nested choices."""
    import tyro

    kinds = []
    for name, command in commands.items():
        if isinstance(command, Mapping):
            command = make_dataclass(f"{name} commands", [("command", _choices(command))])
        kinds.append(Annotated[command, tyro.conf.subcommand(name)])
    return Union[tuple(kinds)]  # noqa: UP007 - made at run time


def _run(command: Any) -> int:
    # Imported here because `--help` does not need logging.
    from fungrasp.core.warning_lines import WarningLines

    as_json = getattr(command, "json", None) in (True, STDOUT)
    with WarningLines(), redirect_stdout(sys.stderr) if as_json else nullcontext():
        answer = command.run()
    if isinstance(answer, CommandResult):
        answer.show(as_json)
    return 0


def _parse(program: str, command: Any, arguments: list[str]) -> Any:
    import tyro

    if isinstance(command, Mapping):
        if arguments and not arguments[0].startswith("-"):
            subcommand, *arguments = arguments
            if subcommand not in command:
                raise UnknownNameError(f"{program.removeprefix('fungrasp ')} command", subcommand, command)
            return _parse(f"{program} {subcommand}", _loaded(command[subcommand]), arguments)
        every = {name: _loaded(one) for name, one in command.items()}
        return tyro.extras.subcommand_cli_from_dict(every, prog=program, args=arguments)
    config = [tyro.conf.FlagCreatePairsOff, tyro.conf.HelptextFromCommentsOff]
    if not getattr(command, "option_prefixes", False):
        config.append(tyro.conf.OmitArgPrefixes)
    said = StringIO()
    try:
        with redirect_stderr(said):
            return tyro.cli(command, prog=program, args=arguments, config=tuple(config))
    except SystemExit as stop:
        # Errors of a dataclass about its values are reported in one line.
        for error in (stop.__context__, getattr(stop.__context__, "__context__", None)):
            if isinstance(error, FungraspError):
                raise error from None
        sys.stderr.write(said.getvalue())
        raise


def _loaded(command: Any) -> Any:
    """Return a command, imported if it is given as "module:name"."""
    if not isinstance(command, str):
        return command
    module, _, name = command.partition(":")
    return getattr(importlib.import_module(module), name or "COMMAND")


def _help() -> str:
    lines = [f"  {name:<10} {summary}" for name, (_, summary) in COMMANDS.items()]
    return "\n".join(
        [
            "usage: fungrasp COMMAND [OPTIONS]",
            "",
            "A human grasp in, a robot grasp that lifts the object out.",
            "",
            "commands:",
            *lines,
            "",
            "options:",
            "  -h, --help     show this help, or that of a command: fungrasp COMMAND --help",
            "  -V, --version  show the version",
        ]
    )


def _fail(message: str) -> int:
    print(f"fungrasp: error: {' '.join(message.split())}", file=sys.stderr)
    return USAGE_ERROR
