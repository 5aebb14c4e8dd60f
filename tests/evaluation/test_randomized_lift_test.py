"""What differences between world and belief do to the lift test."""

from __future__ import annotations

import pytest
from small_parts import evaluate_in_parts

from fungrasp.evaluation import LiftTestSpec, evaluate, replay, result_json
from fungrasp.sim2real import REALITY, THREE_PUSHES, MeasurementError, Randomization
from fungrasp.task import DIVERGED, LiftProtocol


def test_a_push_moves_what_is_held(good, things, allegro):
    """A little in the hand when it is as strong as the weight; out of the hand when it is 50 times that."""
    some = good.select([0, 1])
    still, pushed, hit = (
        evaluate(
            some,
            things,
            spec=LiftTestSpec(
                randomization=Randomization(push_times=THREE_PUSHES, push_weights=(weights, weights))
            ),
        ).outcomes
        for weights in (0.0, 1.0, 50.0)
    )
    assert still.success.all() and pushed.success.all()
    # An object that is hit from below is high above the table for the rest of the hold, far from the hand.
    assert not (hit.success & (hit.sim_distance_hand_mm_s < 1000)).any()
    assert (pushed.sim_distance_hand_mm_s > 1.2 * still.sim_distance_hand_mm_s).all()
    assert (pushed.pushed_m == still.pushed_m).all()
    lost = {"dropped during the hold", "the object touched the table during the hold", DIVERGED}
    assert set(hit.reason) <= {"", *lost}


def test_a_policy_that_does_not_look_misses_an_object_that_was_moved(good, things, allegro):
    """It goes where the object was when it was planned for; one that looks sees it where it is."""
    some, moved = good.select([0, 2]), Randomization(object_shift=(0.1, 0.1))
    assert not evaluate(some, things, spec=LiftTestSpec(randomization=moved)).outcomes.success.any()


def test_late_actions_and_a_table_that_is_elsewhere_still_lift(good, things):
    """The table is found by the object on it."""
    other = Randomization(action_delay=(0.1, 0.1), table_height=(-0.02, -0.02))
    assert evaluate(
        good.select([0, 2]), things, spec=LiftTestSpec(randomization=other)
    ).outcomes.success.all()


def test_errors_of_the_joints_that_are_not_looked_at_change_nothing(good, things, allegro):
    """The open loop reads the clock alone."""
    noisy = Randomization(joint_error=MeasurementError(0.3, 0.1), tracker_dropout=0.5)
    some, short = good.select([0, 2]), LiftProtocol(hold_time=0.3)
    asked = (LiftTestSpec(randomization=r, lift=short) for r in (noisy, Randomization()))
    same = [evaluate(some, things, spec=each).outcomes for each in asked]
    for name, value in same[0].arrays().items():
        assert (value == same[1].arrays()[name]).all(), name


def test_an_episode_of_the_reality_protocol_does_not_depend_on_the_others(good, things, allegro, tmp_path):
    some = good.select([0, 2])
    together = evaluate(some, things, spec=LiftTestSpec(randomization=REALITY), record=tmp_path)
    apart = evaluate_in_parts(1, some, things, spec=LiftTestSpec(randomization=REALITY), threads=1)
    assert together.outcomes.success.tolist() == apart.outcomes.success.tolist()
    # To rounding, which differs between one pose and several, and grows in contact.
    height = together.outcomes.lifted_height_m
    assert height.tolist() == pytest.approx(apart.outcomes.lifted_height_m.tolist(), abs=1e-4)
    assert result_json(together)["protocol"] == "reality"
    recorded = replay(next(tmp_path.iterdir()))
    assert {"mass", "table_tilt", "wrist_lag", "shift_probability"} <= set(recorded.differs.split())
