"""A robot as ``wired_robot`` makes it, with a twin in the place of its wires."""

from __future__ import annotations

from ideal_twin import IDEAL
from robot_cells import cell_and_hand, grasp_and_object, placed

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import TwinSpread, draw_twin
from fungrasp.robots.twin.world import TwinWorld


def twin_robot(cell: RobotCell | None = None, spread: TwinSpread | None = IDEAL) -> tuple[Robot, TwinWorld]:
    """A robot and its twin, whose object has settled where a grasp can be reached."""
    cell, hand = cell or cell_and_hand()[0], cell_and_hand()[1]
    truth = draw_twin(0, len(hand.joint_names), len(hand.actuators), spread)
    world = TwinWorld(cell, hand, grasp_and_object()[1], truth)
    world.settle(placed())
    devices = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
    return Robot(cell, hand, *devices, TwinClock(world)), world
