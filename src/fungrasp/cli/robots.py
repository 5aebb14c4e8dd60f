"""``fungrasp robots``: list and check robot cells, emulate them, read logs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fungrasp.cli.console import Answering, CommandResult, suggestion, table
from fungrasp.cli.options import CellName
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.spec import GraspChoice

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class ListCells(Answering):
    """List the built-in robot cells and the installed drivers."""

    def run(self) -> CommandResult:
        from fungrasp.robots.assembly import ARM_DRIVERS, HAND_DRIVERS, TRACKERS
        from fungrasp.robots.cell import cell_files, load_cell

        rows = [("name", "hand", "arm", "arm driver", "hand driver", "tracker")]
        for name in cell_files():
            cell = load_cell(name)
            devices = cell.arm.driver, cell.hand_device.driver, cell.tracker.driver
            rows.append((name, cell.hand, cell.arm.model, *devices))
        drivers = [("driver", "of", "package")]
        for registry in (ARM_DRIVERS, HAND_DRIVERS, TRACKERS):
            drivers += [(name, registry.what, package) for name, package in registry.known().items()]
        named = {
            what: [dict(zip(heads, row, strict=True)) for row in others]
            for what, (heads, *others) in {"cells": rows, "drivers": drivers}.items()
        }
        return CommandResult(named, f"{table(rows, left=None)}\n\n{table(drivers, left=None)}")


@dataclass(frozen=True)
class New(Answering):
    """Write a cell template for a real robot, with low speeds. Fill in the measured values before use."""

    file: Annotated[Path, tyro.conf.Positional]
    """TOML file to write; must not exist."""
    hand: str = "allegro"
    """Hand on the arm."""

    def run(self) -> CommandResult:
        from fungrasp.robots.cell import write_new_cell

        write_new_cell(self.file, self.hand)
        text = f"{self.file}: fill in the empty values, then run 'fungrasp robots check {self.file}'"
        return CommandResult({"cell": self.file}, text)


@dataclass(frozen=True)
class Check(Answering):
    """Check the file of a robot cell, without connecting to devices."""

    cell: CellName
    """A built-in robot cell, or a TOML file."""
    touched: Path | None = None
    """JSON file of `robots touch`. Points touched by the center of the flange check the base pose; points
    touched by the hand check the mount."""

    def run(self) -> CommandResult:
        import numpy as np

        from fungrasp.geometry.poses import rotate
        from fungrasp.hands import load_hand
        from fungrasp.hands.arm import MOUNTING_GAP, mounting_pose
        from fungrasp.robots.assembly import (
            arm_driver,
            hand_driver,
            identified_dynamics,
            is_twin,
            pose_source,
        )
        from fungrasp.robots.calibration.touched import check_touched
        from fungrasp.robots.cell import check_calibrated, load_cell
        from fungrasp.robots.kinematics.arm_model import ArmKinematics, ClearanceModel
        from fungrasp.robots.kinematics.joint_path import FreePath
        from fungrasp.robots.safety import check_posture

        cell = load_cell(self.cell)
        hand = load_hand(cell.hand)
        kinematics = ArmKinematics(cell, hand)
        home = np.array(cell.arm.home)
        if home.shape != kinematics.lower.shape:
            raise FungraspError(f"'arm.home' must have {len(kinematics.lower)} joints, not {len(home)}")
        if (home < kinematics.lower).any() or (home > kinematics.upper).any():
            raise FungraspError(f"'arm.home' is beyond the joint limits of the {Path(cell.arm.model).stem}")
        fingers = hand.open_joints
        clearance = ClearanceModel(cell, hand)
        pose = kinematics.palm_pose(home)
        palm = ", ".join(f"{x:.2f}" for x in pose[:3])
        if not FreePath(kinematics, clearance, cell.workspace).clear(home, fingers, None):
            why = check_posture(pose, clearance.measure(home, fingers), cell.workspace)
            raise FungraspError(
                f"at 'arm.home' {why or 'the robot is too close to an obstacle'}; the palm is at ({palm}) m"
            )
        limits = cell.limits
        value = {
            "name": cell.name,
            "hand": hand.name,
            "arm": Path(cell.arm.model).stem,
            "palm_at_home": pose,
            "devices": [],
            "palm_speed": limits.palm_speed,
            "palm_acceleration": limits.palm_acceleration,
        }
        mounted = mounting_pose(hand, cell.mount)
        place = (cell.mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP))[:3]
        place = ", ".join(f"{1e3 * x:.0f}" for x in place)
        faces, along = (_axis(rotate(mounted[3:], v)) for v in (hand.palm_normal, hand.palm_fingers))
        lines = [
            f"{cell.name}: {hand.title} on a {value['arm']}; palm at home: {palm} m",
            f"mount, in the flange frame: the base of the palm is at ({place}) mm; the palm faces {faces}, "
            f"the fingers point along {along}",
        ]
        checked = {} if self.touched is None else check_touched(self.touched, cell, hand)
        for part, found in checked.items():
            if found.fault:
                raise FungraspError(found.fault)
            value[f"{part}_miss"] = found.miss
            lines.append(f"{part}: {found.count} touched points, within {1e3 * found.miss:.1f} mm")
        if is_twin(cell):
            lines.append("device: simulated twin")
        else:
            devices = (arm_driver(cell), hand_driver(cell, hand), pose_source(cell))
            value["devices"] = [device.name for device in devices]
            lines += [f"device: {device.name}" for device in devices]
            check_calibrated(cell)
        limited, _ = identified_dynamics(cell, hand)
        own = np.array([servo.force_limit for servo in hand.actuators.values()])
        planned = np.array([servo.force_limit for servo in limited.actuators.values()])
        less = "" if (planned == own).all() else f", below the model's {_range(own)}: plans use this limit"
        lines.append(f"hand: torques up to {_range(planned)} N m{less}")
        lines.append(f"palm: up to {limits.palm_speed:g} m/s, {limits.palm_acceleration:g} m/s^2")
        torques = dict(zip(hand.actuators, planned, strict=True))
        return CommandResult({**value, "planned_torques": torques}, "\n".join(lines))


@dataclass(frozen=True)
class Emulate:
    """Start emulators of a cell's devices on the loopback interface, backed by a simulated twin.

    Then run `fungrasp deploy` with the same cell and grasp in another terminal. Stop with Ctrl-C."""

    cell: CellName = "ur5e-allegro-emulated"
    """A cell with loopback addresses."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp, which determines where the object is placed."""
    twin: int = 0
    """Index of the twin, 0, 1, 2 ..., which determines its hidden parameters."""
    seconds: float | None = None
    """Stop after this time [s]. Default: run until Ctrl-C."""

    def run(self) -> None:
        import time

        from fungrasp.deployment.preparation import reachable_placements
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell
        from fungrasp.robots.device import import_emulators
        from fungrasp.robots.twin.parameters import cell_twin
        from fungrasp.robots.twin.world import TwinWorld
        from fungrasp.task import LiftProtocol

        emulators = import_emulators("cell")
        cell = load_cell(self.cell)
        hand = load_hand(cell.hand)
        grasp, objects = self.choice.robot(hand)
        obj = objects[str(grasp.object_name[0])]
        truth = cell_twin(cell, hand, self.twin)
        world = TwinWorld(cell, hand, obj, truth)
        world.settle(next(reachable_placements(cell, hand, obj, grasp)))
        rest = world.center_of_mass()[2]
        with emulators.CellEmulation(cell, world, obj.name) as emulation:
            print(f"{cell.name}: emulators are ready, with '{obj.name}' on the table", flush=True)
            start, highest, up = time.monotonic(), 0.0, 0.0
            try:
                while self.seconds is None or time.monotonic() < start + self.seconds:
                    time.sleep(0.05)
                    height = float(world.center_of_mass()[2] - rest)
                    lifted = height >= LiftProtocol.success_height and not world.look().on_table
                    up = up + 0.05 if lifted else 0.0
                    highest = max(highest, up)
            except KeyboardInterrupt:
                pass
            print(f"the object was up by 10 cm or more for {highest:.1f} s without a break")
            twin = emulation.twin
            late, lost = 1e3 * twin.latest, 1e3 * twin.lost
            print(f"the twin was up to {late:.0f} ms late and lost {lost:.0f} ms in total")


@dataclass(frozen=True)
class ShowLog(Answering):
    """Summarize a log of `fungrasp deploy`, complete or not."""

    log: Annotated[Path, tyro.conf.Positional]
    """An MCAP file."""

    def run(self) -> CommandResult:
        from fungrasp.deployment.log import read_log

        log = read_log(self.log)
        counts = {name[1:]: len(found) for name, found in log.messages.items()}
        said = {"complete": log.complete, **log.about, "counts": counts}
        lines = [
            "complete" if log.complete else "incomplete: the writer was killed or the disk was full",
            *(f"{name}: {value}" for name, value in log.about.items()),
            *(f"{e['time']:.2f} s  {e['what']}: {e['text']}" for e in log.messages["/event"]),
            f"{counts['step']} control steps, {counts['setpoint']} setpoints",
        ]
        return CommandResult(
            {**said, "events": log.messages["/event"]}, "\n".join([*lines, suggestion("view", self.log)])
        )


def _axis(vector: np.ndarray) -> str:
    """Return the name of a direction, such as "+x", or its components."""
    for number, part in enumerate(vector):
        if abs(part) > 0.999:
            return f"{'+-'[int(part < 0)]}{'xyz'[number]}"
    return f"({', '.join(f'{part:.2f}' for part in vector)})"


def _range(values: np.ndarray) -> str:
    """Return the smallest and largest value, or one number if they are equal."""
    low, high = f"{values.min():.2g}", f"{values.max():.2g}"
    return low if low == high else f"{low} to {high}"


COMMAND = {
    "calibrate": "fungrasp.cli.calibrate:Calibrate",
    "list": ListCells,
    "new": New,
    "check": Check,
    "doctor": "fungrasp.cli.devices:Doctor",
    "read": "fungrasp.cli.devices:Read",
    "touch": "fungrasp.cli.devices:Touch",
    "hold": "fungrasp.cli.devices:Hold",
    "jog": "fungrasp.cli.devices:Jog",
    "bring-up": "fungrasp.cli.bring_up:BringUp",
    "emulate": Emulate,
    "log": ShowLog,
}
