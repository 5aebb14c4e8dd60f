"""Ranges are checked where they are built; what is drawn stays within them and repeats with the seed."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.sim2real import (
    MODERATE,
    NOMINAL,
    REALITY,
    ROBUSTNESS,
    WIDE,
    EpisodeSample,
    MeasurementError,
    Randomization,
    draw,
    draw_each,
)

COUNT, JOINTS = 4000, 3
FACTORS = ("joint_damping", "servo_stiffness", "servo_damping", "wrist_stiffness", "mass")


def drawn(randomization: Randomization, seed: int = 0, count: int = COUNT) -> EpisodeSample:
    return draw(randomization, count, JOINTS, np.random.default_rng(seed))


def assert_same(a: EpisodeSample, b: EpisodeSample) -> None:
    for f in fields(EpisodeSample):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


def assert_fills(values: np.ndarray, low: float, high: float) -> None:
    """Within the bounds, and near both of them somewhere."""
    margin = 0.02 * (high - low)
    assert low <= values.min() < low + margin
    assert high >= values.max() > high - margin


@pytest.mark.parametrize("r", [MODERATE, WIDE])
def test_what_is_drawn_fills_its_range(r):
    sample = drawn(r)
    assert len(sample) == COUNT
    for name in FACTORS:
        values, bounds = getattr(sample, name), getattr(r, name)
        assert_fills(values, *bounds)
        # Log-uniform: the middle is the geometric mean.
        assert np.median(values) == pytest.approx(np.sqrt(bounds[0] * bounds[1]), rel=0.05)
    for name in ("friction", "table_height", "tracker_delay", "action_delay", "push_force"):
        assert_fills(getattr(sample, name), *getattr(r, name))
    assert_fills(sample.push_start[:, 0], *r.push_times[0])
    np.testing.assert_allclose(np.linalg.norm(sample.push_direction, axis=-1), 1.0)
    assert (np.abs(sample.push_direction.mean(axis=0)) < 0.05).all()
    assert_fills(sample.object_shift[:, 2], -r.object_turn, r.object_turn)


def test_joints_are_drawn_one_by_one():
    sample = drawn(WIDE)
    for values in (sample.joint_damping, sample.servo_stiffness, sample.servo_damping, sample.joint_bias):
        assert values.shape == (COUNT, JOINTS)
        np.testing.assert_allclose(np.corrcoef(values.T), np.eye(JOINTS), atol=0.08)


def test_biases_have_their_standard_deviations():
    r = Randomization(
        joint_error=MeasurementError(0.02),
        palm_position_error=MeasurementError(0.003, 9.0),
        palm_rotation_error=MeasurementError(0.01),
        object_position_error=MeasurementError(0.004),
        object_rotation_error=MeasurementError(0.05),
    )
    sample = drawn(r)
    np.testing.assert_allclose(sample.joint_bias.std(axis=0), 0.02, rtol=0.06)
    np.testing.assert_allclose(sample.palm_bias.std(axis=0), [0.003] * 3 + [0.01] * 3, rtol=0.06)
    np.testing.assert_allclose(sample.object_bias.std(axis=0), [0.004] * 3 + [0.05] * 3, rtol=0.06)


def test_offsets_have_their_lengths_in_any_direction():
    r = Randomization(
        object_position_error=MeasurementError(offset=0.01),
        object_rotation_error=MeasurementError(offset=0.2),
    )
    bias = drawn(r).object_bias
    np.testing.assert_allclose(np.linalg.norm(bias[:, :3], axis=1), 0.01)
    np.testing.assert_allclose(np.linalg.norm(bias[:, 3:], axis=1), 0.2)
    assert (np.abs(bias.mean(axis=0)) < 0.05 * np.repeat([0.01, 0.2], 3)).all()
    assert np.abs(np.corrcoef(bias.T) - np.eye(6)).max() < 0.08, "the two have directions of their own"


def test_shifts_are_spread_evenly_over_the_disc_and_over_a_ring():
    distance = np.linalg.norm(drawn(Randomization(object_shift=(0.0, 0.02))).object_shift[:, :2], axis=1)
    assert 0.0196 < distance.max() <= 0.02
    assert (distance < 0.01).mean() == pytest.approx(1 / 4, abs=0.03)
    shift = drawn(Randomization(object_shift=(0.01, 0.02))).object_shift
    distance = np.linalg.norm(shift[:, :2], axis=1)
    assert_fills(distance, 0.01, 0.02)
    # Between radii 1 and 1.5 lie (1.5^2 - 1) / (2^2 - 1) of the ring's area.
    assert (distance < 0.015).mean() == pytest.approx(1.25 / 3, abs=0.03)
    assert (np.abs(shift[:, :2].mean(axis=0)) < 0.001).all()
    exact = np.linalg.norm(drawn(Randomization(object_shift=(0.02, 0.02))).object_shift[:, :2], axis=1)
    np.testing.assert_allclose(exact, 0.02)


def test_the_reality_protocol_draws_what_its_page_says():
    sample, degree = drawn(REALITY), np.deg2rad(1)
    ranges = {"servo_stiffness": (0.85, 1.15), "mass": (0.5, 2.0), "friction": (0.5, 1.1)}
    ranges |= {"joint_friction": (0.0, 0.04), "encoder_bias": (-0.01, 0.01), "wrist_lag": (0.02, 0.06)}
    ranges |= {"action_delay": (0.03, 0.1), "tracker_delay": (0.06, 0.12), "table_height": (-0.01, 0.01)}
    for name, (low, high) in ranges.items():
        assert_fills(getattr(sample, name), low, high)
    assert_fills(np.linalg.norm(sample.table_tilt, axis=1), 0.0, degree)
    assert_fills(sample.center_of_mass_shift, -0.15, 0.15)
    np.testing.assert_array_equal(sample.backlash, 0.01)
    np.testing.assert_allclose(np.linalg.norm(sample.wrist_offset[:, :3], axis=1), 0.003)
    np.testing.assert_allclose(np.linalg.norm(sample.wrist_offset[:, 3:], axis=1), degree)
    assert sample.tracker_freezes.mean() == pytest.approx(0.3, abs=0.03)
    sizes, counts = np.unique(sample.object_scale, return_counts=True)
    np.testing.assert_allclose(sizes, [0.99, 0.995, 1.0, 1.005, 1.01])
    assert counts.min() > 0.17 * COUNT
    moved = np.linalg.norm(sample.object_shift[:, :2], axis=1)
    assert (moved > 0).mean() == pytest.approx(0.3, abs=0.03), "the others stay where they are"
    assert_fills(moved[moved > 0], 0.01, 0.02)
    assert sample.push_weights.shape == (COUNT, 3) and (sample.push_weights == 0.5).all()


def test_a_pose_error_has_the_covariance_that_a_planner_is_told():
    """Uniform to 5 mm plus normal 3 mm on each axis; normal 3 degrees about a random axis."""
    bias = drawn(REALITY).object_bias
    np.testing.assert_allclose(np.cov(bias.T), REALITY.object_pose_covariance, atol=1.2e-4 * 0.9)
    position = np.diag(REALITY.object_pose_covariance)[:3]
    np.testing.assert_allclose(position, 0.005**2 / 3 + 0.003**2)
    np.testing.assert_allclose(bias[:, :3].var(axis=0), position, rtol=0.08)
    angle = np.linalg.norm(bias[:, 3:], axis=1)
    assert np.sqrt((angle**2).mean()) == pytest.approx(np.deg2rad(3), rel=0.05)
    # Half of the normal distribution lies within 0.674 standard deviations.
    assert np.median(angle) == pytest.approx(0.674 * np.deg2rad(3), rel=0.06)
    assert not NOMINAL.object_pose_covariance.any()


def test_what_an_episode_gets_depends_on_seed_and_number_alone():
    whole = draw_each(WIDE, 0, range(5), JOINTS)
    assert_same(draw_each(WIDE, 0, [9, 3, 1], JOINTS).select(slice(1, None)), whole.select(np.array([3, 1])))
    assert_same(draw_each(WIDE, 0, np.array([2]), JOINTS), whole.select(np.array([2])))
    other = draw_each(WIDE, 1, range(5), JOINTS)
    for name in ("mass", "object_bias", "object_shift", "push_direction", "friction"):
        values = getattr(whole, name)
        assert not np.isin(values, getattr(other, name)).any(), name
        assert len(np.unique(values)) == values.size, f"{name} is drawn anew for each episode"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": (0.0, 2.0)}, "mass must be positive"),
        ({"mass": (float("nan"), 1.0)}, r"^mass\[0\]: expected a finite number, not nan"),
        ({"mass": 2}, "mass: expected a list of 2, not 2"),
        ({"push_phase": "lifting"}, "push_phase: expected 'lift' or 'hold'"),
        ({"friction": (0.0, 1.0)}, "friction must be positive"),
        ({"servo_stiffness": (2.0, 1.0)}, "servo stiffness must rise from low to high"),
        ({"table_height": (-3.0, 0.0)}, "table height must be within 0.2 m"),
        ({"joint_error": {"jitter": float("nan")}}, "joint_error: jitter: expected a finite number"),
        ({"object_position_error": MeasurementError(-0.1)}, "object position error must not be negative"),
        ({"action_delay": (0.0, 0.11)}, "action delay must be 0 to 0.1 s"),
        ({"tracker_dropout": 1.5}, "tracker dropout is a probability"),
        ({"center_of_mass_shift": 0.6}, "center of mass shift must be within half of the extent"),
        ({"table_tilt": (0.0, 0.7)}, "table tilt must be at most"),
        ({"push_times": ((0.0, 1.0), (2.0, 1.5))}, "push times must rise"),
        ({"push_duration": 0.0}, "push duration must be positive"),
        ({"object_turn": -0.1}, "object turn must not be negative"),
    ],
)
def test_impossible_ranges_are_named(change, message):
    with pytest.raises(FungraspError, match=message):
        Randomization(**change)


RANDOM: list[dict] = [
    {"mass": (0.5, 2.0)},
    {"friction": (0.5, 0.9)},
    {"tracker_dropout": 0.1},
    {"joint_error": MeasurementError(jitter=0.1)},
    {"object_shift": (0.02, 0.02)},
    {"object_turn": 0.1},
    {"table_tilt": (0.01, 0.01)},
    {"wrist_position_offset": 0.003},
    {"encoder_bias": 0.01},
    {"center_of_mass_shift": 0.1},
    {"push_times": ((1.0, 1.0),), "push_weights": (1.0, 1.0)},
]
FIXED: list[dict] = [
    {},
    {"mass": (2.0, 2.0), "friction": (0.6, 0.6), "table_height": (0.02, 0.02), "action_delay": (0.05, 0.05)},
    {"push_times": ((0.0, 3.0), (1.0, 2.0))},
    {"push_force": (0.0, 1.0)},
    {"backlash": (0.01, 0.01), "object_scale": (1.01, 1.01)},
    {"shift_probability": 0.3},
]


def test_what_depends_on_the_seed_is_random_and_nothing_else():
    """Pushes without force push nothing, and a force without pushes does nothing."""
    for change in RANDOM:
        assert Randomization(**change).is_random, change
    for change in FIXED:
        assert not Randomization(**change).is_random, change


def test_each_preset_is_wider_than_the_one_before():
    for f in fields(Randomization):
        moderate, wide = getattr(MODERATE, f.name), getattr(WIDE, f.name)
        if isinstance(wide, MeasurementError):
            assert wide.bias >= moderate.bias and wide.jitter >= moderate.jitter, f.name
        elif isinstance(wide, tuple) and isinstance(wide[0], float):
            assert wide[0] <= moderate[0] <= moderate[1] <= wide[1], f.name
    assert not NOMINAL.is_random and MODERATE.is_random and WIDE.is_random


def test_the_robustness_protocol_changes_one_kind_of_thing_at_a_time_and_nothing_first():
    assert next(iter(ROBUSTNESS.values())) == NOMINAL
    assert len(ROBUSTNESS) == len(set(ROBUSTNESS.values())) == 11
    changed = [
        {f.name for f in fields(Randomization) if getattr(r, f.name) != getattr(NOMINAL, f.name)}
        for r in ROBUSTNESS.values()
    ]
    pairs = {"object_position_error": "object_rotation_error", "push_times": "push_weights"}
    for names in changed[1:]:
        assert len(names - set(pairs.values())) == 1, "one kind each"
        assert all((a in names) == (b in names) for a, b in pairs.items())
