"""Ranges are checked where they are built; what is drawn stays within them and repeats with the seed."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.transfer import NONE, Randomisation, Sample, Spread, sample

COUNT, JOINTS = 4000, 3


def draw(randomisation: Randomisation, seed: int = 0, count: int = COUNT) -> Sample:
    return sample(randomisation, count, JOINTS, np.random.default_rng(seed))


def assert_fills(values: np.ndarray, low: float, high: float) -> None:
    """Within the bounds, and near both of them somewhere."""
    margin = 0.02 * (high - low)
    assert low <= values.min() < low + margin
    assert high >= values.max() > high - margin


def test_what_is_drawn_fills_its_range():
    r = Randomisation()
    drawn = draw(r)
    assert len(drawn) == COUNT
    for name in ("damping", "stiffness", "servo_damping", "wrist_stiffness", "mass"):
        values, bounds = getattr(drawn, name), getattr(r, name)
        assert_fills(values, *bounds)
        # Log-uniform: the middle is the geometric mean.
        assert np.median(values) == pytest.approx(np.sqrt(bounds[0] * bounds[1]), rel=0.05)
    for name in ("friction", "table_height", "observation_delay", "action_delay", "push_start"):
        assert_fills(getattr(drawn, name), *getattr(r, name))
    assert_fills(np.linalg.norm(drawn.push, axis=1), *r.push_force)
    assert (np.abs(drawn.push.mean(axis=0)) < 0.05).all()
    assert_fills(drawn.object_shift[:, 2], -r.object_turn, r.object_turn)
    assert (drawn.push_duration == r.push_duration).all()


def test_joints_are_drawn_one_by_one():
    drawn = draw(Randomisation())
    for values in (drawn.damping, drawn.stiffness, drawn.servo_damping, drawn.joint_bias):
        assert values.shape == (COUNT, JOINTS)
        correlation = np.corrcoef(values.T)
        np.testing.assert_allclose(correlation, np.eye(JOINTS), atol=0.08)


def test_biases_have_their_standard_deviations():
    r = replace(NONE, joint_noise=Spread(0.02), wrist_position_noise=Spread(0.003, 9.0))
    r = replace(r, wrist_rotation_noise=Spread(0.01), object_position_noise=Spread(0.004))
    drawn = draw(replace(r, object_rotation_noise=Spread(0.05)))
    np.testing.assert_allclose(drawn.joint_bias.std(axis=0), 0.02, rtol=0.06)
    np.testing.assert_allclose(drawn.wrist_bias.std(axis=0), [0.003] * 3 + [0.01] * 3, rtol=0.06)
    np.testing.assert_allclose(drawn.object_bias.std(axis=0), [0.004] * 3 + [0.05] * 3, rtol=0.06)


def test_shifts_are_spread_evenly_over_the_disc():
    distance = np.linalg.norm(draw(Randomisation(object_shift=0.02)).object_shift[:, :2], axis=1)
    assert 0.0196 < distance.max() <= 0.02
    assert (distance < 0.01).mean() == pytest.approx(1 / 4, abs=0.03)


def test_the_same_seed_draws_the_same_sample():
    a, b, c = draw(Randomisation(), 5), draw(Randomisation(), 5), draw(Randomisation(), 6)
    for field in fields(Sample):
        np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
        if field.name != "push_duration":
            assert not np.array_equal(getattr(a, field.name), getattr(c, field.name))


def test_none_changes_nothing():
    drawn = draw(NONE, count=5)
    for name in ("damping", "stiffness", "servo_damping", "wrist_stiffness", "mass"):
        assert (getattr(drawn, name) == 1.0).all()
    assert drawn.friction is None
    for name in ("table_height", "joint_bias", "wrist_bias", "object_bias", "object_shift", "push"):
        assert (getattr(drawn, name) == 0.0).all()
    assert (drawn.observation_delay == 0.0).all()
    assert (drawn.action_delay == 0.0).all()


@pytest.mark.parametrize("randomisation", [Randomisation(), NONE])
def test_trials_can_be_selected_and_replaced(randomisation):
    first, second = draw(randomisation, 1, 5), draw(randomisation, 2, 2)
    mixed = first.replaced(np.array([3, 0]), second)
    for field in fields(Sample):
        before, new, after = (getattr(s, field.name) for s in (first, second, mixed))
        if before is None:
            assert after is None
            continue
        np.testing.assert_array_equal(after[[1, 2, 4]], before[[1, 2, 4]])
        np.testing.assert_array_equal(after[[3, 0]], new)
        np.testing.assert_array_equal(getattr(mixed.select(np.array([3])), field.name), new[:1])
    assert len(mixed.select(np.array([True, False, True, False, False]))) == 2


def test_samples_with_and_without_friction_do_not_mix():
    with pytest.raises(FungraspError, match="friction is randomised in one"):
        draw(NONE, count=2).replaced(np.array([0]), draw(Randomisation(), count=1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": (0.0, 2.0)}, "mass must be positive"),
        ({"damping": (-1.0, 2.0)}, "damping must be positive"),
        ({"friction": (0.0, 1.0)}, "friction must be positive"),
        ({"stiffness": (2.0, 1.0)}, "stiffness must rise from low to high"),
        ({"table_height": (0.0, float("inf"))}, "table_height must be finite"),
        ({"joint_noise": Spread(0.1, float("nan"))}, "joint_noise must be finite"),
        ({"object_position_noise": Spread(-0.1)}, "object_position_noise must not be negative"),
        ({"action_delay": (-0.1, 0.1)}, "action_delay must not be negative"),
        ({"push_duration": -1.0}, "push_duration must not be negative"),
        ({"object_shift": float("nan")}, "object_shift must be finite"),
    ],
)
def test_impossible_ranges_are_named(change, message):
    with pytest.raises(FungraspError, match=f"randomisation: {message}"):
        Randomisation(**change)
