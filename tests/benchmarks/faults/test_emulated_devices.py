"""Emulated devices that drivers are measured against."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.reaction_times import reaction_trials
from fungrasp.robots.hands.joint_order import hand_joint_limits
from fungrasp_emulators.devices import STOPS, emulated_allegro, torque_controlled_fingers
from fungrasp_emulators.emulator import Fault, PlantCommand


def test_fingers_that_keep_their_torques_end_at_their_stops() -> None:
    lower, upper = hand_joint_limits("allegro", 16)
    fingers = torque_controlled_fingers(np.full(16, 0.4))
    for torque, end in ((0.3, upper + STOPS), (-0.3, lower - STOPS)):
        now = fingers._now or 0.0
        fingers.apply(PlantCommand(torques=np.full(16, torque)), now)
        for second in range(1, 6):
            fingers.state(now + second)
        np.testing.assert_allclose(fingers.state(now + 5).positions, end, atol=1e-3)
        np.testing.assert_allclose(fingers.state(now + 5).velocities, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("generation", [4, 5])
def test_a_hand_that_kept_its_torques_can_be_connected_again(generation: int) -> None:
    pytest.importorskip("can")
    device = emulated_allegro(generation, 6.0)
    trials = list(reaction_trials(device, Fault.STALLED, 2, np.random.default_rng(0)))
    assert [trial.fault for trial in trials] == [Fault.STALLED.value] * 2, trials
    assert all(trial.detected is not None and trial.restarted for trial in trials)
