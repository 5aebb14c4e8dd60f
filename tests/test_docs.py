"""Every command of README and manual is run, page by page, in a folder of its own.

A file given in a block with a title is written there. ``grasps.npz`` and ``meshes/`` stand for the reader's
own data. Of the built-in grasps there are only a few, to be quick. Lines below a command must be part of
what it prints. A block that is not run carries the reason, ``<!-- not run: ... -->``, and its commands are
read as far as to the run itself; one that fails carries its status, ``<!-- ends with 2 -->``.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
import runpy
import shlex
import sys
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

import fungrasp
from fungrasp.cli.main import COMMANDS, every_command, main, parsed
from fungrasp.evaluation import StaticQuality, Trajectory
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, grasp_files, save_human_grasps
from fungrasp.media import demonstration
from fungrasp.objects import builtin_object
from fungrasp.task import Outcomes

ROOT = Path(__file__).parents[1]
MANUAL = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [*MANUAL, *sorted((ROOT / "lab").glob("*.md"))]
"""With the records of the lab, whose commands and names are those of their time."""
BLOCK = re.compile(
    r"^(?P<fence>`{3,})(?P<language>\w*) *(?:title=\"(?P<title>[^\"]+)\")?\n(?P<text>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
COMMENT = re.compile(r"<!-- (not run: (?P<reason>.+)|ends with (?P<status>\d+)) -->\n$")
ENTRY_POINTS = (
    "fungrasp.hand_estimators",
    "fungrasp.object_pose_estimators",
    "fungrasp.arm_drivers",
    "fungrasp.hand_drivers",
    "fungrasp.pose_sources",
)
"""Groups that share no name with a module."""
MOST = 2
"""Built-in grasps that commands see."""
REACHED = [3, 4]
"""Of those of the box, two that the arm of the built-in cells reaches."""


@dataclass(frozen=True)
class Command:
    """A line of a block, what should be printed, and how it should end."""

    line: str
    shown: tuple[str, ...]
    status: int


def steps(page: Path) -> Iterator[tuple[str, str] | Command]:
    """Files to write (name, text) and commands to run, in order."""
    for block, reason, status in blocks(page):
        if block["title"]:
            yield block["title"], block["text"]
        elif block["language"] == "console" and not reason:
            for line, shown in lines_of(block):
                yield Command(line, shown, status)


def blocks(page: Path) -> Iterator[tuple[re.Match[str], str, int]]:
    """Blocks of a page: why it is not run ("": it is), and with what status its commands end."""
    text = page.read_text()
    for block in BLOCK.finditer(text):
        comment = COMMENT.search(text[: block.start()])
        yield block, (comment and comment["reason"]) or "", int((comment and comment["status"]) or 0)


def lines_of(block: re.Match[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Commands of a block, and the lines that each prints."""
    for part in re.split(r"^\$ ", block["text"].replace("\\\n", " "), flags=re.MULTILINE)[1:]:
        line, *shown = part.splitlines()
        yield line, tuple(s for s in shown if s.strip())


def run(arguments: list[str]) -> int:
    """Status of ``fungrasp ...``, ``python FILE`` or ``python -m MODULE ...``, run in this process."""
    program, *rest = arguments
    try:
        if arguments[:2] == ["python", "-m"]:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(sys, "argv", arguments[2:])
                runpy.run_module(arguments[2], run_name="__main__", alter_sys=True)
            return 0
        if program == "python":
            runpy.run_path(rest[0], run_name="__main__")
            return 0
        assert program == "fungrasp", f"no test runs '{program}'"
        return main(rest)
    except SystemExit as end:
        return int(end.code or 0)


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the reader's data; few built-in grasps, films of few small frames, and a viewer that ends
    at once."""
    builtin = grasp_files.builtin_grasps()
    assert builtin.task is not None
    first = {
        f"{name} {task}": row
        for row, (name, task) in enumerate(zip(builtin.object_name, builtin.task, strict=True))
    }
    named = [first["can drink"], first["wine_glass drink"]]
    others = [row for row in first.values() if row not in named]
    save_human_grasps(tmp_path / "few.npz", builtin.select(np.array([*named, *others[: MOST - 1]])))
    monkeypatch.setattr(grasp_files, "BUILTIN_PATH", tmp_path / "few.npz")
    monkeypatch.setattr(demonstration, "FILM", replace(demonstration.FILM, fps=2.0, width=240, height=136))
    monkeypatch.setattr("fungrasp.viewer.view.Viewer.wait", lambda viewer: viewer.close())
    mine = builtin.select(np.flatnonzero(builtin.object_name == "box")[REACHED])
    (tmp_path / "meshes").mkdir()
    builtin_object("box").mesh.export(tmp_path / "meshes" / "carton.obj")
    save_human_grasps(tmp_path / "grasps.npz", replace(mine, object_name=np.full(len(mine), "carton")))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", [page for page in MANUAL if any(steps(page))], ids=lambda page: page.stem)
def test_commands_of_the_page_run(page: Path, reader: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for step in steps(page):
        if isinstance(step, tuple):
            path = reader / step[0]
            path.parent.mkdir(exist_ok=True)
            path.write_text(step[1])
            continue
        if step.line.startswith("make "):
            targets = [word for word in shlex.split(step.line)[1:] if "=" not in word]
            assert set(targets) <= makefile_targets(), step.line
            continue
        capsys.readouterr()
        status = run(shlex.split(step.line))
        said = capsys.readouterr()
        assert status == step.status, f"{page.name}: '{step.line}' ended with {status}: {said.err}"
        lines = [line.strip() for line in (said.out + said.err).splitlines()]
        for line in step.shown:
            assert line.strip() in lines, f"{page.name}: '{step.line}' does not print '{line}'"


def makefile_targets() -> set[str]:
    """Names that can be given to make."""
    text = (ROOT / "Makefile").read_text()
    named = re.search(r"^\.PHONY: (.*)$", text, re.MULTILINE)
    checks = re.search(r"^CHECKS := (.*)$", text, re.MULTILINE)
    assert named and checks
    return {*named[1].split(), *checks[1].split()}


def test_commands_that_are_not_run_are_understood(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options and values: all but the run itself; of benchmarks the options alone."""
    monkeypatch.setenv("COLUMNS", "200")
    checked = 0
    for page in MANUAL:
        for block, reason, _ in blocks(page):
            lines = [line for line, _ in lines_of(block)] if reason and block["language"] == "console" else []
            for line in lines:
                words = shlex.split(line, comments=True)
                if words[0] == "fungrasp":
                    checked += 1
                    assert callable(parsed(words[1:]).run), f"{page.name}: {line}"
                    continue
                if words[:2] != ["python", "-m"]:
                    continue
                first = next((i for i, word in enumerate(words) if word.startswith("--")), len(words))
                status = run([*words[:first], "--help"])
                shown = capsys.readouterr().out
                assert status == 0, f"{page.name}: {line}"
                for option in words[first:]:
                    assert not option.startswith("--") or option in shown, f"{page.name}: {line}: {option}"
    assert checked > 50


def test_a_reason_is_given_for_what_is_not_run() -> None:
    for page in PAGES:
        for comment in re.finditer(r"<!-- not run(.*?)-->", page.read_text()):
            assert re.match(r": \w+ \w+", comment[1]), f"{page.name}: {comment[0]}"


def test_every_command_is_documented() -> None:
    text = (ROOT / "docs" / "command-line.md").read_text()
    for name in COMMANDS:
        assert re.search(rf"`{name}\b", text), f"docs/command-line.md does not mention '{name}'"
    rows = re.findall(r"^\| (`[^|]*`) \|", text, re.MULTILINE)
    for name, table in every_command().items():
        if isinstance(table, Mapping):
            named = {
                word
                for row in rows
                if row.startswith(f"`{name} ")
                for word in re.findall(r"`([\w-]+)`", row.replace(f"`{name} ", "`"))
            }
            assert named == set(table), f"docs/command-line.md, '{name}'"


def test_the_table_of_hands_tells_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hands", "list", "--json"]) == 0
    hands = {hand["name"]: hand for hand in json.loads(capsys.readouterr().out)}
    rows = re.findall(
        r"^\| `(\w+)` \| .*? \| (\d) \| (\d+) / (\d+) \| ([\d.]+) kg",
        (ROOT / "docs" / "hands.md").read_text(),
        re.MULTILINE,
    )
    assert {row[0] for row in rows} == set(hands)
    for name, fingers, driven, joints, mass in rows:
        hand = hands[name]
        assert (len(hand["fingers"]), hand["independent_joints"], hand["joints"]) == (
            int(fingers),
            int(driven),
            int(joints),
        )
        assert abs(hand["mass"] - float(mass)) <= 0.005


def test_names_of_modules_in_the_documentation_exist() -> None:
    for page in MANUAL:
        for name in set(re.findall(r"`(fungrasp(?:\.\w+)+)[`(]", page.read_text())):
            if name not in ENTRY_POINTS:
                module, _, attribute = name.rpartition(".")
                try:
                    importlib.import_module(name)
                except ModuleNotFoundError:
                    assert hasattr(importlib.import_module(module), attribute), f"{page.name}: {name}"


def test_files_named_in_the_architecture_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"`(\w+(?:/\w+)+\.py)`", text))
    assert len(named) > 10
    for name in named:
        assert (ROOT / name).exists() or (ROOT / "src" / "fungrasp" / name).exists(), name
    rooms = set(re.findall(r"^  (\w+)/ ", text, re.MULTILINE))
    package = ROOT / "src" / "fungrasp"
    assert rooms == {path.parent.name for path in package.glob("*/__init__.py")}
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    layers = [layer.split(" | ") for layer in reversed(contract["layers"])]
    listed = re.findall(r"^  (\w+)(?:/|\.py) ", text, re.MULTILINE)
    levels = [next(i for i, layer in enumerate(layers) if name in layer) for name in listed if name[0] != "_"]
    assert levels == sorted(levels) and len(levels) == sum(map(len, layers)), "not in the contract's order"


def test_the_reference_has_a_page_for_every_room_with_public_names() -> None:
    package, pages = ROOT / "src" / "fungrasp", ROOT / "docs" / "api"
    rooms = {path.parent.name for path in package.glob("*/__init__.py") if "__all__" in path.read_text()}
    # Of core, the module of long work alone is for users.
    assert {page.stem for page in pages.glob("*.md")} - {"index", "core"} == rooms - {"geometry"}
    for room in rooms - {"geometry"}:
        assert f"::: fungrasp.{room}\n" in (pages / f"{room}.md").read_text()


def test_the_reference_lists_what_the_package_offers() -> None:
    text = (ROOT / "docs" / "api" / "index.md").read_text()
    for name in fungrasp.__all__:
        assert f"`{name}`" in text, name


def test_terms_of_the_glossary_are_sorted_and_defined_once() -> None:
    text = (ROOT / "docs" / "concepts.md").read_text().partition("## Glossary")[2]
    rows = re.findall(r"^\| ([a-z][^|]*) \|", text, re.MULTILINE)
    terms = rows[1:]
    assert terms and terms == sorted(set(terms))


def test_decisions_have_a_status_and_the_others_one_line() -> None:
    text = (ROOT / "lab" / "decisions.md").read_text()
    records = re.findall(r"^## (\d{4}) .+\n\*\*Status:\*\* (stands|under review)", text, re.MULTILINE)
    assert len(records) == len(re.findall("^## ", text, re.MULTILINE)) <= 25
    history = re.findall(r"^\| (\d{4}) \|", (ROOT / "lab" / "history.md").read_text(), re.MULTILINE)
    assert history == sorted(set(history)) and not set(history) & {number for number, _ in records}


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[\w-]+)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_field_of_the_files_is_documented() -> None:
    text = (ROOT / "docs" / "file-format.md").read_text()
    for kind in (HumanGraspSet, RobotGraspSet):
        for name in kind.FIELDS:
            assert f"`{name}`" in text, name
    for field in fields(Trajectory):
        assert f"`{field.name}`" in text, field.name


def test_every_measured_number_is_documented() -> None:
    text = (ROOT / "docs" / "evaluate.md").read_text()
    for kind in (StaticQuality, Outcomes):
        for field in fields(kind):
            assert field.name == "success" or f"`{field.name}`" in text, field.name


def test_names_in_blocks_of_python_exist() -> None:
    checked = 0
    for page in MANUAL:
        for block in BLOCK.finditer(page.read_text()):
            if block["language"] != "python":
                continue
            for module, name in used_names(block["text"]):
                checked += 1
                place = importlib.import_module(module)
                if not hasattr(place, name):
                    importlib.import_module(f"{module}.{name}")
    assert checked > 50


def used_names(text: str) -> Iterator[tuple[str, str]]:
    """Modules and names of the package that a block imports, or takes from ``import fungrasp``."""
    try:
        nodes = list(ast.walk(ast.parse(textwrap.dedent(text))))
    except SyntaxError:  # A part of a class.
        return
    aliases = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "fungrasp":
            yield from ((node.module or "", alias.name) for alias in node.names)
        if isinstance(node, ast.Import):
            aliases |= {alias.asname or alias.name for alias in node.names if alias.name == "fungrasp"}
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            yield "fungrasp", node.attr
