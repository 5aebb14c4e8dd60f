"""Which grasps are tried on which twins; the deployments themselves are tested in tests/deployment."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import benchmarks.twins.twin_episode as twin_episode
from benchmarks.twins.twin_episode import PlacedGrasp, TwinEpisode, TwinSetup
from benchmarks.twins.twin_series import VARIANTS as NAMED
from benchmarks.twins.twin_series import KnownGrasps, placed_grasps, try_on_twins
from fungrasp.deployment.preparation import UnreachableError
from fungrasp.deployment.spec import Phase
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import load_hand
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import retarget
from fungrasp.robots.cell import load_cell
from fungrasp.robots.twin.devices import TwinHand
from fungrasp.sim2real.joint_dynamics import HandDynamics

HAND = load_hand("allegro")
AT = np.array([[0, 0, 0, 1.0, 0, 0, 0]])
NOWHERE = np.zeros((0, 7))
VARIANTS = list(NAMED.values())


def given(truth) -> HandDynamics:
    """What identification says of a twin."""
    ones = np.ones(len(HAND.joint_names))
    return HandDynamics(ones, truth.gain * ones)


@pytest.fixture(scope="module")
def grasps() -> tuple[RobotGraspSet, dict[str, Any]]:
    human = builtin_grasps()
    rows = [np.flatnonzero(human.object_name == name)[:2] for name in ("mug", "can")]
    human = human.select(np.concatenate(rows))
    objects = load_objects(human)
    return retarget(human, objects, HAND), dict(objects)


def setup_of(objects: dict[str, Any]) -> TwinSetup:
    planner: Any = SimpleNamespace()
    cell = load_cell("ur5e-allegro-node")
    return TwinSetup(objects, HAND, cell, OpenLoopPolicy(), planner)


@pytest.fixture
def deployed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Deployments are not played, but listed here."""
    seen: list[tuple[Any, ...]] = []

    def deploy(task, placement, truth, **options):
        seen.append((task.obj.name, truth.gain, task.dynamics, task.spec.gravity_compensation))
        if len(seen) == 2:
            raise UnreachableError("the grasp is not reachable: the arm would touch the table")
        held = {"success": True, "held_as_shown": True, "height": 0.12}
        return SimpleNamespace(fault="", attempts=1, **held)

    monkeypatch.setattr(twin_episode, "deploy_on_twin", deploy)
    return seen


def test_every_object_comes_before_any_comes_twice(grasps, monkeypatch) -> None:
    robot, objects = grasps
    tried = []

    def reach(cell, hand, obj, grasp, seed=0):
        tried.append(obj.name)
        if len(tried) == 1:
            raise UnreachableError("too far")
        yield np.array([0.1 * len(tried), 0, 0, 1, 0, 0, 0])

    monkeypatch.setattr(twin_episode, "reachable_placements", reach)
    setup = setup_of(objects)
    placed = list(placed_grasps(setup, KnownGrasps(robot, [10, 11, 20, 21])))
    assert [one.number for one in placed] == [10, 11, 20, 21]
    assert [len(one.placements) for one in placed] == [0, 1, 1, 1]
    placed = list(placed_grasps(setup, KnownGrasps(robot, [10, 11, 20, 21]), 1))
    assert [one.number for one in placed] == [10, 20]
    # The second grasp of the mug is asked for, and looked for, after the first of the can.
    tried.clear()
    stream = placed_grasps(setup, KnownGrasps(robot, [10, 11, 20, 21]))
    assert [next(stream).number for _ in range(3)] == [10, 11, 20]
    assert tried == ["mug", "mug", "can"]


def test_variants_differ_in_what_is_known(grasps, deployed) -> None:
    robot, objects = grasps
    placed = [PlacedGrasp(5, robot.select(np.array([0])), AT)]
    setup = setup_of(objects)
    found = list(try_on_twins(setup, placed, [4], VARIANTS[:3], given))
    assert [episode.variant for episode in found] == [variant.name for variant in VARIANTS[:3]]
    assert [dynamics is None for _, _, dynamics, _ in deployed] == [False, True, False]
    assert [compensate for *_, compensate in deployed] == [True, True, False]
    # What was not begun has failed, and says why.
    assert not found[1].success and "not reachable" in found[1].fault and found[1].tracking_rad == -1
    assert found[0] == TwinEpisode(5, found[0].object, 4, "full", True, 0.12, "", -1.0, -1.0, 1, 1, True)
    assert deployed[0][2].servo_stiffness[0] == deployed[0][1]


def test_errors_of_fingers_count_until_they_close() -> None:
    errors, hand = twin_episode.FingerErrors(), object.__new__(TwinHand)
    plan = SimpleNamespace(closing_step=np.array([10]), control_period=0.1)
    result: Any = SimpleNamespace(prepared=SimpleNamespace(plan=plan), times={Phase.GRASP: 10.0})
    world: Any = SimpleNamespace(finger_positions=lambda: world.fingers)
    hand.world = world
    errors.connected(SimpleNamespace(hand_driver=hand))  # pyright: ignore[reportArgumentType]
    assert np.isnan(errors.before_closing(result)).all()
    for time, error in ((10.0, 0.02), (10.9, -0.04), (11.0, 1.0)):
        world.time, world.fingers = time, np.array([error, error])
        sent: Any = SimpleNamespace(hand=np.zeros(2))
        errors.setpoint(Phase.GRASP, sent, sent)
    tracking, sag = errors.before_closing(result)
    assert tracking == pytest.approx(np.sqrt((0.02**2 + 0.04**2) / 2))
    assert sag == pytest.approx(0.01)


def test_a_stopped_run_is_balanced_over_twins(grasps, deployed) -> None:
    robot, objects = grasps
    placed = [PlacedGrasp(n, robot.select(np.array([n])), AT if n else NOWHERE) for n in range(4)]
    found = try_on_twins(setup_of(objects), placed, [4, 5], VARIANTS[1:2], given)
    order = [(episode.index, episode.twin) for episode in found]
    # The one out of reach is passed over; every grasp comes before any comes on its second twin.
    assert order == [(1, 4), (2, 5), (3, 4), (1, 5), (2, 4), (3, 5)]
    in_turn = try_on_twins(setup_of(objects), placed, [4, 5], VARIANTS[1:2], given, in_turn=True)
    assert [(episode.index, episode.twin) for episode in in_turn] == order[:3]
