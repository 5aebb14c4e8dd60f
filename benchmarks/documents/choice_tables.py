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


TESTS = {"unadapted": "not adapted", "adapted": "adapted"}
"""Ends of the files' names."""


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


def _all(name: str) -> dict[str, Any] | None:
    """Rates of all objects of a result; None where it was not measured."""
    return read(name).header["rates"][-1] if (RESULTS / f"{name}.json").is_file() else None


def _difference(rate: dict[str, Any]) -> str:
    low, high = rate["interval"]
    return f"{100 * (rate['second'] - rate['first']):+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"
