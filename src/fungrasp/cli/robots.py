"""``fungrasp robots``: list and check robot cells, emulate them, read logs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fungrasp.cli.deploy import ReplayLog


@dataclass(frozen=True)
class List:
    """List the robot cells that come with fungrasp."""

    def run(self) -> None:
        from fungrasp.cli.console import table
        from fungrasp.robots.cell import cell_files, load_cell

        rows = [("name", "hand", "arm", "arm driver", "hand driver", "tracker")]
        for name in cell_files():
            cell = load_cell(name)
            devices = cell.arm.driver, cell.hand_device.driver, cell.tracker.driver
            rows.append((name, cell.hand, cell.arm.model, *devices))
        print(table(rows, left=None))


@dataclass(frozen=True)
class Check:
    """Check a robot cell's file. Nothing is connected."""

    cell: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
    """A cell that comes with fungrasp, or a TOML file."""

    def run(self) -> None:
        import numpy as np

        from fungrasp.errors import FungraspError
        from fungrasp.hands import load_hand
        from fungrasp.robots.assembly import arm_driver, hand_driver, is_twin, pose_source
        from fungrasp.robots.cell import load_cell
        from fungrasp.robots.kinematics.arm_model import ArmKinematics, ClearanceModel
        from fungrasp.robots.kinematics.joint_path import FreePath

        cell = load_cell(self.cell)
        hand = load_hand(cell.hand)
        kinematics = ArmKinematics(cell, hand)
        home = np.array(cell.arm.home)
        if home.shape != kinematics.lower.shape:
            raise FungraspError(f"'arm.home' must have {len(kinematics.lower)} joints, not {len(home)}")
        if (home < kinematics.lower).any() or (home > kinematics.upper).any():
            raise FungraspError(f"'arm.home' is beyond the joint limits of the {cell.arm.model}")
        fingers = hand.independent(np.clip(np.zeros(len(hand.joint_names)), *hand.joint_limits.T))
        clearance = ClearanceModel(cell, hand)
        if not FreePath(kinematics, clearance, cell.workspace).clear(home, fingers, None):
            raise FungraspError(
                "at 'arm.home' the robot touches the table or itself, or the palm is outside the workspace"
            )
        palm = ", ".join(f"{x:.2f}" for x in kinematics.palm_pose(home)[:3])
        print(f"{cell.name}: {hand.title} on a {cell.arm.model}; palm at home: {palm} m")
        if is_twin(cell):
            print("a twin in the same process")
        else:
            for device in (arm_driver(cell), hand_driver(cell, hand), pose_source(cell)):
                print(f"device: {device.name}")
            if cell.tracker.calibration_residual < 0:
                raise FungraspError(
                    "no calibration: measure the camera's pose, then give 'tracker.pose_world_camera' and "
                    "'tracker.calibration_residual'"
                )
        limits = cell.limits
        print(f"palm: up to {limits.palm_speed:g} m/s, {limits.palm_acceleration:g} m/s^2")


@dataclass(frozen=True)
class ShowLog:
    """Say what a log of `fungrasp deploy` holds, one that breaks off included; write a page of it."""

    log: Annotated[Path, tyro.conf.Positional]
    """An MCAP file."""
    page: Path | None = None
    """HTML file to write."""

    def run(self) -> None:
        from fungrasp.deployment.log import read_log

        log = read_log(self.log)
        print("complete" if log.complete else "breaks off: its writer was killed, or the disk was full")
        for name, value in log.about.items():
            print(f"{name}: {value}")
        for event in log.messages["/event"]:
            print(f"{event['time']:.2f} s  {event['what']}: {event['text']}")
        steps, setpoints = len(log.messages["/step"]), len(log.messages["/setpoint"])
        print(f"{steps} control steps, {setpoints} setpoints")
        if self.page is not None:
            from fungrasp.report.deployment_page import write_deployment_page

            print(f"page: {write_deployment_page(self.page, log)}")


COMMAND = {"list": List, "check": Check, "log": ShowLog, "replay": ReplayLog}
