"""The program's own behaviour: help without heavy imports, names, exit statuses, one-line errors."""

from __future__ import annotations

import dataclasses
import errno
import shutil
import subprocess
import sys
import tomllib
import types
from pathlib import Path

import pytest

from fungrasp.cli import main as cli
from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError

HEAVY = ("mujoco", "scipy", "trimesh", "av", "coacd", "PIL", "numpy", "tyro")


@dataclasses.dataclass(frozen=True)
class Greet:
    """Greet someone."""

    name: str = "you"
    """Who is greeted."""
    loud: bool = False
    """Shout."""

    def run(self) -> None:
        print(f"hello {self.name}" + "!" * self.loud)


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch):
    """Put a command of our own, held by a module that exists, in the table."""

    def put(command: object, name: str = "greet") -> None:
        module = types.ModuleType("fungrasp_test_command")
        module.COMMAND = command  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(cli, "COMMANDS", {name: (module.__name__, "say hello")})

    return put


def raising(error: BaseException) -> type:
    def run(self: object) -> None:
        raise error

    return dataclasses.make_dataclass("Raising", [], namespace={"run": run})


def test_help_names_the_commands_and_imports_nothing_heavy():
    program = f"""
import sys
from fungrasp.cli.main import main
status = main(["--help"])
print([name for name in {HEAVY!r} if name in sys.modules], status)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    *text, last = done.stdout.splitlines()
    assert last == "[] 0"
    assert any(line.split()[:1] == ["hands"] for line in text)


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        ("retarget", ("mujoco", "numba", "scipy")),
        ("perceive", ("scipy", "ai_edge_litert")),
        ("evaluate", ("numba",)),
        ("train", ("numba", "torch", "rsl_rl")),
    ],
)
def test_the_help_of_a_verb_does_not_wait_for_what_its_work_needs(command: str, heavy: tuple[str, ...]):
    program = f"""
import sys
import fungrasp.cli.{command}
print([name for name in {heavy!r} if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_help_of_a_command_imports_only_that_command():
    program = """
import sys
from fungrasp.cli.main import main
try:
    main(["hands", "--help"])
finally:
    print([name for name in sys.modules if name.startswith("fungrasp.")], "mujoco" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    last = done.stdout.splitlines()[-1]
    assert "'fungrasp.cli.hands'" in last
    assert "fungrasp.cli.demo" not in last and "fungrasp.simulation" not in last
    assert last.endswith("False")


ASK = """
source "$0"; shift 0
COMP_WORDS=(fungrasp "$@"); COMP_CWORD=$#
_tyro_fungrasp fungrasp "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
echo "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes_commands_and_options(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--tyro-print-completion", "bash"])
    assert not stop.value.code
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)

    def offered(*words: str) -> list[str]:
        asked = ["bash", "-c", ASK, str(script), *words]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()

    assert offered("hand") == ["hands"]
    assert offered("hands", "ex") == ["export"]
    assert offered("retarget", "--ha") == ["--hand"]


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"fungrasp {__version__}\n"


def test_no_arguments_prints_the_help_on_stderr(capsys):
    assert cli.main([]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and "commands:" in captured.err


def test_a_command_is_made_from_its_arguments(install, capsys):
    install(Greet)
    assert cli.main(["greet", "--name", "Ada", "--loud"]) == 0
    assert capsys.readouterr().out == "hello Ada!\n"


def test_a_subcommand_of_a_table_is_imported_on_use(install, capsys):
    install({"one": "fungrasp_no_such_module:Greet", "two": f"{__name__}:Greet"})
    assert cli.main(["greet", "two", "--name", "Bo"]) == 0
    assert capsys.readouterr().out == "hello Bo\n"
    with pytest.raises(ModuleNotFoundError):
        cli.main(["greet", "one"])


def test_unknown_names_get_a_suggestion(install, capsys):
    install({"list": Greet, "show": Greet})
    assert cli.main(["gret"]) == 2
    assert "unknown command 'gret'. Did you mean 'greet'?" in capsys.readouterr().err
    assert cli.main(["greet", "lst"]) == 2
    assert capsys.readouterr().err == (
        "fungrasp: error: unknown greet command 'lst'. Did you mean 'list'? Known: list, show.\n"
    )


@pytest.mark.parametrize("arguments", [["greet", "--nme", "x"], ["greet", "--name"], ["greet", "extra"]])
def test_usage_errors_exit_with_2(install, capsys, arguments):
    install(Greet)
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err


def test_a_missing_subcommand_is_a_usage_error(install, capsys):
    install({"list": Greet, "show": Greet})
    with pytest.raises(SystemExit) as stop:
        cli.main(["greet"])
    assert stop.value.code == 2
    assert "list" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (FungraspError("no\n  hand"), 2, "fungrasp: error: no hand"),
        (KeyboardInterrupt(), 130, "fungrasp: interrupted"),
        (MemoryError(), 2, "fungrasp: error: out of memory"),
        (OSError(errno.ENOSPC, "Full"), 2, "fungrasp: error: Full; set FUNGRASP_CACHE to move the cache"),
        (OSError(errno.EACCES, "Permission denied", "a/b"), 2, "fungrasp: error: a/b: Permission denied"),
    ],
)
def test_errors_are_one_line_on_stderr(install, capsys, error, status, line):
    install(raising(error))
    assert cli.main(["greet"]) == status
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err == line + "\n"


@pytest.mark.parametrize("first", ["fungrasp.cli.main", "dataclasses", "fungrasp.cli.hands"])
def test_interrupted_while_it_imports_it_ends_without_a_traceback(first):
    """The program as it is installed, with Ctrl-C where a module is looked for."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    module, _, name = project["scripts"]["fungrasp"].partition(":")
    program = f"""
import sys
class Interrupt:
    def find_spec(self, name, *_):
        if name == {first!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from {module} import {name} as program
sys.argv = ["fungrasp", "hands", "list"]
sys.exit(program())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "fungrasp: interrupted\n")


def test_a_bug_keeps_its_traceback(install):
    install(raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        cli.main(["greet"])


def test_a_reader_that_goes_away_is_not_an_error():
    program = """
import sys
from fungrasp.cli import main as cli
cli._help = lambda: "\\n".join("x" * 80 for _ in range(100_000))
sys.exit(cli.main(["--help"]))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(timeout=60) == cli.BROKEN_PIPE


@dataclasses.dataclass(frozen=True)
class Whole:
    """A spec that checks its values."""

    number: int = 1

    def __post_init__(self) -> None:
        if self.number < 1:
            raise FungraspError(f"--number must be at least 1, not {self.number}")


@dataclasses.dataclass(frozen=True)
class Count(Whole):
    """Count."""

    spec: Whole = dataclasses.field(default_factory=Whole)

    def run(self) -> None:
        print(self.spec.number)


@pytest.mark.parametrize("option", ["--number", "--spec.number"])
def test_impossible_values_of_a_spec_are_one_line(install, capsys, option):
    Count.option_prefixes = True  # type: ignore[attr-defined]
    install(Count)
    assert cli.main(["greet", option, "0"]) == 2
    assert capsys.readouterr() == ("", "fungrasp: error: --number must be at least 1, not 0\n")
