"""Writes the tables of measured numbers in README.md and docs/ from the files in docs/lab/results/.

``python -m benchmarks.documents.tables`` replaces what stands between ``<!-- table: NAME -->`` and
``<!-- end of table -->`` in every page; with ``--check`` it writes nothing and fails where a page and the
results differ.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.documents.perception_table import SOURCES, perception_rows
from fungrasp.evaluation.result_files import ResultFile, read_result
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.formats import (
    image_file,
    json_file,
    mesh_file,
    mujoco_model,
    numpy_files,
    onnx_file,
    pickle_file,
    sandbox,
    toml_file,
    yaml_file,
)
from fungrasp.formats.file_bytes import DEEPEST, MOST_NODES
from fungrasp.formats.xml_file import DEEPEST_ELEMENT

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "lab" / "results"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MARKED = re.compile(r"(<!-- table: (?P<name>\w+) -->\n)(?P<text>.*?)(<!-- end of table -->)", re.DOTALL)
NONE = "—"
RENAMED = {
    "fungrasp bench retarget --peers": "python -m benchmarks.peers",
    "fungrasp bench perception --varied": "python -m benchmarks.perception captures --varied",
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


class Table(NamedTuple):
    """A table and where its numbers come from."""

    head: Sequence[str]
    """Names of the columns."""
    rows: Sequence[Sequence[str]]
    """Cells, as many in each row as columns."""
    results: Sequence[str]
    """Names of the result files."""


HANDS = {
    "allegro": "Allegro",
    "shadow": "Shadow",
    "faive": "Faive P0",
    "inspire": "Inspire RH56",
    "leap": "LEAP",
}


def hands() -> Table:
    """Static quality and success of each hand."""
    head = ("hand", "contact error [mm]", "contact gap [mm]", "link direction [°]")
    head += ("object penetration, mean / p95 [mm]", "success", "contact ratio", "success, not adapted")
    rows = []
    for name, title in HANDS.items():
        header = _read(f"hand-{name}").header
        q = header["quality"]
        rows.append(
            (
                title,
                f"{q['contact_error_mm']['mean']:.1f}",
                f"{q['contact_gap_mm']['mean']:.2f}",
                f"{q['link_direction_error_deg']['mean']:.0f}",
                f"{q['object_penetration_mm']['mean']:.1f} / {q['object_penetration_mm']['p95']:.1f}",
                _percent(header["success_rate"]),
                f"{header['contact_ratio']:.2f}",
                _percent(_read(f"hand-{name}-unadapted").header["success_rate"]),
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
        headers = [_read(name).header for name in found]
        low, high = headers[0]["success_interval"]
        wrong = _percent(headers[1]["success_rate"]) if len(found) > 1 else NONE
        cells = (_percent(headers[0]["success_rate"]), f"{100 * low:.0f} – {100 * high:.0f} %")
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
            header = _read(file).header
            cells += [_with_interval(header), f"{header['contact_ratio']:.2f}"]
        student = _read(f"reality-student-{name}").header
        first = student["attempts"]
        one = {
            "success_rate": first["first_success_rate"],
            "success_interval": first["first_success_interval"],
        }
        cells += [_with_interval(one), _with_interval(student), f"{student['contact_ratio']:.2f}"]
        used += [*files, f"reality-student-{name}", f"reality-plan-{name}"]
        rows.append((f"`{name}`", *cells))
    kinds = ("nominal", "nominal, `--no-rollouts`", "reality, the plan blind")
    head = ("hand", *(word for kind in kinds for word in (kind, "contact ratio")))
    return Table((*head, "reality, one attempt", "reality, two attempts", "contact ratio"), rows, used)


def _with_interval(result: Mapping[str, Any]) -> str:
    """A rate with its 95 % interval."""
    low, high = result["success_interval"]
    return f"{_percent(result['success_rate'])} ({100 * low:.0f} – {100 * high:.0f})"


def failures() -> Table:
    """Why students' episodes fail, all hands together: how many of them, by reason."""
    columns = {
        "nominal": [f"{name}-student-free-held-out" for name in HANDS],
        "reality, two attempts": [f"reality-student-{name}" for name in HANDS],
        "reality, two attempts, Allegro without rollouts": ["reality-student-no-rollouts"],
    }
    episodes = [[row for name in names for row in _read(name).rows] for names in columns.values()]
    reasons = dict.fromkeys(row["reason"] for rows in episodes for row in rows if not row["success"])

    def counts(holds: Callable[[Mapping[str, Any]], bool]) -> list[str]:
        failed = ([row for row in rows if not row["success"]] for rows in episodes)
        return [str(sum(map(holds, rows))) for rows in failed]

    rows = [("episodes", *(str(len(rows)) for rows in episodes)), ("failed", *counts(lambda row: True))]
    rows += [(reason, *counts(lambda row, reason=reason: row["reason"] == reason)) for reason in reasons]
    rows.append(("of all that failed, pushed by over 3 cm", *counts(lambda row: row["pushed_m"] > 0.03)))
    return Table(("", *columns), rows, [name for names in columns.values() for name in names])


def use_test() -> Table:
    """The use test of built-in grasps that nothing was tuned to."""
    results = _read("use-test").rows
    motions = sorted({row["motion"] for row in results})
    rows = []
    for hand, policy in dict.fromkeys((row["hand"], row["policy"]) for row in results):
        group = [row for row in results if (row["hand"], row["policy"]) == (hand, policy)]
        held = [row for row in group if row["held"]]
        cells = [f"{HANDS[hand]}, `{policy}`", str(len(group)), str(len(held))]
        for of in (held, group):
            passed = sum(row["passed"] for row in of)
            low, high = wilson_interval(passed, len(of))
            cells.append(f"{passed}: {100 * passed / len(of):.0f} % ({100 * low:.0f} – {100 * high:.0f})")
        for motion in motions:
            mine = [row["passed"] for row in held if row["motion"] == motion]
            cells.append(f"{sum(mine)} / {len(mine)}" if mine else "")
        rows.append(cells)
    head = ("hand, policy", "grasps", "held", "of these pass", "of all")
    return Table((*head, *(motion.replace("_", " ") for motion in motions)), rows, ["use-test"])


def policies_in_full() -> Table:
    """Success, contacts and slip of every policy, with and without rollouts."""
    names = ("reference", "allegro-critic-free", "allegro-student-free", "allegro-critic")
    names += ("allegro-teacher", "allegro-student")
    without = {row["policy"]: row for row in _read("policies-without-rollouts").rows}
    rows, used = [], ["policies-without-rollouts"]
    for name in names:
        title, cells = f"`{name}`", [NONE] * 3
        if (RESULTS / f"{name}.json").is_file():
            used.append(name)
            title, cells = _measured(name)
        plain = without.get(name)
        if plain is not None:
            slip = _slip(plain["slip_mean_mm_s"], plain["slip_median_mm_s"])
            cells = [*cells, _percent(plain["success_rate"]), f"{plain['contact_ratio']:.2f}", slip]
        rows.append((title, *cells, *[NONE] * (6 - len(cells))))
    head = ("policy", "with rollouts: success", "contact ratio", "slip [mm/s], mean / median")
    head += ("without: success", "contact ratio", "slip, mean / median")
    return Table(head, rows, used)


def _measured(name: str) -> tuple[str, list[str]]:
    """Title and cells of a policy's episodes."""
    rows = _read(name).rows
    seeds = sorted({row["seed"] for row in rows})
    success = np.array([row["success"] for row in rows])
    slips = np.array([row["sim_distance_hand_mm_s"] for row in rows])
    contacts = np.mean([row["contact_ratio"] for row in rows])
    title, share = f"`{name}`", _percent(success.mean())
    if len(seeds) > 1:
        title += f", seeds {', '.join(map(str, seeds))}"
        of_seed = np.array([row["seed"] for row in rows])
        share += f" ({', '.join(f'{100 * success[of_seed == seed].mean():.1f}' for seed in seeds)})"
    return title, [share, f"{contacts:.2f}", _slip(slips.mean(), float(np.median(slips)))]


def methods() -> Table:
    """Retargeting methods side by side."""
    rows = []
    for row in _read("methods").rows:
        name = row["method"] if row["method"] in ("ours", "contact") else f"`{row['method']}`"
        plain = (_percent(row["success_rate_unadapted"]), f"{row['contact_ratio_unadapted']:.2f}")
        rows.append((name, _percent(row["success_rate"]), f"{row['contact_ratio']:.2f}", *plain))
    head = ("method", "success", "contact ratio", "success, not adapted", "contact ratio, not adapted")
    return Table(head, rows, ["methods"])


def peers() -> Table:
    """Retargeting methods of this package and of others, by one judge."""
    result = _read("peers")
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
                    _percent(mean(f"{test}_success")) if f"{test}_success" in mine[0] else NONE
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
    shares = [_condition_shares(_read(name).rows) for name in columns.values()]
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


def ablations() -> Table:
    """What is known of the contacts, in nominal worlds, with a larger budget."""
    titles = {
        "without": "without privileged information",
        "scratch": "student from scratch",
        "teacher": "teacher",
        "student": "student, distilled from it",
    }
    rows = []
    for name, title in titles.items():
        header = _read(f"ablation-{name}").header
        rows.append(
            (
                title,
                _percent(header["success_rate"]),
                f"{header['contact_ratio']:.2f}",
                f"{header['sim_distance_hand_mm_s']:.1f}",
                f"{100 * header['variant']['paper']['success']:.0f} %",
            )
        )
    head = ("policy", "success", "contact ratio", "slip [mm/s]", "paper: success")
    return Table(head, rows, [f"ablation-{name}" for name in titles])


def privileged() -> Table:
    """What is known of the contacts (Table V of the paper), with three seeds, under nominal and reality."""
    return _reproduced("table-privileged", "policy")


def paper_retargeting() -> Table:
    """Teachers on the grasps of each retargeting method (Table IV of the paper), with three seeds."""
    return _reproduced("table-retargeting", "grasps of")


def paper_hands() -> Table:
    """Students of the paper's hands (Table III of the paper), with equal budgets."""
    return _reproduced("table-hands", "hand")


def _reproduced(name: str, what: str) -> Table:
    """A table of ``python -m benchmarks.paper``: the kept result's name, and what its rows are."""
    head = (what, "nominal", "contact ratio", "not adapted", "reality", "contact ratio", "paper: success")
    rows = []
    for policy in _read(name).header["policies"]:
        nominal, unadapted, reality = policy["conditions"].values()
        paper = policy["paper"]
        rows.append(
            (
                policy["title"],
                _with_interval(nominal),
                f"{nominal['contact_ratio']:.2f}",
                _percent(unadapted["success_rate"]),
                _with_interval(reality),
                f"{reality['contact_ratio']:.2f}",
                NONE if paper is None else f"{100 * paper['success']:.0f} %",
            )
        )
    return Table(head, rows, [name])


def perception() -> Table:
    """What is found in captures of objects kept aside, against the targets."""
    return Table(("figure", "target", "measured"), perception_rows(_read), SOURCES)


def chain() -> Table:
    """From image to lift: how many objects are lifted from true and from perceived grasps."""
    rows = []
    for name, part in _read("perception-chain").header["chain"]["policies"].items():
        counts = [round(part[what]["rate"] * part[what]["count"]) for what in ("true", "perceived")]
        rows.append((f"`{name}`", *map(str, counts), f"{100 * part['share']:.0f} %"))
    head = ("policy", "lifted, of the true grasps", "of the perceived ones", "share")
    return Table(head, rows, ["perception-chain"])


def driver_faults() -> Table:
    """How drivers react to faults of emulated devices."""
    kinds = ("ur", "ur-clock", "inspire", "leap", "allegro", "allegro-saturated", "allegro-v5", "tracker")
    return _reactions([f"driver-faults-{kind}" for kind in kinds])


def control_faults() -> Table:
    """What arm and hand do when the computer that controls them fails."""
    kinds = ("control", "control-killed", "control-inspire")
    return _reactions([f"driver-faults-{kind}" for kind in kinds], logs=True)


def _reactions(names: Sequence[str], logs: bool = False) -> Table:
    """Reactions by device and fault; trials that ended before their fault are left out."""
    trials = [row for name in names for row in _read(name).rows if not row["fault"].startswith("none")]
    head = ("device", "fault", "trials", "limit [ms]", "seen", "after, median / 95 % [ms]")
    head += ("stands", "after, median / 95 % [ms]", *["log read"] * logs, "restarted")
    rows = []
    for device, fault in dict.fromkeys((t["device"], t["fault"]) for t in trials):
        group = [t for t in trials if (t["device"], t["fault"]) == (device, fault)]
        seen, stopped = ([t[key] for t in group if t[key] is not None] for key in ("detected", "stopped"))
        limit = group[0].get("limit")
        # Trackers move nothing.
        stands = NONE if device == "tracker" else f"{len(stopped)}"
        cells = (
            device,
            fault,
            str(len(group)),
            NONE if limit is None else f"{1e3 * limit:.0f}",
            f"{len(seen)}",
            _milliseconds(seen),
            stands,
            _milliseconds(stopped),
        )
        read = [str(sum(bool(t["log_readable"]) for t in group))] if logs else []
        rows.append((*cells, *read, f"{sum(t['restarted'] for t in group)}"))
    return Table(head, rows, names)


def _milliseconds(seconds: Sequence[float]) -> str:
    if not seconds:
        return NONE
    return f"{1e3 * np.median(seconds):.0f} / {1e3 * np.percentile(seconds, 95):.0f}"


def driver_speed() -> Table:
    """What drivers cost against emulated devices."""
    head = ("device", "steps/s", "processor time of a step [µs]", "`command` [µs]", "`read` [µs]")
    rows = []
    for r in _read("driver-speed").rows:
        step = 1e6 * r["busy_share"] / r["rate"]
        times = (f"{step:.0f}", f"{1e6 * r['command']:.0f}", f"{1e6 * r['read']:.0f}")
        rows.append((r["device"], f"{r['rate']:.0f}", *times))
    return Table(head, rows, ["driver-speed"])


def identification() -> Table:
    """Identified dynamics against known ones, by method."""
    head = (
        "method",
        "truths",
        "median error",
        "largest",
        "delay error [ms]",
        "held-out RMS [rad]",
        "time [s]",
    )
    results = [row for row in _read("identification").rows if row["log"] == "known truth"]
    rows = []
    for method in dict.fromkeys(row["method"] for row in results):
        group = [row for row in results if row["method"] == method]
        keys = ("median_error", "held_out_rms", "seconds")
        median = {key: float(np.median([row[key] for row in group])) for key in keys}
        largest = max(row["largest_error"] for row in group)
        delay = 1e3 * max(abs(row["delay_error"]) for row in group)
        errors = (_percent(median["median_error"]), _percent(largest), f"{delay:.2f}")
        fit = (f"{median['held_out_rms']:.4f}", f"{median['seconds']:.0f}")
        rows.append((method, str(len(group)), *errors, *fit))
    return Table(head, rows, ["identification"])


def identification_twins() -> Table:
    """Identified dynamics of twins' hands against their truth, by hand and method."""
    head = ("hand", "method", "twins", "median error, of the model", "stiffness", "damping", "friction")
    head += ("armature", "delay error [ms]", "held-out RMS [rad]", "time [s]")
    names = ["identification-twins", "identification-weights"]
    names = [name for name in names if (RESULTS / f"{name}.json").is_file()]
    results = [row for name in names for row in _read(name).rows]
    for row in results:
        if row.get("weight"):
            row["hand"] += f", {row['weight']:g} kg on each fingertip"
    rows = []
    for hand, method in dict.fromkeys((row["hand"], row["method"]) for row in results):
        group = [row for row in results if (row["hand"], row["method"]) == (hand, method)]

        def median(key: str, group: Sequence[Mapping[str, Any]] = group) -> float:
            return float(np.median([abs(row[key]) for row in group]))

        error = f"{_percent(median('median_error'))}, {_percent(median('model_error'))}"
        kinds = ("stiffness", "damping", "friction", "armature")
        parts = [_percent(median(f"errors.{name}")) for name in kinds]
        end = (
            f"{1e3 * median('delay_error'):.1f}",
            f"{median('held_out_rms'):.4f}",
            f"{median('seconds'):.0f}",
        )
        rows.append((hand, method, str(len(group)), error, *parts, *end))
    return Table(head, rows, names)


WIRE = {
    "wire": "UR5e, Allegro, `plan`",
    "wire-student": "UR5e, Allegro, `student`",
    "wire-image": "UR5e, Allegro, `plan`, from images",
    "wire-image-student": "UR5e, Allegro, `student`, from images",
    "wire-inspire": "UR5e, Inspire, `plan`",
}
"""Results of ``bench wire``, as far as they are there."""


def wire() -> Table:
    """Deployments over the wire."""
    head = ("chain", "runs", "lifted and held", "home again", "largest lateness, 10 Hz / 50 Hz [ms]")
    head += (
        "longest silence, arm / hand [ms]",
        "lost by the twin [ms], median",
        "of a core: control, arm, hand, emulators",
    )
    known = {name: title for name, title in WIRE.items() if (RESULTS / f"{name}.json").is_file()}
    return Table(
        head, [(title, *_wire_cells(_read(name).rows)) for name, title in known.items()], list(known)
    )


def _wire_cells(runs: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    late = " / ".join(f"{max(r[f'latest_{rate}hz_ms'] for r in runs):.0f}" for rate in (10, 50))
    # Runs that could not begin have none.
    silent = " / ".join(
        f"{max(r.get(f'longest_silence_ms.{name}') or 0.0 for r in runs):.0f}" for name in ("arm", "hand")
    )
    names = ("control", "arm driver", "hand driver", "emulators")
    known = [[r.get(f"cores.{name}") for r in runs] for name in names]
    cores = ", ".join(f"{100 * np.median([v for v in values if v is not None]):.0f} %" for values in known)
    home = sum(r["success"] and not r["fault"] for r in runs)
    lost = f"{np.median([r['twin_lost_ms'] for r in runs]):.0f}"
    return (f"{len(runs)}", f"{sum(r['success'] for r in runs)}", f"{home}", late, silent, lost, cores)


def wire_ticks() -> Table:
    """Lateness of control steps and setpoints over the wire."""
    runs = _read("wire").rows
    prefix = "ticks_10hz."
    edges = [name.removeprefix(prefix) for name in runs[0] if name.startswith(prefix)]
    rows = [
        (edge, *(f"{sum(r[f'ticks_{rate}hz.{edge}'] for r in runs)}" for rate in (10, 50))) for edge in edges
    ]
    return Table(("late by", "10 Hz", "50 Hz"), rows, ["wire"])


def identification_ratios() -> Table:
    """What identification finds of an Inspire hand: values, ratios, and what it says of itself."""
    head = ("quantity", "error", "error of its ratio to the stiffness", "standard deviation the fit states")
    results = _read("identification-inspire").rows
    rows = []
    for name in ("stiffness", "damping", "friction", "armature"):

        def median(part: str, name: str = name) -> str:
            values = [row.get(f"{part}.{name}") for row in results]
            known = [value for value in values if value is not None]
            return NONE if len(known) < len(values) else _percent(float(np.median(known)))

        ratio = NONE if name == "stiffness" else median("ratio_errors")
        rows.append((name, median("errors"), ratio, median("uncertainty")))
    return Table(head, rows, ["identification-inspire"])


TWINS = ("twin-allegro-node", "twin-allegro-again", "twin-inspire", "twin-inspire-again")
"""Results of ``fungrasp robots evaluate``."""


def twin_variants() -> Table:
    """The lift test on twins, by robot and way to deploy."""
    head = ("robot", "variant", "episodes", "not begun", "begun", "lifted and held", "of those begun (95 %)")
    head += ("tracking, RMS [rad]", "sag [degrees]")
    rows = []
    for name in TWINS:
        results = _read(name)
        for variant in dict.fromkeys(row["variant"] for row in results.rows):
            group = [row for row in results.rows if row["variant"] == variant]
            begun = [row for row in group if row["tracking_rad"] >= 0]
            lifted = sum(row["success"] for row in begun)
            low, high = wilson_interval(lifted, len(begun))
            rate = f"{_percent(lifted / len(begun))} ({100 * low:.0f} to {100 * high:.0f})"
            off = f"{np.median([row['tracking_rad'] for row in begun]):.3f}"
            sag = f"{np.rad2deg(np.median([row['sag_rad'] for row in begun])):.1f}"
            counts = (f"{n}" for n in (len(group), len(group) - len(begun), len(begun), lifted))
            rows.append((results.header["robot"], variant, *counts, rate, off, sag))
    return Table(head, rows, list(TWINS))


def twin_images() -> Table:
    """From an image to a twin that lifts (Table II of the paper)."""
    results = _read("twin-images")
    begun = [row for row in results.rows if row["tracking_rad"] >= 0]
    lifted = [row for row in begun if row["success"]]
    first = sum(row["attempts"] == 1 for row in lifted)
    images, refused = results.header["images"], len(results.header["not_seen"])
    beyond = len(results.header["out_of_reach"].split())
    reached = results.header["grasps_that_can_be_reached"]

    def share(count: int, number: int) -> str:
        low, high = wilson_interval(count, number)
        return f"{count} of {number}: {_percent(count / number)} ({100 * low:.0f} to {100 * high:.0f})"

    rows = [
        ("images shown; refused by perception, with what is wrong", f"{images}; {refused}"),
        ("grasps seen in the others that were looked at", f"{beyond + reached}"),
        ("of these, no placement can be reached", f"{beyond}"),
        ("deployments, objects", f"{len(results.rows)}, {len({row['object'] for row in results.rows})}"),
        ("refused by the robot, or stopped before the grasp", f"{len(results.rows) - len(begun)}"),
        ("**lifted and held, of those begun**", f"**{share(len(lifted), len(begun))}**"),
        ("the same by the first attempt", share(first, len(begun))),
        ("lifted and held, of all deployments", share(len(lifted), len(results.rows))),
        ("objects lifted at least once", f"{len({row['object'] for row in lifted})}"),
    ]
    return Table(("ur5e-allegro-node, `student`, two attempts", ""), rows, ["twin-images"])


def identification_step() -> Table:
    """A real hand's step, measured and predicted on rows that were held out."""
    head = ("method", "delay, measured / predicted [ms]", "rise time, measured / predicted [ms]")
    rows = []
    for r in _read("identification").rows:
        if r["log"] == "real step":
            delay, rise = (f"{1e3 * r[k]:.1f} / {1e3 * r[f'{k}_predicted']:.1f}" for k in ("delay", "rise"))
            rows.append((r["method"], delay, rise, f"{r['held_out_rms']:.4f}"))
    return Table((*head, "held-out RMS [rad]"), rows, ["identification"])


def limits() -> Table:
    """What is read of each format, from the constants that the readers use."""
    plain = f"{MOST_NODES / 1e6:g} million values, {DEEPEST} levels, integers of 64 bits"
    child = f"{sandbox.SECONDS:g} s and 1 s for each {sandbox.BYTES_PER_SECOND / 1e6:g} MB"
    child += f"; {sandbox.MEMORY / 1e9:g} GB"
    kept = f"{numpy_files.LARGEST >> 20} MB of arrays, {numpy_files.MOST_ARRAYS} arrays, "
    kept += f"{numpy_files.MOST_AXES} axes"
    rows = [
        ("NumPy (`.npz`, `.npy`)", _megabytes(numpy_files.LARGEST), f"{kept}; numbers, flags, text", NONE),
        ("JSON", _megabytes(json_file.LARGEST), plain, NONE),
        ("TOML", _megabytes(toml_file.LARGEST), plain, NONE),
        ("YAML", _megabytes(yaml_file.LARGEST), plain, NONE),
        (
            "pickle",
            _megabytes(pickle_file.LARGEST),
            f"{pickle_file.MOST_STEPS / 1e6:g} million steps; arrays",
            NONE,
        ),
        (
            f"images ({', '.join(image_file.FORMATS)})",
            _megabytes(image_file.LARGEST),
            f"{image_file.LARGEST_PIXELS / 1e6:g} million pixels",
            NONE,
        ),
        ("meshes", _megabytes(mesh_file.LARGEST), f"{mesh_file.MOST_FACES / 1e6:g} million faces", child),
        (
            "MJCF, URDF",
            _megabytes(mujoco_model.LARGEST),
            f"{DEEPEST_ELEMENT} levels, no entities, declared sizes up to {mujoco_model.LARGEST_SIZE:,}",
            child,
        ),
        (
            "ONNX",
            _megabytes(onnx_file.LARGEST),
            f"{onnx_file.MOST_MESSAGES:,} nodes, attributes, tensors; {len(onnx_file.OPERATORS)} operators",
            child,
        ),
    ]
    return Table(
        ("format", "largest file", "what it may hold", "processor time; memory to parse it"), rows, []
    )


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.3g} MB"


def fuzz() -> Table:
    """Damaged files by kind."""
    result = _read("fuzz")
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
        for row in _read("kills").rows
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
    result, cells = _read("cluster"), []
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
    for told, numbers in _read(name).header["object"].items():
        cells = [_of_count(numbers[key]) for key in ("right", "accepted_and_right", "right_and_accepted")]
        error, seconds = f"{numbers['add_s_mm']:.1f}", f"{numbers['seconds']:.1f}"
        rows.append((told, cells[0], error, *cells[1:], seconds))
    return Table(head, rows, [name])


def _of_count(share: Mapping[str, Any]) -> str:
    """A share as counts."""
    return f"{round(share['rate'] * share['count'])} of {share['count']}"


def recorded(name: str) -> Callable[[], Table]:
    """A table whose cells are kept as they were written down, with their head in the header."""

    def build() -> Table:
        result = _read(name)
        return Table(result.header["head"], [list(row.values()) for row in result.rows], [name])

    return build


BUILDERS: dict[str, Callable[[], Table]] = {
    "hands": hands,
    "policies": policies,
    "failures": failures,
    "use_test": use_test,
    "policies_in_full": policies_in_full,
    "students": students,
    "methods": methods,
    "peers": peers,
    "robustness": robustness,
    "ablations": ablations,
    "privileged": privileged,
    "paper_hands": paper_hands,
    "paper_retargeting": paper_retargeting,
    "perception": perception,
    "chain": chain,
    "driver_faults": driver_faults,
    "control_faults": control_faults,
    "driver_speed": driver_speed,
    "identification": identification,
    "identification_step": identification_step,
    "identification_twins": identification_twins,
    "identification_ratios": identification_ratios,
    "twin_variants": twin_variants,
    "twin_images": twin_images,
    "wire": wire,
    "wire_ticks": wire_ticks,
    "limits": limits,
    "fuzz": fuzz,
    "kills": kills,
    "cluster": cluster,
    "adapters": recorded("adapters"),
    "depth_statistics": recorded("depth-statistics"),
    "experiments_hand_fit": recorded("experiments-hand-fit"),
    "experiments_policies": recorded("experiments-policies"),
    "experiments_left": recorded("experiments-left"),
    "hands_added": recorded("hands-added"),
    "perception_varied": recorded("perception-varied"),
    "perception_varied_held_out": varied_captures,
    "select_by_quality": recorded("select-by-quality"),
    "experiments_reality": recorded("experiments-reality"),
    "experiments_retargeting": recorded("experiments-retargeting"),
    "experiments_rollouts": recorded("experiments-rollouts"),
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


def _read(name: str) -> ResultFile:
    return read_result(RESULTS / f"{name}.json")


def _sources(names: Sequence[str], page: Path) -> Iterator[str]:
    """What made the numbers, and links to the files."""
    if not names:
        return
    commands = dict.fromkeys(_read(name).header["command"] for name in names)
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


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.1f} %"


def _slip(mean: float, median: float | None) -> str:
    return f"{mean:.1f} / {NONE if median is None else f'{median:.1f}'}"


if __name__ == "__main__":
    sys.exit(main())
