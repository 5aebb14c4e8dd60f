"""A URDF of a cell's robot: arm, mount and hand as the cell's file says them, so that RViz, tf and MoveIt see
the hand where fungrasp does. Needs no ROS.

    ros2 run fungrasp_ros2 cell_urdf lab.toml lab.urdf

Links and joints have the names of our models; ``world`` is the cell's world, ``tool0`` the flange,
``fungrasp_palm`` the frame of the palm. Shapes are those of collisions; meshes are written beside the file.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.arm import FLANGE_SITE, PALM_SITE, mount
from fungrasp.hands.export import model_urdf
from fungrasp.robots.cell import RobotCell, load_cell


def cell_urdf(cell: RobotCell, hand: Hand, meshes: Path) -> str:
    """URDF of the robot of a cell.

    Args:
        cell: the robot.
        hand: on its arm.
        meshes: folder, made where needed, that meshes are written to.

    Raises:
        FungraspError: see ``model_urdf``.
    """
    spec = mount(hand, cell.arm.model, cell.mount)
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    frames = {FLANGE_SITE: "tool0", PALM_SITE: "fungrasp_palm"}
    robot = model_urdf(cell.name, spec.compile(), meshes, frames=frames)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def main() -> None:
    """``cell_urdf CELL FILE``."""
    parser = argparse.ArgumentParser(description="Write a URDF of a cell's robot.")
    parser.add_argument("cell", help="a TOML file, or a cell that comes with fungrasp")
    parser.add_argument("file", type=Path, help="URDF to write; meshes go into a folder beside it")
    given, _ = parser.parse_known_args()
    try:
        cell = load_cell(given.cell)
        text = cell_urdf(cell, load_hand(cell.hand), given.file.with_name(f"{given.file.stem}_meshes"))
        given.file.write_text(text, encoding="utf-8")
    except (FungraspError, OSError) as error:
        sys.exit(f"cell_urdf: error: {error}")
