"""Tables of perception, files and clusters."""

from __future__ import annotations

from benchmarks.documents.measured import (
    NONE,
    Table,
    of_count,
    read,
)
from benchmarks.documents.perception_table import SOURCES, perception_rows


def perception() -> Table:
    """What is found in captures of objects kept aside, against the targets."""
    return Table(("figure", "target", "measured"), perception_rows(read), SOURCES)


def hands_added() -> Table:
    """Hands of other makers: what became of their descriptions, and how many grasps they lift."""
    head = (
        "hand",
        "fingers",
        "joints, driven / all",
        "contact error, largest self-penetration [mm]",
        "success",
    )
    rows = []
    for row in read("hands-added").rows:
        if row["refused"]:
            rows.append((row["hand"], NONE, NONE, NONE, f"refused: {row['refused']}"))
            continue
        rows.append(
            (
                row["hand"],
                str(row["fingers"]),
                f"{row['driven']} / {row['joints']}",
                f"{row['contact_error_mm']:.1f}, {row['self_penetration_mm']:.1f}",
                f"{100 * row['lifted'] / row['grasps']:.0f} %",
            )
        )
    return Table(head, rows, ["hands-added"])


def varied_captures() -> Table:
    """Objects in varied captures that nothing was chosen by, by what perception is told of them."""
    head = (
        "told",
        "ADD-S below 10 mm",
        "median [mm]",
        "accepted are right",
        "right are accepted",
        "time [s]",
    )
    name = "perception-varied-held-out"
    rows = []
    for told, numbers in read(name).header["object"].items():
        cells = [of_count(numbers[key]) for key in ("right", "accepted_and_right", "right_and_accepted")]
        error, seconds = f"{numbers['add_s_mm']:.1f}", f"{numbers['seconds']:.1f}"
        rows.append((told, cells[0], error, *cells[1:], seconds))
    return Table(head, rows, [name])


def fuzz() -> Table:
    """Damaged files by kind."""
    result = read("fuzz")
    rows = [
        (
            row["kind"],
            f"{row['cases']:,}",
            f"{row['taken']:,}",
            f"{row['refused']:,}",
            str(row["unclean"]),
            f"{row['slowest_s']:.1f}",
            f"{row['memory_mb']:.0f}",
        )
        for row in result.rows
    ]
    head = ("kind", "cases", "taken", "refused", "not clean", "slowest [s]", "largest memory [MB]")
    return Table(head, rows, ["fuzz"])


def kills() -> Table:
    """Long work that was killed and went on."""
    rows = [
        (f"`{row['what']}`", str(row["kills"]), str(row["finished"]), str(row["found"]))
        for row in read("kills").rows
    ]
    return Table(("work", "killed", "came to its end", "other result, or something left"), rows, ["kills"])


def cluster() -> Table:
    """A cluster, one machine of which was killed, beside one process."""
    head = (
        "",
        "processors",
        "time [s]",
        "processor time [s]",
        "at work",
        "work in a processor second",
        "same outcomes",
    )
    result, cells = read("cluster"), []
    header = result.header
    for row in result.rows:
        many = row["run"] == "cluster"
        cells.append(
            (
                f"{header['machines']} machines, one killed half way" if many else row["run"],
                f"{row['processors']:.2f}",
                f"{row['seconds']:.0f}",
                f"{row['processor_seconds']:.0f}",
                f"{row['at_work']:.1%}",
                f"{header['work_per_processor_second']:.1%}" if many else "100 %",
                f"{header['equal']:,} of {header['grasps']:,}" if many else NONE,
            )
        )
    return Table(head, cells, ["cluster"])
