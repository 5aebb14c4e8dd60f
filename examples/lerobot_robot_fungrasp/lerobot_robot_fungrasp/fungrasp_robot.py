"""The robot and its settings, as LeRobot wants them."""

from dataclasses import dataclass

from lerobot.robots import Robot, RobotConfig

from fungrasp.hands import load_hand
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import load_cell
from lerobot_robot_fungrasp.lerobot_adapter import LeRobotRobot


@RobotConfig.register_subclass("fungrasp")
@dataclass(kw_only=True)
class FungraspRobotConfig(RobotConfig):
    """Settings of LeRobot."""

    cell: str = "ur5e-allegro-emulated"
    """A robot cell that comes with fungrasp, or a TOML file."""


class FungraspRobot(LeRobotRobot, Robot):
    """A robot of LeRobot."""

    config_class = FungraspRobotConfig
    name = "fungrasp"

    def __init__(self, config: FungraspRobotConfig):
        Robot.__init__(self, config)
        cell = load_cell(config.cell)
        LeRobotRobot.__init__(self, wired_robot(cell, load_hand(cell.hand)))
