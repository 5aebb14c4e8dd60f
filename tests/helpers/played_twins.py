"""Deployments on twins that are not played."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.twins import twin_episode


def play_twins(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Objects of the deployments, of which every second misses; each object can be put in two places."""
    names: list[str] = []

    def deploy(cell, hand, thing, *arguments, **options):
        names.append(thing.name)
        result = SimpleNamespace(fault="", attempts=options["settings"].attempts)
        return SimpleNamespace(
            result=result, success=len(names) % 2 == 1, height=0.11, tracking=0.02, sag=0.03
        )

    def reach(cell, hand, thing, grasp, seed=0):
        yield from (np.array([x, 0, 0, 1, 0, 0, 0]) for x in (0.1, 0.2))

    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy)
    monkeypatch.setattr(twin_episode, "reachable_placements", reach)
    return names
