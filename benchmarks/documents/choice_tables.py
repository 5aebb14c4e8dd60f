"""Tables of variants compared on the grasp set."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.documents.measured import HANDS, NONE, RESULTS, Table, percent, read

PEERS = {
    "mink": "mink",
    "dexi-rs": "dexi-rs",
    "dex-retargeting": "dex-retargeting",
    "`dexgraspnet`": "dexgraspnet",
    "`angle-copy`": "angle-copy",
}
"""Name in the result's file of each method beside ours."""

DECISIONS = {
    "firmness": "[0035](decisions/0035-firm-grasps.md): other starts, chosen by firmness",
    "likeness": "[0035](decisions/0035-firm-grasps.md): firmness counts in the choice among starts",
    "approach": "[0041](decisions/0041-clear-approaches.md): clear approaches",
    "waypoints": "[0041](decisions/0041-clear-approaches.md): five waypoints for three, alone",
    "closing": "[0041](decisions/0041-clear-approaches.md): the closing is looked at, alone",
    "squeeze": "[0047](decisions/0047-squeeze-for-loads.md): the squeeze is what the loads need",
    "table": "[0016](decisions/0016-table-under-settled-object.md): the table also under the settled object",
    "terms": "[0035](decisions/0035-firm-grasps.md): closure counts three times, inner links twice as much",
    "press": "the wrist presses down and in while the fingers close",
}
"""What is compared with its absence, by the name in the result's file."""

TESTS = {"unadapted": "not adapted", "adapted": "adapted"}
"""Ends of the files' names."""

DECISION_TESTS = {**TESTS, "faive": "not adapted, Faive P0"}
"""The same of ``DECISIONS``."""


def confirmed_peers() -> Table:
    """Other methods beside ours on the part "confirm"."""
    return _peers("confirm")


def _peers(prefix: str) -> Table:
    """Of results whose names begin so."""
    rows, files = [], []
    ours: dict[str, Any] = {}
    for name, file in PEERS.items():
        cells = []
        for test in TESTS:
            rate = _all(f"{prefix}-{file}-{test}")
            if rate is None:
                cells += [NONE, NONE]
                continue
            files.append(f"{prefix}-{file}-{test}")
            ours[test] = rate["second"]
            cells += [percent(rate["first"]), _difference(rate)]
        if cells != [NONE] * 4:
            rows.append((name, *cells))
    mean = [cell for test in TESTS for cell in (percent(ours.get(test)), "")]
    head = ("method", "not adapted", "ours less it [points]", "adapted", "ours less it [points]")
    return Table(head, [("ours (`contact`)", *mean), *rows], files)


def confirmed_strata() -> Table:
    """The same, not adapted, by kind of object."""
    files = {name: f"confirm-{file}-unadapted" for name, file in PEERS.items()}
    rates = {
        name: {rate["stratum"]: rate for rate in read(file).header["rates"]} for name, file in files.items()
    }
    first = next(iter(rates.values()))
    rows = [
        (
            stratum,
            f"{rate['grasps']} of {rate['objects']}",
            percent(rate["second"]),
            *(percent(rates[name][stratum]["first"]) for name in files),
        )
        for stratum, rate in first.items()
    ]
    return Table(("objects", "grasps", "ours", *files), rows, list(files.values()))


def confirmed_hands() -> Table:
    """Ours by each hand, not adapted and adapted, by kind of object."""
    found = {name: read(f"confirm-{name}").header["rates"] for name in HANDS}
    shares = {
        name: np.array([(rate["first"], rate["second"]) for rate in rates]) for name, rates in found.items()
    }
    first = found["allegro"]
    rows = [
        (
            rate["stratum"],
            f"{rate['grasps']} of {rate['objects']}",
            *(_both(shares[name][row]) for name in HANDS),
        )
        for row, rate in enumerate(first)
    ]
    # The last row is of all grasps, which are more of some kinds.
    rows.append(("mean of kinds", "", *(_both(shares[name][:-1].mean(axis=0)) for name in HANDS)))
    return Table(("objects", "grasps", *HANDS.values()), rows, [f"confirm-{name}" for name in HANDS])


def _both(shares: np.ndarray) -> str:
    """Two shares, not adapted and adapted, shape [2]."""
    return f"{100 * shares[0]:.1f}, {100 * shares[1]:.1f} %"


def chosen_decisions() -> Table:
    """Decisions of the past, each with and without."""
    rows, files = [], []
    for file, words in DECISIONS.items():
        for test, label in DECISION_TESTS.items():
            rate = _all(f"choose-{file}-{test}")
            if rate is None:
                continue
            files.append(f"choose-{file}-{test}")
            stands = "yes" if rate["interval"][0] > 0 else "no"
            both = f"{rate['only_second']}, {rate['only_first']}"
            shares = (percent(rate["first"]), percent(rate["second"]))
            rows.append((words, label, str(rate["grasps"]), *shares, _difference(rate), both, stands))
    head = ("decision", "test", "grasps", "without", "with", "gain [points]", "only with, without", "> 0")
    return Table(head, rows, files)


def chosen_firm() -> Table:
    """Grasps as firm as they can be near the person's beside those of before, by kind of object."""
    rows = []
    for rate in read("choose-firm-unadapted").header["rates"]:
        both = f"{rate['only_second']}, {rate['only_first']}"
        number = f"{rate['grasps']} of {rate['objects']}"
        shares = (percent(rate["first"]), percent(rate["second"]))
        rows.append((rate["stratum"], number, *shares, _difference(rate), both))
    head = ("objects", "grasps", "before", "after", "gain [points]", "only after, before")
    return Table(head, rows, ["choose-firm-unadapted"])


FIRM_ON = {
    "choose-firm-adapted": "Allegro, adapted",
    "choose-firm-faive": "Faive P0, not adapted",
    "choose-firm-inspire": "Inspire, not adapted",
    "choose-firm-shadow": "Shadow, not adapted",
    "confirm-firm": "Allegro, not adapted, on *confirm*",
}
"""Results of the same comparison on other tests, and what they are of."""


def chosen_firm_elsewhere() -> Table:
    """The same on other hands, with adaptation, and on grasps that had decided nothing."""
    rows = []
    for name, of in FIRM_ON.items():
        if (rate := _all(name)) is not None:
            both = f"{rate['only_second']}, {rate['only_first']}"
            shares = (percent(rate["first"]), percent(rate["second"]))
            rows.append((of, f"{rate['grasps']} of {rate['objects']}", *shares, _difference(rate), both))
    head = ("test", "grasps", "before", "after", "gain [points]", "only after, before")
    return Table(head, rows, [name for name in FIRM_ON if _all(name) is not None])


def _all(name: str) -> dict[str, Any] | None:
    """Rates of all objects of a result; None where it was not measured."""
    return read(name).header["rates"][-1] if (RESULTS / f"{name}.json").is_file() else None


def _difference(rate: dict[str, Any]) -> str:
    low, high = rate["interval"]
    return f"{100 * (rate['second'] - rate['first']):+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"
