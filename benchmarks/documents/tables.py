"""Writes the tables of measured numbers in README.md, docs/ and lab/ from the files in lab/results/.

``python -m benchmarks.documents.tables`` replaces what stands between ``<!-- table: NAME -->`` and
``<!-- end of table -->`` in every page; with ``--check`` it writes nothing and fails where a page and the
results differ. Tables of the laboratory that are not among ``BUILDERS`` are records: they stay as they are.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fungrasp.core.formats.checks import one_line
from fungrasp.evaluation.result_files import ResultFile, read_result
from fungrasp.task.use import load_use_motions, motion_of

ROOT = Path(__file__).resolve().parents[2]
LAB = ROOT / "lab"
RESULTS = ROOT / "lab" / "results"
NONE = "—"
HANDS = {
    "allegro": "Allegro",
    "shadow": "Shadow",
    "faive": "Faive P0",
    "inspire": "Inspire RH56",
    "leap": "LEAP",
}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "lab").glob("*.md"))]
MARKED = re.compile(r"(<!-- table: (?P<name>\w+) -->\n)(?P<text>.*?)(<!-- end of table -->)", re.DOTALL)
RENAMED = {
    "fungrasp bench retarget --peers": "python -m benchmarks.peers",
    "python -m benchmarks.peers follow": "python -m benchmarks.peers.following",
    "fungrasp reproduce": "python -m benchmarks.paper",
}
"""Beginnings of commands in results, and of the same ones today."""
USED = ("allegro", "shadow", "inspire")
"""Hands of the use test."""
SHOWN = "held_as_shown"
"""Name of the share that is held as shown."""


class Table(NamedTuple):
    """A table and where its numbers come from."""

    head: Sequence[str]
    """Names of the columns."""
    rows: Sequence[Sequence[str]]
    """Cells, as many in each row as columns."""
    results: Sequence[str]
    """Names of the result files."""


def read(name: str) -> ResultFile:
    """A result. name: of its file in ``RESULTS``."""
    return read_result(RESULTS / f"{name}.json")


def percent(share: float | None) -> str:
    """A share, 0 to 1, in percent."""
    return NONE if share is None else f"{100 * share:.1f} %"


def hands() -> Table:
    """Each hand: grasps before physics, one planned motion, and the student."""
    rows = []
    for name, title in HANDS.items():
        plain, student = read(f"hand-{name}").header, read(f"student-{name}").header
        q = plain["quality"]
        rows.append(
            (
                title,
                percent(q["held_as_shown"]["mean"]),
                f"{q['place_error_mm']['mean']:.1f} / {q['place_error_mm']['p90']:.1f}",
                f"{q['object_penetration_mm']['mean']:.1f} / {q['object_penetration_mm']['p95']:.1f}",
                f"{percent(plain['success_rate'])}, {percent(plain['held_as_shown'])}",
                percent(student["success_rate"]),
                f"{percent(student['held_as_shown'])} ({_interval(student['held_as_shown_interval'])})",
                f"{student['rollouts_per_grasp']:.0f}",
            )
        )
    head = ("hand", "grasp as shown", "place error, mean / p90 [mm]", "object penetration, mean / p95 [mm]")
    head += ("one motion: success, as shown", "`student`: success", "`student`: held as shown (95 %)")
    files = [file for name in HANDS for file in (f"hand-{name}", f"student-{name}")]
    return Table((*head, "rollouts per grasp"), rows, files)


def policies() -> Table:
    """Policies of the package with Allegro: worlds as believed, and the reality protocol."""
    files = {
        "`reference`: one motion, open loop": "hand-allegro",
        "`plan`: the student's plan, open loop": "plan",
        "`student`": "student-allegro",
        "`student`, reality protocol, two attempts": "reality-allegro",
    }
    rows = []
    for title, name in files.items():
        h = read(name).header
        success = f"{percent(h['success_rate'])} ({_interval(h['success_interval'])})"
        shown = f"{percent(h[SHOWN])} ({_interval(h[f'{SHOWN}_interval'])})"
        rows.append((title, success, shown, f"{h['place_error_mm']:.1f}", f"{h['contact_ratio']:.2f}"))
    head = ("policy", "success (95 %)", "held as shown (95 %)", "place error [mm]", "contact ratio")
    return Table(head, rows, list(files.values()))


def _interval(ends: Sequence[float]) -> str:
    return "{:.0f} – {:.0f}".format(*(100 * end for end in ends))


def use_test() -> Table:
    """The use test of the built-in grasps whose task has a motion, by motion and hand."""
    known = load_use_motions().values()
    count: dict[str, dict[str, np.ndarray]] = {}
    for hand in USED:
        for row in read(f"use-{hand}").rows:
            if (motion := motion_of(row["task"], known)) is not None:
                passed = bool(row["use_success"])
                numbers = np.array([1, row["success"], row["success"] and row[SHOWN], passed], dtype=int)
                for name in (motion.name, "all"):
                    of = count.setdefault(name, {})
                    of[hand] = of.get(hand, 0) + numbers
    rows = []
    for name in (*sorted(set(count) - {"all"}), "all"):
        by_hand = [count[name][hand] for hand in USED]
        cells = [f"{held}, {shown}, {used}" for _, held, shown, used in by_hand]
        rows.append((name.replace("_", " "), str(by_hand[0][0]), *cells))
    head = ("motion", "grasps", *(f"{HANDS[hand]}: held, as shown, used" for hand in USED))
    return Table(head, rows, [f"use-{hand}" for hand in USED])


PACKAGES = {"ours": "fungrasp", "contact": "fungrasp"}
"""Names of our method in results, and in tables."""
LIFTED = {
    "grasp as shown": "held_as_shown",
    "held as shown": "as_given_held_as_shown",
    "success": "as_given_success",
    "adapted: held as shown": "adapted_held_as_shown",
    "adapted: success": "adapted_success",
}
"""Columns of shares: of the grasps before any physics, of a motion to the grasps as they are, and as adapted
by this package's planner."""


def peers() -> Table:
    """Retargeting methods of this package and of others, by one judge."""
    result = read("peers")
    rows = []
    for name, speed in result.header["grasps_per_cpu_second"].items():
        mine = [row for row in result.rows if row["method"] == name]
        depths = (f"{_mean(mine, f'{what}_penetration_mm'):.1f}" for what in ("object", "table", "self"))
        shares = (percent(_mean(mine, key)) for key in LIFTED.values())
        error = f"{_mean(mine, 'contact_error_mm'):.1f}"
        rows.append((PACKAGES.get(name, name), *shares, error, " / ".join(depths), f"{speed:.0f}"))
    head = ("method", *LIFTED, "contact error [mm]")
    return Table((*head, "object / table / self penetration [mm]", "grasps per CPU second"), rows, ["peers"])


def summary() -> Table:
    """The README's: this package beside two others."""
    result = read("peers")
    rows, columns = [], list(LIFTED.items())[:3]
    for name, speed in result.header["grasps_per_cpu_second"].items():
        if name in (*PACKAGES, "mink", "dex-retargeting"):
            mine = [row for row in result.rows if row["method"] == name]
            shares = (percent(_mean(mine, key)) for _, key in columns)
            rows.append((PACKAGES.get(name, name), *shares, f"{speed:.0f}"))
    head = (f"Allegro, {result.header['grasps']} grasps", *dict(columns), "grasps per CPU second")
    return Table(head, rows, ["peers"])


def _mean(rows: Sequence[dict[str, Any]], key: str) -> float:
    """Of a column."""
    return float(np.mean([row[key] for row in rows]))


def hands_of_others() -> Table:
    """Descriptions by other makers, as they are; those that are made up are for tests."""
    rows = []
    for row in read("hands-of-others").rows:
        if row["hand"].startswith("made up") or "our own" in row["hand"]:
            continue
        if row["refused"]:
            rows.append((row["hand"], *[NONE] * 3, f"rejected: {one_line(row['refused'], 60)}"))
            continue
        lifted = f"{row['lifted']} of {row['grasps']}"
        off = f"{row['contact_error_mm']:.1f}, {row['self_penetration_mm']:.1f}"
        joints = f"{row['driven']} / {row['joints']}"
        rows.append((row["hand"], f"{row['fingers']}, {row['side']}", joints, off, lifted))
    head = ("description", "fingers, side", "joints: driven / all")
    return Table((*head, "contact error, self-penetration [mm]", "lifted"), rows, ["hands-of-others"])


def followed() -> Table:
    """A moving hand followed by this package and by others."""
    files, rows = [f"follow-{hand}" for hand in ("allegro", "shadow")], []
    for name in files:
        header = read(name).header
        for method, f in header["methods"].items():
            tips = f"{f['fingertip_error_mm']:.1f}, {f['fingertip_error_p95_mm']:.1f}"
            deep = f"{f['self_penetration_p95_mm']:.1f}, {percent(f['self_penetrating_share'])}"
            pinch, jitter, time = (f"{f[key]:.1f}" for key in ("pinch_error_mm", "jitter_mrad", "median_ms"))
            rows.append((HANDS[header["hand"]], method, tips, pinch, jitter, deep, time))
    head = ("hand", "method", "fingertips, p95 [mm]", "thumb to fingers [mm]", "jitter [mrad]")
    return Table((*head, "self-penetration p95 [mm], above 1 mm", "ms a frame"), rows, files)


BUILDERS: dict[str, Callable[[], Table]] = {
    "hands": hands,
    "hands_of_others": hands_of_others,
    "policies": policies,
    "use_test": use_test,
    "peers": peers,
    "summary": summary,
    "followed": followed,
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
        if name not in BUILDERS and LAB in page.parents:
            return match[0]
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
    headers = [read(name).header for name in names]
    commands = dict.fromkeys(header["command"] for header in headers)
    dates = sorted({header["date"][:10] for header in headers if "date" in header})
    when = f", {' to '.join(dict.fromkeys((dates[0], dates[-1])))}" if dates else ""
    for command in [command for command in commands if command][:1]:
        more = " and similar commands (in the data files)" if len(commands) > 1 else ""
        yield f"Measured by `{_runnable(command)}`{more}{when}."
    if not any(commands):
        yield "Recorded by hand; no command was kept."
    if ROOT / "docs" in page.parents:  # The site does not hold the results.
        yield f"Data: {', '.join(f'`lab/results/{name}.json`' for name in names)}."
        return
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
