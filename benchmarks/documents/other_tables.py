"""Tables of perception, and of hands that were added."""

from __future__ import annotations

from benchmarks.documents.measured import (
    NONE,
    Table,
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
