"""Which grasps are tried on which twins; the deployments themselves are tested in tests/deployment."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fungrasp.evaluation.twin_test as twin_test
from fungrasp.deployment.preparation import UnreachableError
from fungrasp.evaluation.twin_test import VARIANTS, placed_grasps, told_dynamics, try_on_twins
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retarget import retarget
from fungrasp.robots.cell import load_cell

CELL = load_cell("ur5e-allegro-node")


@pytest.fixture(scope="module")
def grasps() -> tuple[RobotGraspSet, dict[str, Any]]:
    human = builtin_grasps()
    rows = [np.flatnonzero(human.object_name == name)[:2] for name in ("mug", "can")]
    human = human.select(np.concatenate(rows))
    objects = load_objects(human)
    return retarget(human, objects, load_hand("allegro")), dict(objects)


def test_every_object_comes_before_any_comes_twice(grasps, monkeypatch) -> None:
    robot, objects = grasps
    tried = []

    def reach(cell, hand, thing, grasp, seed=0):
        tried.append(thing.name)
        if len(tried) == 1:
            raise UnreachableError("too far")
        return np.array([0.1 * len(tried), 0, 0, 1, 0, 0, 0])

    monkeypatch.setattr(twin_test, "reachable_placement", reach)
    placed, beyond = placed_grasps(robot, [10, 11, 20, 21], objects, load_hand("allegro"), CELL)
    assert [one.number for one in placed] == [11, 20, 21]
    assert beyond == [10]
    tried.clear()
    placed, beyond = placed_grasps(robot, [10, 11, 20, 21], objects, load_hand("allegro"), CELL, 1)
    assert [one.number for one in placed] == [11, 20]
    assert len(tried) == 3


def test_variants_differ_in_what_is_told_and_twins_take_turns(grasps, monkeypatch) -> None:
    robot, objects = grasps
    seen = []

    def deploy(cell, hand, thing, grasp, placement, policy, planner, truth, **options):
        seen.append((thing.name, truth.gain, options["dynamics"], options["compensate"]))
        if len(seen) == 2:
            raise UnreachableError("the grasp is not reachable: the arm would touch the table")
        result = SimpleNamespace(fault="")
        return SimpleNamespace(result=result, success=True, height=0.12, tracking=0.02, sag=0.03)

    monkeypatch.setattr(twin_test, "reachable_placement", lambda *a, **k: np.array([0, 0, 0, 1.0, 0, 0, 0]))
    monkeypatch.setattr(twin_test, "deploy_on_twin", deploy)
    hand = load_hand("allegro")
    placed, _ = placed_grasps(robot, [0, 1, 2, 3], objects, hand, CELL)
    found = list(
        try_on_twins(
            placed[:2],
            objects,
            hand,
            CELL,
            OpenLoopPolicy(),
            SimpleNamespace(),  # type: ignore[arg-type]
            [4, 5],
            VARIANTS,
            in_turn=True,
            identify=told_dynamics(hand),
        )
    )
    assert [episode.twin for episode in found] == [4, 4, 4, 5, 5, 5]
    assert [episode.variant for episode in found[:3]] == [variant.name for variant in VARIANTS]
    assert [dynamics is None for _, _, dynamics, _ in seen[:3]] == [False, True, False]
    assert [compensate for *_, compensate in seen[:3]] == [True, True, False]
    assert len({gain for _, gain, *_ in seen}) == 2
    # What was not begun has failed, and says why.
    assert not found[1].success and "not reachable" in found[1].fault and found[1].tracking_rad == -1
    assert found[0].success and found[0].tracking_rad == 0.02
    # What is told is the truth: the stiffness of a hand with gains of its own.
    driven = [hand.joint_names.index(name) for name in hand.actuators]
    told = seen[0][2].servo_stiffness[driven]
    assert told.max() < 1.2 * seen[0][1]
