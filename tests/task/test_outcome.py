"""What counts as success, and what is measured during the hold."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from task_scenes import hand, plain, ready, run, stay

from fungrasp.simulation import MujocoCpuEngine
from fungrasp.task import LiftTask

STICK = plain("stick", (0.4, 0.05, 0.05))
CUBE = plain("cube", (0.06, 0.06, 0.06))


def held_at(task: LiftTask, pose: np.ndarray) -> Callable[[], None]:
    """Holds the objects at these poses from the lift on, as no hand could."""

    def hold() -> None:
        up = np.flatnonzero(np.isfinite(task.lift_time))
        if len(up):
            velocity = task.setpoints.wrist.velocity[up]
            task.engine.set_state(up, object_pose=pose[up], palm_velocity=velocity)

    return hold


@pytest.fixture
def touching(monkeypatch) -> None:
    """All links touch the object: what is held in these tests is held by ``held_at``."""
    shape = property(lambda self: np.ones((len(self), len(self.scene.hand.links)), dtype=bool))
    monkeypatch.setattr(MujocoCpuEngine, "link_contacts", shape)


@pytest.mark.parametrize(
    ("rise", "success", "reason"),
    [
        (0.15, True, ""),
        (0.104, True, ""),
        (0.096, False, "held too low"),
        (0.0, False, "held too low"),
    ],
)
def test_success_takes_10_cm(rise, success, reason, touching):
    task = ready([CUBE])
    pose = task.settled_pose.copy()
    pose[:, :3] += [0.3, 0.0, rise]
    run(task, lift_from=0.0, after=held_at(task, pose))
    outcomes = task.outcomes()
    assert outcomes.success[0] == success and outcomes.reason[0] == reason
    assert outcomes.lifted_height_m[0] == pytest.approx(rise, abs=3e-3)


def test_an_episode_that_is_counted_as_failed_is_not_held_as_shown_either(touching):
    task = ready([CUBE, CUBE])
    pose = task.settled_pose.copy()
    pose[:, :3] += [0.3, 0.0, 0.15]
    run(task, lift_from=0.0, after=held_at(task, pose))
    outcomes = task.outcomes()
    assert outcomes.success.all()
    outcomes.held_as_shown[:], outcomes.not_as_shown[:] = [True, False], ["", "the thumb does not touch"]
    outcomes.fail(np.array([True, False]), "held too low")
    assert outcomes.success.tolist() == [False, True] and outcomes.reason.tolist() == ["held too low", ""]
    assert not outcomes.held_as_shown.any()


def test_a_thrown_object_is_not_held():
    task = ready([CUBE])
    pose = task.settled_pose.copy()
    pose[:, :3] += [0.3, 0.0, 0.15]
    run(task, lift_from=0.0, after=held_at(task, pose))
    outcomes = task.outcomes()
    assert not outcomes.success[0] and outcomes.reason[0] == "lost before the hold"
    assert outcomes.lifted_height_m[0] > 0.1 and outcomes.contact_ratio[0] == 0.0


def test_an_object_that_touches_the_table_has_not_been_lifted(touching):
    """A stick stood on its end: its center rises by 17.5 cm, but it stands on the table."""
    task = ready([STICK])
    upright = np.array([[0.3, 0.0, 0.2, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]])
    run(task, lift_from=0.0, after=held_at(task, upright))
    outcomes = task.outcomes()
    assert outcomes.lifted_height_m[0] == pytest.approx(0.175, abs=2e-3)
    assert not outcomes.success[0] and not outcomes.legacy_success[0]
    assert outcomes.reason[0] == "the object touched the table during the hold"


def test_a_world_that_diverges_has_lifted_nothing(monkeypatch, tmp_path, touching, capfd):
    monkeypatch.chdir(tmp_path)
    task = ready([CUBE, CUBE])
    task.step(stay(task))
    task.engine.set_state(np.array([0]), palm_velocity=np.full((1, 3), 1e12))
    raised = task.settled_pose.copy()
    raised[:, :3] += [0.3, 0.0, 0.15]
    run(task, lift_from=0.0, after=held_at(task, raised))
    outcomes = task.outcomes()
    np.testing.assert_array_equal(outcomes.success, [False, True])
    np.testing.assert_array_equal(outcomes.legacy_success, [False, True])
    np.testing.assert_array_equal(outcomes.reason, ["the simulation diverged", ""])
    # MuJoCo by itself prints a warning, and writes a log file where it is.
    assert capfd.readouterr() == ("", "") and not list(tmp_path.iterdir())


def test_displacement_per_second_of_the_hold():
    task = ready([CUBE, CUBE])
    pose = task.settled_pose.copy()
    pose[:, :3] += [0.3, 0.0, 0.2]
    speed = np.array([0.01, 0.03])
    hold = held_at(task, pose)

    def after() -> None:
        hold()
        pose[:, 0] += 0.02 * speed

    run(task, lift_from=0.0, after=after)
    outcomes = task.outcomes()
    np.testing.assert_allclose(outcomes.sim_distance_world_mm_s, 1e3 * speed, rtol=0.02)
    np.testing.assert_allclose(outcomes.sim_distance_hand_mm_s, 1e3 * speed, rtol=0.1, atol=0.5)


def test_a_displacement_before_the_lift_is_measured():
    task = ready([CUBE])
    task.step(stay(task))
    pose = task.engine.object_pose
    pose[:, 0] += 0.05
    task.engine.set_state(object_pose=pose)
    run(task, lift_from=1.0)
    assert task.outcomes().pushed_m[0] == pytest.approx(0.05, abs=2e-3)


def test_contacts_are_scored_against_the_targets(monkeypatch):
    """Three of four links that touch should, and three of twelve that should do."""
    task = ready([CUBE])
    links = len(hand().links)
    touching = np.zeros((1, links), dtype=bool)
    touching[0, :4] = True  # the palm, which should not, and three that should
    monkeypatch.setattr(type(task.engine), "link_contacts", property(lambda self: touching.copy()))
    run(task, lift_from=0.0)
    outcomes = task.outcomes()
    assert links == 13
    assert outcomes.contact_ratio[0] == pytest.approx(3 / 12)
    assert outcomes.contact_precision[0] == pytest.approx(3 / 4)
    assert outcomes.contact_f1[0] == pytest.approx(2 * 3 / (4 + 12))
    assert outcomes.reason[0] == "held too low"
