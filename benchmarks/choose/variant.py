"""What is compared: a method of retargeting, a policy and their settings, of this checkout or of another."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.peers.comparison import PEERS, installed_peers
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.records import record_from_json
from fungrasp.evaluation import LiftTestSpec
from fungrasp.planning import MotionSettings
from fungrasp.retargeting import METHODS, RetargetSettings

SECTIONS: dict[str, type] = {"retarget": RetargetSettings, "motion": MotionSettings, "lift": LiftTestSpec}
"""Records whose fields an option may set, by the word before the first dot."""


@dataclass(frozen=True)
class Variant:
    """One of the two sides of a comparison."""

    text: str
    """As it was given: ``[CHECKOUT::]METHOD[,SECTION.FIELD=VALUE...]``."""
    method: str
    """Of ``fungrasp.retargeting.METHODS`` or ``PEERS``."""
    checkout: Path | None = None
    """Another checkout, whose ``src`` is imported; None for the one that runs."""
    retarget: RetargetSettings = field(default_factory=RetargetSettings)
    """Of retargeting."""
    motion: MotionSettings = field(default_factory=MotionSettings)
    """Of the planned motion."""
    lift: LiftTestSpec = field(default_factory=LiftTestSpec)
    """Policy, protocol and the rest of the lift test."""

    @classmethod
    def parse(cls, text: str) -> Variant:
        """Read a variant; the settings of another checkout are left to the process that measures there.

        Args:
            text: "contact", "mink,lift.adapt=false", "contact,retarget.gap_unit=0.002",
                "contact,lift.policy=plan", "/other/checkout::contact". Values are JSON, or words.

        Raises:
            FungraspError: no such method, field or value, or no such checkout.
        """
        place, separator, rest = text.rpartition("::")
        checkout = Path(place) if separator else None
        if checkout is not None:
            if not (checkout / "src" / "fungrasp").is_dir():
                raise FungraspError(f"{checkout} is no checkout: it has no folder src/fungrasp")
            return cls(text, rest.split(",")[0], checkout.resolve())
        method, *options = rest.split(",")
        if method not in (*METHODS, *PEERS):
            raise UnknownNameError("retargeting method", method, (*METHODS, *PEERS))
        if method in PEERS and method not in installed_peers():
            raise FungraspError(f"{method} is not installed: pip install 'fungrasp[bench]'")
        chosen: dict[str, dict[str, Any]] = {name: {} for name in SECTIONS}
        for option in options:
            name, equals, value = option.partition("=")
            section, *path = name.split(".")
            if section not in SECTIONS or not path or not equals:
                known = ", ".join(f"{name}.FIELD=VALUE" for name in SECTIONS)
                raise FungraspError(f"variant '{text}': '{option}' is no option; there are {known}")
            place_in = chosen[section]
            for step in path[:-1]:
                place_in = place_in.setdefault(step, {})
            place_in[path[-1]] = _value(value)
        records = {
            name: record_from_json(kind, chosen[name], f"variant '{text}': {name}")
            for name, kind in SECTIONS.items()
        }
        lift = records["lift"]
        assert isinstance(lift, LiftTestSpec)
        if len(lift.conditions) > 1:
            raise FungraspError(f"variant '{text}': a variant is measured under one condition")
        return cls(text, method, None, **records)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
