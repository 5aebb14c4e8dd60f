"""The composite robot, its shape for LeRobot, and the twin behind it."""

from dataclasses import replace

import numpy as np
import pytest
from ideal_twin import IDEAL
from robot_cells import cell_and_hand, grasp_and_object
from twin_robots import twin_robot

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_multiply, relative
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.robots.cell import load_cell
from fungrasp.robots.device import DeviceStatus, RobotError, StopKind
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import cell_twin, draw_twin
from fungrasp.robots.twin.world import HoldSample, TwinWorld, held_as_shown
from fungrasp.task import Action
from fungrasp.task.outcome import HoldMiddle

pytest.importorskip("mink")


def test_actions_move_the_palm_and_say_what_was_sent() -> None:
    robot, world = twin_robot()
    with robot:
        world.advance(world.time + 0.2)
        state = robot.state()
        robot.place_setpoints(state.arm.positions, state.hand.positions)
        robot.begin(state)
        seen = robot.get_observation()
        assert len(seen) == 1
        np.testing.assert_allclose(relative(world.look().object_pose, seen.object_pose[0])[:3], 0, atol=1e-3)
        goal = seen.palm_pose.copy()
        goal[:, 1] += 0.05
        for tick in range(15):
            sent = robot.send_action(Action(goal, seen.joint_setpoints, np.array([False])), 0.2 + 0.1 * tick)
        assert not sent.lift[0]
        np.testing.assert_allclose(sent.palm_goal_world[0, :3], goal[0, :3], atol=1e-3)
        world.advance(world.time + 0.5)
        np.testing.assert_allclose(world.look().palm_pose[:3], goal[0, :3], atol=5e-3)
        with pytest.raises(RobotError, match="not finite"):
            robot.send_action(Action(goal * np.nan, seen.joint_setpoints, np.array([False])))


def test_an_arm_stays_near_its_setpoints_where_the_palm_turns() -> None:
    robot, world = twin_robot()
    sent, apart = [], []
    robot.watch = lambda state, command: (
        sent.append(command.arm),
        apart.append(np.abs(command.arm - state.arm.positions).max()),
    )
    with robot:
        world.advance(world.time + 0.2)
        state = robot.state()
        robot.place_setpoints(state.arm.positions, state.hand.positions)
        robot.begin(state)
        seen = robot.get_observation()
        goal, start = seen.palm_pose.copy(), robot.clock.now()
        half = np.array([np.cos(0.3), 0.0, 0.0, np.sin(0.3)])
        goal[:, 3:] = quaternion_multiply(half, goal[:, 3:])
        for tick in range(15):
            robot.send_action(Action(goal, seen.joint_setpoints, np.array([False])), start + 0.1 * tick)
    joints = np.array([state.arm.positions, *sent])
    np.testing.assert_allclose(robot.kinematics.palm_pose(joints[-1])[3:], goal[0, 3:], atol=5e-3)
    # A turn that begins at its full speed asks joints for 50 rad/s^2, and an arm that has 2.5 falls behind.
    assert np.abs(np.diff(joints, n=2, axis=0)).max() / 0.02**2 < 4.0
    assert max(apart) < 0.06


def test_a_stopped_device_takes_no_command_until_it_is_connected_again() -> None:
    robot, _ = twin_robot()
    with robot:
        arm = robot.state().arm.positions
        robot.stop(StopKind.HOLD)
        assert robot.state().arm.status is DeviceStatus.STOPPED
        with pytest.raises(RobotError, match="connect to it again"):
            robot.arm.command(arm)
        robot.arm.connect()
        robot.arm.command(arm)


def test_twins_differ_and_repeat() -> None:
    one, again, two = (draw_twin(seed, 16, 16) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.stiffness, again.stiffness)
    assert np.abs(one.stiffness - two.stiffness).min() > 1e-6


def test_the_twins_encoders_are_off_and_its_setpoints_late() -> None:
    robot, world = twin_robot(spread=None)
    truth = world.truth
    with robot:
        measured = robot.state().hand.positions
        steps = measured / truth.spread.encoder_step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
        target = measured + 0.2
        before = world.hand_state()[0]
        robot.hand_driver.command(target)
        world.advance(world.time + 0.9 * truth.hand_delay)
        np.testing.assert_allclose(world.hand_state()[0], before, atol=2.1 * truth.spread.encoder_step)
        world.advance(world.time + 0.5)
        assert np.abs(world.hand_state()[0] - before).max() > 0.1


def test_the_twins_physics_is_not_the_planners() -> None:
    from fungrasp.objects.convex_decomposition import DecompositionSettings
    from fungrasp.robots.twin.twin_model import TwinPhysics
    from fungrasp.simulation import SceneSettings

    twin, planner = TwinPhysics(), SceneSettings()
    assert twin.timestep != planner.timestep
    assert twin.impratio != planner.impratio
    assert twin.contact_time != 0.02
    assert twin.pieces != DecompositionSettings()


@pytest.mark.parametrize("direction", [0.0, np.pi / 4])
def test_a_twins_friction_is_the_same_in_every_direction(direction: float) -> None:
    book = load_objects(builtin_grasps().select(np.array([111])))["book"]
    cell, hand = cell_and_hand()
    world = TwinWorld(cell, hand, book, draw_twin(0, len(hand.joint_names), len(hand.actuators), IDEAL))
    # Flat on the table.
    world.settle(np.array([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]))
    model, slope = world.model, np.arctan(0.9 * world.truth.object_friction)
    down = np.array([np.sin(slope) * np.cos(direction), np.sin(slope) * np.sin(direction), -np.cos(slope)])
    before = world.look().object_pose
    model.opt.gravity = 9.81 * down
    world.advance(world.time + 1.0)
    assert np.linalg.norm(world.look().object_pose[:2] - before[:2]) < 2e-3


def test_a_hand_with_gains_of_its_own_sags_and_is_carried_by_what_is_told() -> None:
    """Weak position gains let the fingers sag; feed-forward torques carry them whatever the gains are."""
    cell, hand = cell_and_hand()
    options = {**cell.hand_device.options, "gain": [0.25, 0.25]}
    weak = replace(cell, hand_device=replace(cell.hand_device, options=options))
    truth = cell_twin(weak, hand, 0, IDEAL)
    assert truth.gain == pytest.approx(0.25)
    np.testing.assert_allclose(truth.stiffness, 0.25)
    # The palm sideways: the fingers' weight is on their joints.
    home = (*cell.arm.home[:3], -3.2, cell.arm.home[4], 0.5 * np.pi)
    everywhere = replace(weak.workspace, lower=(-2.0, -2.0, -2.0), upper=(2.0, 2.0, 2.0))
    weak = replace(weak, arm=replace(weak.arm, home=home), workspace=everywhere)
    off = []
    for compensate in (False, True):
        world = TwinWorld(weak, hand, grasp_and_object()[1], truth)
        world.settle(np.array([0.0, 0.45, 0.1, 1.0, 0.0, 0.0, 0.0]))
        devices = TwinArm(world, weak), TwinHand(world, weak, hand), TwinTracker(world)
        robot = Robot(weak, hand, *devices, TwinClock(world), compensate=compensate)
        with robot:
            goal = robot.state().hand.positions + 0.3
            for _ in range(100):
                robot.send(np.array(home), goal)
                world.advance(world.time + 0.02)
            off.append(np.abs(world.finger_positions() - goal).max())
    assert off[0] > 0.05
    assert off[1] < 0.02
    for wrong in ([0.5], [2.0, 1.0], "weak", [0.0, 1.0]):
        broken = replace(cell, hand_device=replace(cell.hand_device, options={"gain": wrong}))
        with pytest.raises(FungraspError, match="two positive factors"):
            cell_twin(broken, hand, 0)


def test_gains_of_their_own_leave_other_twins_as_they_were() -> None:
    cell, hand = cell_and_hand()
    drawn = draw_twin(3, len(hand.joint_names), len(hand.actuators))
    np.testing.assert_array_equal(cell_twin(cell, hand, 3).stiffness, drawn.stiffness)
    node = cell_twin(load_cell("ur5e-allegro-node"), hand, 3)
    np.testing.assert_allclose(node.stiffness, node.gain * drawn.stiffness)
    assert 0.25 <= node.gain <= 0.83


def test_a_twins_hold_is_as_shown_where_the_fingers_touch_there_for_most_of_it() -> None:
    grasp, obj = grasp_and_object()
    hand = cell_and_hand()[1]
    palm = relative(grasp.object_pose, grasp.wrist_pose)
    away = palm + np.array([0.3, 0, 0, 0, 0, 0, 0])

    def hold(palm: np.ndarray, touching: int, of: int) -> list[HoldSample]:
        none = np.zeros_like(grasp.link_contacts)
        hands = [grasp.link_contacts if i < touching else none for i in range(of)]
        made = [HoldMiddle(palm, grasp.joint_positions, touches) for touches in hands]
        return [HoldSample(0.02 * i, 0.12, True, True, one) for i, one in enumerate(made)]

    def held(samples: list[HoldSample]) -> bool:
        found = held_as_shown(samples, hand, obj, grasp)
        return found is not None and bool(found.holds[0])

    assert held(hold(palm, 6, 10))
    assert not held(hold(palm, 4, 10)) and not held(hold(away, 10, 10)) and not held([])
