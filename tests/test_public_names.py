"""Public names mean one thing in the whole package, and say what they are."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import textwrap
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import fungrasp


@cache
def modules() -> tuple[ModuleType, ...]:
    """Every module of the package; those that need packages that are not installed are left out."""
    found = [fungrasp]
    for info in pkgutil.walk_packages(fungrasp.__path__, "fungrasp."):
        try:
            found.append(importlib.import_module(info.name))
        except ModuleNotFoundError as error:
            assert error.name and not error.name.startswith("fungrasp"), info.name
    return tuple(found)


def public(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """Names and values of the public classes and functions that a module defines."""
    for name, value in vars(module).items():
        is_definition = inspect.isclass(value) or inspect.isfunction(value)
        if is_definition and not name.startswith("_") and _home(value) == (module.__name__, name):
            yield name, value


def _home(value: Any) -> tuple[str, str]:
    return value.__module__, value.__name__


def defined_twice() -> list[str]:
    """Public names that more than one module defines, with the modules."""
    places = defaultdict(list)
    for module in modules():
        for name, _ in public(module):
            places[name].append(module.__name__)
    return [f"{name}: {', '.join(where)}" for name, where in sorted(places.items()) if len(where) > 1]


def without_docstring() -> list[str]:
    """Public classes, functions, methods, properties and dataclass fields that have none."""
    missing = []
    for module in modules():
        for name, value in public(module):
            place = f"{module.__name__}.{name}"
            if not _own_doc(value):
                missing.append(place)
            if inspect.isclass(value):
                missing += [f"{place}.{member}" for member in _members_without_docstring(value)]
    return missing


def _own_doc(value: Any) -> str | None:
    """The docstring; None where it is the one that ``dataclass`` or ``NamedTuple`` makes up."""
    doc = value.__doc__
    made_up = inspect.isclass(value) and doc is not None and doc.startswith(f"{value.__name__}(")
    return None if made_up else doc


def _members_without_docstring(kind: type) -> Iterator[str]:
    for name, member in vars(kind).items():
        function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        documented_above = any(name in vars(base) for base in kind.__mro__[1:])
        is_own = inspect.isfunction(function) and function.__module__ == kind.__module__
        if is_own and name == "run" and kind.__module__.startswith("fungrasp.cli."):
            continue  # A command: what it does is said by the class.
        if is_own and not name.startswith("_") and not documented_above and not function.__doc__:
            yield name
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        yield from _fields_without_docstring(kind)


def _fields_without_docstring(kind: type) -> Iterator[str]:
    """Annotated names of a class body that no text follows."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(tree, ast.ClassDef)
    for statement, after in zip(tree.body, [*tree.body[1:], ast.Pass()], strict=True):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            hidden = statement.target.id.startswith("_") or "ClassVar" in ast.unparse(statement.annotation)
            if not text and not hidden:
                yield statement.target.id


def test_public_names_are_defined_once() -> None:
    found = defined_twice()
    assert not found, "\n".join(found)


def test_everything_public_has_a_docstring() -> None:
    found = without_docstring()
    assert not found, "\n".join(found)


def test_the_checks_find_something() -> None:
    @dataclasses.dataclass
    class Point:
        x: float
        """[m]."""
        y: float
        _hidden: float

        def far(self) -> bool:
            return False

    assert list(_members_without_docstring(Point)) == ["far", "y"] and _own_doc(Point) is None
    assert "train" in {name for module in modules() for name, _ in public(module)}


def test_the_manual_says_where_the_main_names_come_from():
    page = (Path(__file__).parents[1] / "docs" / "api" / "index.md").read_text()
    rows = re.findall(r"^\| \[?`(fungrasp[\w.]*)`.*?\| (.*) \|$", page, re.MULTILINE)
    said = {name: module for module, names in rows for name in re.findall(r"`(\w+)`", names)}
    assert sorted(said) == fungrasp.__all__
    for name, module in said.items():
        assert getattr(importlib.import_module(module), name) is getattr(fungrasp, name)
