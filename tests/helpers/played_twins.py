"""Deployments on twins that are not played."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.twins import twin_episode, twin_series
from fungrasp.sim2real.joint_dynamics import HandDynamics


def play_twins(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Objects of the deployments, of which every second misses."""
    names: list[str] = []

    def deploy(task, *arguments, **options):
        names.append(task.obj.name)
        measured = {"height": 0.11, "held_as_shown": False}
        return SimpleNamespace(fault="", attempts=task.spec.attempts, success=len(names) % 2 == 1, **measured)

    def reach(cell, hand, obj, grasp, seed=0):
        yield np.array([0.1, 0, 0, 1, 0, 0, 0])

    def identified(setup, aside):
        ones = np.ones(len(setup.hand.joint_names))
        return lambda truth: HandDynamics(ones, ones)

    monkeypatch.setattr(twin_series, "_identified", identified)
    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy)
    monkeypatch.setattr(twin_episode, "reachable_placements", reach)
    return names
