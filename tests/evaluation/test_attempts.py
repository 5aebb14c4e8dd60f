"""Several attempts: a policy that watches tries again by another plan, where it is seen to have failed."""

from __future__ import annotations

import numpy as np
import pytest
from small_parts import evaluate_in_parts

from fungrasp.evaluation import LiftTestResult, LiftTestSpec, evaluate, result_json
from fungrasp.geometry.poses import compose
from fungrasp.policies.open_loop import plan_step
from fungrasp.sim2real import REALITY, MeasurementError, Randomization
from fungrasp.task import Action, GraspPlan, Observation

MOVED = Randomization(
    object_shift=(0.08, 0.08), object_position_error=MeasurementError(jitter=0.002), tracker_freeze=1.0
)
"""The object is moved after planning, farther than open hands forgive; a tracker with gaps sees it."""


class Player:
    """Plays plans without correcting them. It counts as one that watches."""

    plans = 0

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        self._plan = plan
        self.plans += 1

    def act(self, observation: Observation) -> Action:
        step = plan_step(self._plan, observation)
        goal, fingers = self._plan.at(step)
        return Action(compose(self._plan.object_pose, goal), fingers, step >= self._plan.lift_step)


def tried(good, things, allegro, attempts: int, **options) -> LiftTestResult:
    return evaluate(
        good.select([0, 2]),
        things,
        Player(),
        spec=LiftTestSpec(attempts=attempts, randomization=MOVED),
        **options,
    )


def test_what_the_first_attempt_misses_the_second_lifts(good, things, allegro):
    once, twice = (tried(good, things, allegro, attempts) for attempts in (1, 2))
    assert not once.outcomes.success.any() and once.attempts is None
    assert twice.outcomes.success.all()
    made = twice.attempts
    assert made is not None
    assert made.attempts.tolist() == [2, 2] and not made.first_success.any()
    assert not made.held_given_up.any() and not made.misses_unnoticed.any() and not made.no_plan.any()
    numbers = result_json(twice)
    assert numbers["attempts"]["most"] == 2
    assert numbers["attempts"]["first_success_rate"] == 0.0
    assert numbers["attempts"]["tried_again"] == 2
    assert [row["attempts"] for row in numbers["trials"]] == [2, 2]
    assert "attempts" not in result_json(once)


def test_what_is_held_is_kept(good, things, allegro):
    """Where nothing fails, everything is as with one attempt."""
    once, twice = (
        evaluate(good.select([0, 2]), things, Player(), spec=LiftTestSpec(attempts=attempts))
        for attempts in (1, 2)
    )
    assert once.outcomes.success.all()
    for name, value in once.outcomes.arrays().items():
        np.testing.assert_array_equal(value, twice.outcomes.arrays()[name], err_msg=name)
    assert twice.attempts is not None and twice.attempts.attempts.tolist() == [1, 1]


@pytest.mark.slow
def test_an_episode_of_several_attempts_does_not_depend_on_the_others(good, things, allegro):
    some = good.select([0, 2])
    spec = LiftTestSpec(attempts=3, randomization=REALITY, seeds=(1, 2))
    together, again, apart = (
        evaluate_in_parts(chunk, some, things, Player(), spec=spec, threads=threads)
        for chunk, threads in ((2, 2), (2, 1), (1, 1))
    )
    assert together.attempts is not None and apart.attempts is not None and again.attempts is not None
    for name, value in together.attempts.arrays().items():
        np.testing.assert_array_equal(value, again.attempts.arrays()[name], err_msg=name)
        np.testing.assert_array_equal(value, apart.attempts.arrays()[name], err_msg=name)
    for name, value in together.outcomes.arrays().items():
        np.testing.assert_array_equal(value, again.outcomes.arrays()[name], err_msg=name)
    # To rounding, which differs between one pose and several, and grows in contact.
    assert together.outcomes.success.tolist() == apart.outcomes.success.tolist()


def test_an_object_that_is_pushed_off_is_given_up(good, things, allegro):
    """Moved by half a meter, it lies where an arm would not reach."""
    far = Randomization(object_shift=(0.5, 0.5))
    result = evaluate(good.select([0, 2]), things, Player(), spec=LiftTestSpec(attempts=2, randomization=far))
    assert result.attempts is not None
    assert not result.outcomes.success.any()
    assert result.attempts.no_plan.all() and result.attempts.attempts.tolist() == [1, 1]
