"""Speeds are measured of the same motion."""

from __future__ import annotations

from small_training import environment, hand, library, training_set

from benchmarks.speed.training_speed import acting_speed, environment_speed, untrained_student


def test_a_step_of_training_is_the_same_with_the_engine_watched():
    """Also where objects are pushed and episodes begin anew."""
    one = training_set()
    settings = environment().settings
    done: list[int] = []
    speed = environment_speed(
        library(), one.objects, hand(), settings, steps=30, threads=1, progress=done.append
    )
    assert speed.identical and speed.worlds == settings.worlds
    assert speed.physics_steps == 10 and done == list(range(1, 31))
    assert 0 < speed.share <= 1.5


def test_acting_is_timed():
    one = training_set()
    student = untrained_student(library(), one.objects, hand())
    speed = acting_speed(student, one.grasps.select([0]), one.objects, hand())
    assert speed.control > 0 and 0 < speed.policy < 1000 and speed.total == speed.control + speed.policy
