"""``fungrasp robots doctor | read | touch | hold | jog | bring-up``: what comes before a grasp."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fungrasp.cli.console import Answer, Answering
from fungrasp.deployment.grasp_choice import GraspChoice

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.robots.cell import RobotCell
    from fungrasp.robots.stop_switch import StopSwitch

CellName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
Part = Annotated[Literal["arm", "hand"], tyro.conf.Positional]


@dataclass(frozen=True)
class Doctor(Answering):
    """Connect to each device of a cell in turn and say whether it answers. Nothing moves."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""

    def run(self) -> Answer:
        from fungrasp.robots.single_devices import examine_devices

        reports = []
        for report in examine_devices(*_wired(self.cell)):
            print(report.words, flush=True)
            reports.append(report)
        ill = sum(not report.well for report in reports)
        return Answer(
            [{"device": report.words, "well": report.well} for report in reports],
            fault=f"{ill} of 3 devices can't be used" if ill else "",
        )


@dataclass(frozen=True)
class Read(Answering):
    """Show the joints of an arm or a hand, as they are measured. Nothing moves."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    seconds: float = 10.0
    """For so long [s]."""

    def run(self) -> Answer:
        from fungrasp.robots.single_devices import bare_driver, joint_names, read_joints

        cell, hand = _wired(self.cell)
        names = joint_names(self.part, cell, hand)
        states = []
        with bare_driver(self.part, cell, hand) as driver:
            for state in read_joints(driver, self.seconds):
                states.append({"status": str(state.status), "positions": state.positions})
                joints = "  ".join(f"{n} {q:.3f}" for n, q in zip(names, state.positions, strict=True))
                print(f"{state.status}  {joints} rad", flush=True)
        return Answer({"joints": names, "states": states})


@dataclass(frozen=True)
class Touch(Answering):
    """Add a marked point that the robot touches now to a file, which `robots check --touched` and `robots
    bring-up --touched` take. Guide the arm there by hand (freedrive on the pendant). Nothing moves by
    itself."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    file: Annotated[Path, tyro.conf.Positional]
    """JSON file; one that is there goes on."""
    at: tuple[float, float, float]
    """The marked point, in the world of the cell [m]."""
    hand_point: tuple[float, float, float] | None = None
    """The point of the hand that touches it, in the frame that `pose_flange_hand` is the pose of [m]; by
    default the middle of the flange touches."""

    def run(self) -> Answer:
        import numpy as np

        from fungrasp.core.errors import FungraspError
        from fungrasp.robots.calibration.touched import add_touched, touched_point
        from fungrasp.robots.single_devices import arm_at_rest

        cell, hand = _wired(self.cell)
        joints, at = arm_at_rest(cell, hand), np.array(self.at)
        if not np.isfinite(at).all():
            raise FungraspError("a point is 3 finite numbers")
        point = None if self.hand_point is None else np.array(self.hand_point)
        apart = at - touched_point(joints, point, cell, hand)
        count = add_touched(self.file, joints, at, point)
        x, y, z = np.round(1e3 * apart) + 0.0
        what = "flange" if point is None else "hand"
        text = (
            f"{self.file}: {count} touched by the {what}; this one is ({x:.0f}, {y:.0f}, {z:.0f}) mm from "
            "where the cell has it"
        )
        return Answer({"touched": self.file, "count": count, "apart": apart}, text)


@dataclass(frozen=True)
class Hold(Answering):
    """Switch an arm or a hand on where it is, and hold; a device that moves now is not ready."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    seconds: float = 5.0
    """For so long [s]."""

    def run(self) -> Answer:
        from fungrasp.deployment.confirmation import ask_before_motion
        from fungrasp.robots.single_devices import guarded_driver, hold_in_place

        cell, hand = _wired(self.cell)
        with _switch(cell) as switch:
            ask_before_motion(switch, f"hold the {self.part} where it is for {self.seconds:g} s")
            with guarded_driver(self.part, cell, hand, switch) as driver:
                moved = hold_in_place(driver, self.seconds)
        return Answer({"moved": moved}, f"held within {moved:.3f} rad")


@dataclass(frozen=True)
class Jog(Answering):
    """Move one joint of an arm or a hand slowly by a small angle, and back; the others hold."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package."""
    part: Part
    """Which device."""
    joint: Annotated[str, tyro.conf.Positional]
    """Name of the joint, as `robots read` shows it."""
    by: float = 0.1
    """Angle [rad], 0.2 at most."""

    def run(self) -> Answer:
        from fungrasp.core.errors import UnknownNameError
        from fungrasp.deployment.confirmation import ask_before_motion
        from fungrasp.robots.single_devices import guarded_driver, jog, joint_names

        cell, hand = _wired(self.cell)
        names = joint_names(self.part, cell, hand)
        if self.joint not in names:
            raise UnknownNameError("joint", self.joint, names)
        with _switch(cell) as switch:
            ask_before_motion(switch, f"move '{self.joint}' of the {self.part} by {self.by:g} rad and back")
            with guarded_driver(self.part, cell, hand, switch) as driver:
                number = names.index(self.joint)
                rest = driver.read().positions[number]
                far, back = jog(driver, number, self.by)
        there, here = (float(state.positions[number] - rest) for state in (far, back))
        text = f"{self.joint}: moved by {there:.3f} rad, and back to {here:.3f} rad from where it was"
        return Answer({"joint": self.joint, "moved": there, "back": here}, text)


@dataclass(frozen=True)
class BringUp:
    """Walk through what comes before a robot's first grasp, one step after the other, up to a lift in slow
    motion; what was measured is written to a log, which goes on where it ended."""

    cell: CellName
    """A robot cell: a TOML file, or one that comes with the package; emulated devices will do, a twin not."""
    log: Path = Path("bring-up.md")
    """Markdown file of what was done. If it is there it goes on after the last step that did not fail."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp of the last steps."""
    policy: str = "plan"
    """What moves the hand: "plan" or "reference"."""
    speed: float = 0.1
    """Share of the cell's speed in the last steps."""
    touched: Path | None = None
    """JSON file of touched points, as `robots check --touched` takes it."""
    start: str = ""
    """Begin with this step though it was passed."""
    yes: bool = False
    """Answer yes to everything; for emulated devices only."""
    seed: int = 0
    """Seed of the plan."""

    def run(self) -> None:
        from fungrasp.deployment.bring_up.operator import Operator
        from fungrasp.deployment.bring_up.session import bring_up
        from fungrasp.deployment.bring_up.steps import BringUpTask
        from fungrasp.deployment.saved_plan import SavedPlan
        from fungrasp.media.plan_pictures import write_plan_pictures

        cell, hand = _wired(self.cell)

        def draw(path: Path, saved: SavedPlan) -> tuple[Path, ...]:
            thing = saved.origin.source.load()
            return write_plan_pictures(path, saved, cell, hand, thing, self.choice.threads)

        with _switch(cell) as switch:
            task = BringUpTask(
                self.cell,
                cell,
                hand,
                switch,
                Operator(switch, cell, _say, self.yes),
                self.choice,
                self.policy,
                self.speed,
                self.seed,
                self.touched,
                self.log.with_name(f"{self.log.stem}-plan.npz"),
                draw,
            )
            bring_up(task, self.log, self.start)


def _wired(name: str) -> tuple[RobotCell, Hand]:
    """A cell of real or emulated devices, and its hand."""
    from fungrasp.hands import load_hand
    from fungrasp.robots.cell import load_cell
    from fungrasp.robots.single_devices import check_wired

    cell = load_cell(name if Path(name).suffix != ".toml" else Path(name))
    check_wired(cell)
    return cell, load_hand(cell.hand)


def _say(line: str) -> None:
    print(line, flush=True)


def _switch(cell: RobotCell) -> StopSwitch:
    from fungrasp.robots.stop_switch import StopSwitch

    return StopSwitch(cell.stop_file, keyboard=True)
