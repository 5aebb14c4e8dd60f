"""Tables of grasps, policies and the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.documents.measured import (
    HANDS,
    NONE,
    RESULTS,
    Table,
    percent,
    read,
    with_interval,
)
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.task.use import load_use_motions, motion_of

USED = ("allegro", "shadow", "inspire")
"""Hands of the use test."""


def hands() -> Table:
    """Static quality and success of each hand."""
    head = ("hand", "contact error [mm]", "contact gap [mm]", "link direction [°]")
    head += ("object penetration, mean / p95 [mm]", "success", "contact ratio", "success, not adapted")
    rows = []
    for name, title in HANDS.items():
        header = read(f"hand-{name}").header
        q = header["quality"]
        rows.append(
            (
                title,
                f"{q['contact_error_mm']['mean']:.1f}",
                f"{q['contact_gap_mm']['mean']:.2f}",
                f"{q['link_direction_error_deg']['mean']:.0f}",
                f"{q['object_penetration_mm']['mean']:.1f} / {q['object_penetration_mm']['p95']:.1f}",
                percent(header["success_rate"]),
                f"{header['contact_ratio']:.2f}",
                percent(read(f"hand-{name}-unadapted").header["success_rate"]),
            )
        )
    files = [file for name in HANDS for file in (f"hand-{name}", f"hand-{name}-unadapted")]
    return Table(head, rows, files)


def policies() -> Table:
    """Success of what comes with the package: belief right, and belief wrong."""
    files = {
        "`reference`": ("hand-allegro", "reference-pose-noise"),
        "`reference`, `--refine 16` in the test's own world": ("refined", None),
        "`student`, `--no-rollouts`": ("student-no-rollouts", None),
        "`student`": ("student", "student-pose-noise"),
        "`plan`: the student's plan, open loop": ("plan", None),
    }
    rows, used = [], []
    for title, names in files.items():
        found = [name for name in names if name and (RESULTS / f"{name}.json").is_file()]
        if names[0] not in found:
            continue
        headers = [read(name).header for name in found]
        low, high = headers[0]["success_interval"]
        wrong = percent(headers[1]["success_rate"]) if len(found) > 1 else NONE
        cells = (percent(headers[0]["success_rate"]), f"{100 * low:.0f} – {100 * high:.0f} %")
        rows.append((title, *cells, f"{headers[0]['contact_ratio']:.2f}", wrong))
        used += found
    head = ("policy", "success", "95 % interval", "contact ratio", "success, object 1 cm and 10° off")
    return Table(head, rows, used)


def students() -> Table:
    """Success of the free student of each hand, with and without rollouts, and in the reality protocol, where
    it may try twice."""
    rows, used = [], []
    for name in HANDS:
        cells: list[str] = []
        files = (f"{name}-student-free-held-out", f"{name}-student-free-no-rollouts")
        for file in (*files, f"reality-plan-{name}"):
            header = read(file).header
            cells += [with_interval(header), f"{header['contact_ratio']:.2f}"]
        student = read(f"reality-student-{name}").header
        first = student["attempts"]
        one = {
            "success_rate": first["first_success_rate"],
            "success_interval": first["first_success_interval"],
        }
        cells += [with_interval(one), with_interval(student), f"{student['contact_ratio']:.2f}"]
        used += [*files, f"reality-student-{name}", f"reality-plan-{name}"]
        rows.append((f"`{name}`", *cells))
    kinds = ("nominal", "nominal, `--no-rollouts`", "reality, the plan blind")
    head = ("hand", *(word for kind in kinds for word in (kind, "contact ratio")))
    return Table((*head, "reality, one attempt", "reality, two attempts", "contact ratio"), rows, used)


def failures() -> Table:
    """Why students' episodes fail, all hands together: how many of them, by reason."""
    columns = {
        "nominal": [f"{name}-student-free-held-out" for name in HANDS],
        "reality, two attempts": [f"reality-student-{name}" for name in HANDS],
        "reality, two attempts, Allegro without rollouts": ["reality-student-no-rollouts"],
    }
    episodes = [[row for name in names for row in read(name).rows] for names in columns.values()]
    reasons = dict.fromkeys(row["reason"] for rows in episodes for row in rows if not row["success"])

    def counts(holds: Callable[[Mapping[str, Any]], bool]) -> list[str]:
        failed = ([row for row in rows if not row["success"]] for rows in episodes)
        return [str(sum(map(holds, rows))) for rows in failed]

    rows = [("episodes", *(str(len(rows)) for rows in episodes)), ("failed", *counts(lambda row: True))]
    rows += [(reason, *counts(lambda row, reason=reason: row["reason"] == reason)) for reason in reasons]
    rows.append(("of all that failed, pushed by over 3 cm", *counts(lambda row: row["pushed_m"] > 0.03)))
    return Table(("", *columns), rows, [name for names in columns.values() for name in names])


def use_test() -> Table:
    """The use test of the built-in grasps whose task has a motion, by hand; of all, not of those held."""
    known = load_use_motions().values()
    rows = []
    for hand in USED:
        counts: dict[str, list[bool]] = {motion.name: [] for motion in known}
        held = []
        for row in read(f"use-{hand}").rows:
            if (motion := motion_of(row["task"], known)) is not None:
                counts[motion.name].append(row["use_success"])
                held.append(row["success"])
        number, used = len(held), sum(map(sum, counts.values()))
        low, high = wilson_interval(used, number)
        whole = f"{used}: {100 * used / number:.0f} % ({100 * low:.0f} – {100 * high:.0f})"
        each = (f"{sum(passed)} of {len(passed)}" for passed in counts.values())
        rows.append((HANDS[hand], str(number), str(sum(held)), whole, *each))
    motions = (motion.name.replace("_", " ") for motion in known)
    return Table(("hand", "grasps", "held", "used", *motions), rows, [f"use-{hand}" for hand in USED])


def methods() -> Table:
    """Retargeting methods side by side."""
    rows = []
    for row in read("methods").rows:
        name = row["method"] if row["method"] in ("ours", "contact") else f"`{row['method']}`"
        plain = (percent(row["success_rate_unadapted"]), f"{row['contact_ratio_unadapted']:.2f}")
        rows.append((name, percent(row["success_rate"]), f"{row['contact_ratio']:.2f}", *plain))
    head = ("method", "success", "contact ratio", "success, not adapted", "contact ratio, not adapted")
    return Table(head, rows, ["methods"])


def peers() -> Table:
    """Retargeting methods of this package and of others, by one judge."""
    result = read("peers")
    speed = result.header["grasps_per_cpu_second"]
    rows = []
    for name in speed:
        mine = [row for row in result.rows if row["method"] == name]

        def mean(key: str, mine: list[dict[str, Any]] = mine) -> float:
            return float(np.mean([row[key] for row in mine]))

        depths = (f"{mean(f'{what}_penetration_mm'):.1f}" for what in ("object", "table", "self"))
        rows.append(
            (
                name,
                f"{speed[name]:.0f}",
                f"{mean('contact_error_mm'):.1f}, {mean('contact_gap_mm'):.1f}",
                " / ".join(depths),
                f"{mean('link_direction_error_deg'):.0f}",
                *(
                    percent(mean(f"{test}_success")) if f"{test}_success" in mine[0] else NONE
                    for test in ("adapted", "as_given")
                ),
            )
        )
    head = ("method", "grasps per CPU second", "contact error, gap [mm]")
    head += (
        "object / table / self penetration [mm]",
        "link direction [°]",
        "success",
        "success, not adapted",
    )
    return Table(head, rows, ["peers"])


def robustness() -> Table:
    """Success under each condition of the robustness protocol [%]."""
    columns = {
        "`reference`": "robustness-reference",
        "`reference`, `--refine 16`": "robustness-refined",
        "`allegro-student`": "robustness-student",
    }
    shares = [_condition_shares(read(name).rows) for name in columns.values()]
    rows = [(name, *(f"{100 * share[name]:.0f}" for share in shares)) for name in shares[0]]
    means = [np.mean([value for name, value in share.items() if name != "nominal"]) for share in shares]
    rows.append(("mean of the ten disturbed", *(f"{100 * mean:.1f}" for mean in means)))
    return Table(("condition", *columns), rows, list(columns.values()))


def _condition_shares(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Share of successes by condition, in the order of the file."""
    prefix = "robustness/"
    parts = dict.fromkeys(row["part"] for row in rows if row["part"].startswith(prefix))
    return {
        part.removeprefix(prefix): float(np.mean([row["success"] for row in rows if row["part"] == part]))
        for part in parts
    }


def hands_from_nothing() -> Table:
    """Students of the paper's hands (Table III of the paper), in its setting."""
    return _reproduced("nothing-hands", "hand")


def retargeting_from_nothing() -> Table:
    """Teachers on the grasps of each retargeting method (Table IV of the paper), in its setting."""
    return _reproduced("nothing-retargeting", "grasps of")


def privileged_from_nothing() -> Table:
    """What is known of the contacts (Table V of the paper), in its setting."""
    return _reproduced("nothing-privileged", "policy")


def _reproduced(name: str, what: str) -> Table:
    """A table of ``python -m benchmarks.paper``: the kept result's name, and what its rows are."""
    head = (what, "nominal", "contact ratio", "not adapted", "reality", "contact ratio", "paper: success")
    rows = []
    for policy in read(name).header["policies"]:
        nominal, unadapted, reality = policy["conditions"].values()
        paper = policy["paper"]
        rows.append(
            (
                policy["title"],
                with_interval(nominal),
                f"{nominal['contact_ratio']:.2f}",
                percent(unadapted["success_rate"]),
                with_interval(reality),
                f"{reality['contact_ratio']:.2f}",
                NONE if paper is None else f"{100 * paper['success']:.0f} %",
            )
        )
    return Table(head, rows, [name])
