"""The six-direction test."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import six_direction_test
from fungrasp.evaluation.results import static_json
from fungrasp.evaluation.six_directions import StaticProtocol


def test_closed_hands_keep_what_open_ones_lose(good, things, allegro):
    seen = []
    held = six_direction_test(good, things, allegro, progress=seen.append)
    assert held.passed.sum() >= 2 and seen == [4]
    kept = held.passed
    assert (held.displacement_m[kept] < 0.05).all() and (held.angle_rad[kept] < np.deg2rad(15)).all()
    contacts = np.zeros_like(good.link_contacts)
    opened = dataclasses.replace(good, joint_positions=0.0 * good.joint_positions, link_contacts=contacts)
    lost = six_direction_test(opened, things, allegro)
    assert not lost.passed.any()


def test_a_push_moves_a_free_object_by_half_a_t_squared(good, things, allegro):
    """F = 10 m for 2 s: 20 m along the push, if nothing is in the way. The palm is far above."""
    away = good.wrist_pose.copy()
    away[:, 2] += 0.7
    far = dataclasses.replace(good, wrist_pose=away)
    free = six_direction_test(far.select([0]), things, allegro)
    np.testing.assert_allclose(free.displacement_m[0, [0, 1, 2, 3, 5]], 20.0, rtol=0.02)
    assert not free.passed[0]


def test_harder_pushes_are_held_less(good, things, allegro):
    hard = StaticProtocol(force_per_mass=1000.0)
    assert not six_direction_test(good.select([0]), things, allegro, protocol=hard).passed.any()


def test_threads_and_chunks_do_not_matter(good, things, allegro):
    some = good.select([0, 2])
    one = six_direction_test(some, things, allegro, threads=1)
    other = six_direction_test(some, things, allegro, threads=2, chunk=1)
    np.testing.assert_array_equal(one.displacement_m, other.displacement_m)


def test_own_squeeze_targets_are_used(good, things, allegro):
    """Targets that open the hand lose the object, those that close it hold it; others squeeze as planned."""
    some = good.select([0, 1, 2, 3])
    planned = six_direction_test(some, things, allegro)
    own = np.full_like(some.joint_positions, np.nan)
    own[1] = 0.0
    own[2] = some.joint_positions[2] + 0.3
    mixed = dataclasses.replace(some, extra={**some.extra, "squeeze_positions": own})
    result = six_direction_test(mixed, things, allegro)
    np.testing.assert_allclose(result.displacement_m[[0, 3]], planned.displacement_m[[0, 3]], atol=1e-9)
    assert not result.passed[1]
    assert result.displacement_m[2].max() != planned.displacement_m[2].max()
    assert np.isnan(some.squeeze_positions).all()
    with pytest.raises(FungraspError, match="extra/squeeze_positions"):
        dataclasses.replace(some, extra={"squeeze_positions": own[:, :3]})


def test_json(good, things, allegro):
    numbers = static_json(six_direction_test(good.select([0]), things, allegro))
    assert set(numbers) >= {"pass_rate", "pass_interval", "passed", "displacement_m", "angle_rad"}
    assert len(numbers["displacement_m"][0]) == 6
