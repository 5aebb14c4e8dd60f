"""Motions of the use test: the data, and how they move."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import builtin_grasps
from fungrasp.task.use import load_use_motions, motion_of


def test_the_motions_that_come_along_are_those_of_the_protocol():
    motions = load_use_motions()
    tilt, hammer = motions["pour"], motions["hammer"]
    assert tilt.duration == 4.0
    assert max(tilt.displacement(t)[0] for t in np.linspace(0, 4, 401)) == pytest.approx(np.deg2rad(100))
    speeds = [hammer.displacement(t)[1] for t in np.linspace(0, hammer.duration, 2001)]
    assert max(speeds) == pytest.approx(2.0, rel=0.01), "it strikes at 2 rad/s"
    assert motions["stroke"].displacement(1.0)[0] == pytest.approx(0.1)
    assert motions["stroke"].press is not None and motions["stroke"].press.force == 3.0
    assert (motions["screw"].torque, motions["hand_over"].pull) == (0.1, 10.0)
    assert motions["pull_trigger"].trigger is not None and motions["pull_trigger"].trigger.force == 5.0


def test_rates_are_derivatives():
    for motion in load_use_motions().values():
        for time in np.linspace(0.03, motion.duration - 0.03, 57):
            before, after = motion.displacement(time - 1e-6)[0], motion.displacement(time + 1e-6)[0]
            assert (after - before) / 2e-6 == pytest.approx(motion.displacement(time)[1], abs=1e-4)


def test_motions_end_where_they_began():
    for motion in load_use_motions().values():
        assert motion.displacement(motion.duration + 1.0) == (0.0, 0.0)


def test_half_of_the_built_in_grasps_have_a_motion():
    motions = load_use_motions().values()
    tasks = builtin_grasps().task.tolist()
    assert sum(motion_of(task, motions) is not None for task in tasks) > len(tasks) / 2
    assert motion_of("read", motions) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[a]\nturn = 'tilt'\n", "needs segments"),
        ("[a]\nturn = 'roll'\nsegments = [[1, 1, 0.1]]\n", "unknown turn 'roll'"),
        ("[a]\nturn = 'tilt'\nsegments = [[1, 1, 0.6]]\n", "2 ramp <= duration"),
        ("[a]\ntasks = ['x']\nduration = 1\n[b]\ntasks = ['x']\nduration = 1\n", "two motions"),
        ("[a]\nduration = 1\nforce = 3\n", "unknown field 'force'"),
        ("[a]\nduration = 1\npull = '3'\n", "must be a number"),
        ("[a]\nduration = 1\npress = {force = 3}\n", "needs exactly"),
        ("[a]\nduration = 1\ntrigger = {finger = 'toe', part = '', force = 5}\n", "unknown finger 'toe'"),
        ("[a]\nduration = 1e9\n", "up to 60 s"),
        ("a = 1\n", "must be a table"),
    ],
)
def test_damaged_data_is_refused_in_words(tmp_path, text, words):
    file = tmp_path / "motions.toml"
    file.write_text(text)
    with pytest.raises(FungraspError, match=words):
        load_use_motions(file)
