"""Tables of drivers, identification, wires and twins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.documents.measured import (
    NONE,
    RESULTS,
    Table,
    milliseconds,
    percent,
    read,
)
from fungrasp.evaluation.statistics import wilson_interval


def control_faults() -> Table:
    """What arm and hand do when the computer that controls them fails."""
    kinds = ("control", "control-killed", "control-inspire")
    return _reactions([f"driver-faults-{kind}" for kind in kinds], logs=True)


def _reactions(names: Sequence[str], logs: bool = False) -> Table:
    """Reactions by device and fault; trials that ended before their fault are left out."""
    trials = [row for name in names for row in read(name).rows if not row["fault"].startswith("none")]
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
            milliseconds(seen),
            stands,
            milliseconds(stopped),
        )
        readable = [str(sum(bool(t["log_readable"]) for t in group))] if logs else []
        rows.append((*cells, *readable, f"{sum(t['restarted'] for t in group)}"))
    return Table(head, rows, names)


def driver_speed() -> Table:
    """What drivers cost against emulated devices."""
    head = ("device", "steps/s", "processor time of a step [µs]", "`command` [µs]", "`read` [µs]")
    rows = []
    for r in read("driver-speed").rows:
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
    results = [row for row in read("identification").rows if row["log"] == "known truth"]
    rows = []
    for method in dict.fromkeys(row["method"] for row in results):
        group = [row for row in results if row["method"] == method]
        keys = ("median_error", "held_out_rms", "seconds")
        median = {key: float(np.median([row[key] for row in group])) for key in keys}
        largest = max(row["largest_error"] for row in group)
        delay = 1e3 * max(abs(row["delay_error"]) for row in group)
        errors = (percent(median["median_error"]), percent(largest), f"{delay:.2f}")
        fit = (f"{median['held_out_rms']:.4f}", f"{median['seconds']:.0f}")
        rows.append((method, str(len(group)), *errors, *fit))
    return Table(head, rows, ["identification"])


def fault_series() -> Table:
    """What became of deployments with faults drawn over all phases, by cell and fault."""
    names = ["fault-series-allegro", "fault-series-inspire"]
    trials = [row for name in names for row in read(name).rows]
    head = (
        "cell",
        "fault",
        "trials",
        "phases",
        "arm at rest within the limit",
        "way to rest, largest, limit [mm]",
    )
    head += ("still held, of those that held and that hardware lets hold", "reason right, or carried on")
    rows = []
    for cell, fault in dict.fromkeys(sorted((t["cell"], t["fault"]) for t in trials)):
        group = [t for t in trials if (t["cell"], t["fault"]) == (cell, fault)]
        rest = sum(t["at_rest"] and t["distance_m"] <= t["limit_m"] for t in group)
        stopped = [t for t in group if not t["carried"]]
        way = NONE
        if stopped:
            farthest = max(t["distance_m"] for t in stopped)
            way = f"{1e3 * farthest:.0f}, {1e3 * max(t['limit_m'] for t in stopped):.0f}"
        holding = [t for t in group if t["held_before"] and not t["lets_go"]]
        held = f"{sum(t['held_after'] for t in holding)} of {len(holding)}" if holding else NONE
        phases = str(len({t["moment"] for t in group}))
        told = f"{sum(t['named'] or t['carried'] for t in group)}"
        rows.append((cell, fault, str(len(group)), phases, str(rest), way, held, told))
    return Table(head, rows, names)


def identification_twins() -> Table:
    """Identified dynamics of twins' hands against their truth, by hand and method."""
    head = ("hand", "method", "twins", "median error, of the model", "stiffness", "damping", "friction")
    head += ("armature", "delay error [ms]", "held-out RMS [rad]", "time [s]")
    names = ["identification-twins", "identification-weights"]
    names = [name for name in names if (RESULTS / f"{name}.json").is_file()]
    results = [row for name in names for row in read(name).rows]
    for row in results:
        if row.get("weight"):
            row["hand"] += f", {row['weight']:g} kg on each fingertip"
    rows = []
    for hand, method in dict.fromkeys((row["hand"], row["method"]) for row in results):
        group = [row for row in results if (row["hand"], row["method"]) == (hand, method)]

        def median(key: str, group: Sequence[Mapping[str, Any]] = group) -> float:
            return float(np.median([abs(row[key]) for row in group]))

        error = f"{percent(median('median_error'))}, {percent(median('model_error'))}"
        kinds = ("stiffness", "damping", "friction", "armature")
        parts = [percent(median(f"errors.{name}")) for name in kinds]
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
    "wire-image-inspire": "UR5e, Inspire, `student`, from images",
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
    return Table(head, [(title, *_wire_cells(read(name).rows)) for name, title in known.items()], list(known))


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


TWINS = ("twin-allegro-node", "twin-allegro-again", "twin-inspire", "twin-inspire-again")
"""Results of ``python -m benchmarks.twins``."""


def twin_variants() -> Table:
    """The lift test on twins, by robot and way to deploy."""
    head = ("robot", "variant", "episodes", "not begun", "begun", "lifted and held", "of those begun (95 %)")
    head += ("tracking, RMS [rad]", "sag [degrees]")
    rows = []
    for name in TWINS:
        results = read(name)
        for variant in dict.fromkeys(row["variant"] for row in results.rows):
            group = [row for row in results.rows if row["variant"] == variant]
            begun = [row for row in group if row["tracking_rad"] >= 0]
            lifted = sum(row["success"] for row in begun)
            low, high = wilson_interval(lifted, len(begun))
            rate = f"{percent(lifted / len(begun))} ({100 * low:.0f} to {100 * high:.0f})"
            off = f"{np.median([row['tracking_rad'] for row in begun]):.3f}"
            sag = f"{np.rad2deg(np.median([row['sag_rad'] for row in begun])):.1f}"
            counts = (f"{n}" for n in (len(group), len(group) - len(begun), len(begun), lifted))
            # As some results call it.
            name = variant.replace("ours", "full")
            rows.append((results.header["robot"], name, *counts, rate, off, sag))
    return Table(head, rows, list(TWINS))
