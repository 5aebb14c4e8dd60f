"""Writes the tables of measured numbers in README.md and docs/ from the files in lab/results/.

``python -m benchmarks.documents.tables`` replaces what stands between ``<!-- table: NAME -->`` and
``<!-- end of table -->`` in every page; with ``--check`` it writes nothing and fails where a page and the
results differ.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from benchmarks.documents import choice_tables, other_tables, policy_tables, robot_tables
from benchmarks.documents.measured import (
    RESULTS,
    ROOT,
    Table,
    read,
)

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "lab").glob("*.md"))]
MARKED = re.compile(r"(<!-- table: (?P<name>\w+) -->\n)(?P<text>.*?)(<!-- end of table -->)", re.DOTALL)
RENAMED = {
    "fungrasp bench retarget --peers": "python -m benchmarks.peers",
    "fungrasp bench perception --varied": "python -m benchmarks.perception varied",
    "fungrasp bench perception": "python -m benchmarks.perception captures",
    "fungrasp bench depth": "python -m benchmarks.perception depth",
    "fungrasp bench cluster": "python -m benchmarks.speed cluster",
    "fungrasp bench robot": "python -m benchmarks.speed drivers",
    "fungrasp bench faults": "python -m benchmarks.faults",
    "fungrasp bench wire": "python -m benchmarks.wire",
    "fungrasp bench identify": "python -m benchmarks.identification",
    "fungrasp reproduce": "python -m benchmarks.paper",
}
"""Beginnings of commands in results, and of the same ones today."""
BUILDERS: dict[str, Callable[[], Table]] = {
    "hands": policy_tables.hands,
    "policies": policy_tables.policies,
    "use_test": policy_tables.use_test,
    "students": policy_tables.students,
    "confirmed_peers": choice_tables.confirmed_peers,
    "confirmed_hands": choice_tables.confirmed_hands,
    "methods": policy_tables.methods,
    "peers": policy_tables.peers,
    "robustness": policy_tables.robustness,
    "privileged_from_nothing": policy_tables.privileged_from_nothing,
    "hands_from_nothing": policy_tables.hands_from_nothing,
    "retargeting_from_nothing": policy_tables.retargeting_from_nothing,
    "perception": other_tables.perception,
    "identification": robot_tables.identification,
    "fault_series": robot_tables.fault_series,
    "identification_twins": robot_tables.identification_twins,
    "twin_variants": robot_tables.twin_variants,
    "wire": robot_tables.wire,
    "limits": other_tables.limits,
    "hands_added": other_tables.hands_added,
}
"""By the name in a page."""


def markdown(table: Table, page: Path) -> str:
    """The table's text: head, rows, and how it can be made again. page: that it stands in."""
    for row in table.rows:
        assert len(row) == len(table.head), row
    lines = [_line(table.head), _line(["---"] * len(table.head)), *map(_line, table.rows)]
    return "\n".join([*lines, "", *_sources(table.results, page), ""])


def rewritten(page: Path) -> str:
    """The page's text with its tables as the results have them."""

    def replace(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in BUILDERS:
            raise SystemExit(f"{page}: no table is called '{name}'; there are {', '.join(BUILDERS)}")
        return match[1] + markdown(BUILDERS[name](), page) + match[4]

    return MARKED.sub(replace, page.read_text())


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pages, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail where a page differs")
    check = parser.parse_args(arguments).check
    stale = [page for page in PAGES if rewritten(page) != page.read_text()]
    for page in stale:
        if check:
            sys.stderr.write(f"{page.relative_to(ROOT)}: tables differ from the results: 'make tables'\n")
        else:
            page.write_text(rewritten(page))
    return int(check and bool(stale))


def _sources(names: Sequence[str], page: Path) -> Iterator[str]:
    """What made the numbers, and links to the files."""
    if not names:
        return
    commands = dict.fromkeys(read(name).header["command"] for name in names)
    for command in [command for command in commands if command][:1]:
        more = " and its like, which the files name" if len(commands) > 1 else ""
        yield f"Measured by `{_runnable(command)}`{more}."
    if not any(commands):
        yield "Recorded by hand; no command was kept."
    links = [f"[{name}]({os.path.relpath(RESULTS / name, page.parent)}.json)" for name in names]
    yield f"Data: {', '.join(links)}."


def _runnable(command: str) -> str:
    """A recorded command as it is given today; results keep what was given then."""
    for old, new in RENAMED.items():
        if command.startswith(old):
            return new + command.removeprefix(old)
    return command


def _line(cells: Sequence[str]) -> str:
    return "".join(f"| {cell} " if cell else "| " for cell in cells) + "|"


if __name__ == "__main__":
    sys.exit(main())
