"""Robot cells of fungrasp as the robot "fungrasp" of LeRobot, which finds this package by its name.

Install it with ``pip install ./examples/lerobot_robot_fungrasp``; then ``--robot.type=fungrasp
--robot.cell=my-cell.toml`` works in LeRobot's commands.
"""

from lerobot_robot_fungrasp.fungrasp_robot import FungraspRobot, FungraspRobotConfig

__all__ = ["FungraspRobot", "FungraspRobotConfig"]
