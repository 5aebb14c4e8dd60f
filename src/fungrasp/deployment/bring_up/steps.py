"""The steps of a bring-up that move one device at most: each says what it does, and measures it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.bring_up.log import FAILED, PASSED, SKIPPED, StepResult
from fungrasp.deployment.bring_up.operator import Operator, StepSkipped
from fungrasp.deployment.grasp_choice import GraspChoice
from fungrasp.deployment.saved_plan import SavedPlan
from fungrasp.geometry.poses import rotate
from fungrasp.hands import Hand
from fungrasp.hands.arm import MOUNTING_GAP, mounting_pose
from fungrasp.robots.calibration.touched import check_touched_base, check_touched_mount
from fungrasp.robots.cell import RobotCell, is_wired
from fungrasp.robots.device import RobotError, SafetyStop
from fungrasp.robots.single_devices import (
    GOAL_PERIOD,
    JOG_SPEED,
    GuardedDriver,
    bare_driver,
    examine_devices,
    guarded_driver,
    hold_in_place,
    jog,
    joint_names,
    read_joints,
)
from fungrasp.robots.stop_switch import StopSwitch

READ_TIME, HOLD_TIME = 10.0, 5.0
"""Time for which joints are read, and for which a device holds [s]."""

BY = 0.1
"""Each joint is moved by so much [rad]."""

STILL = {"arm": 0.005, "hand": 0.06}
"""A joint that is told to stay moves less [rad]: an arm's servos are stiff, a hand's are not."""

AT_REST, LONGEST_REST = 0.02, 1.0
"""A joint slower than this is at rest [rad/s]; a stopped arm is within this time [s]."""

STOP_AFTER = 0.5
"""Without a keyboard the switch is pressed when the joint has moved for so long [s]."""

COMPARED = 2.0
"""An arm that has been taken says within this time what was compared [s]."""


@dataclass(frozen=True)
class BringUpTask:
    """What is brought up, and with what."""

    name: str
    """Of the cell, or its file."""
    cell: RobotCell
    """The robot."""
    hand: Hand
    """On its arm."""
    switch: StopSwitch
    """Stops whatever moves."""
    operator: Operator
    """Answers."""
    choice: GraspChoice
    """The grasp of the last steps."""
    policy: str
    """What moves the hand then."""
    speed: float
    """Share of the cell's speed then."""
    seed: int
    """Of the plan."""
    touched: Path | None
    """File of touched points; None for none."""
    plan: Path
    """File of the plan."""
    draw: Callable[[Path, SavedPlan], tuple[Path, ...]]
    """Draws a plan beside its file; gives the pictures."""


@dataclass(frozen=True)
class BringUpStep:
    """One step."""

    name: str
    """By which the log knows it."""
    title: str
    """What it does and shows, as a sentence."""
    run: Callable[[BringUpTask], StepResult]
    """Does it. ``StepSkipped`` leaves it out; a ``FungraspError`` is its failure."""


def judged(task: BringUpTask, question: str, measured: list[str]) -> StepResult:
    """The result of a step that a person judges."""
    if not task.operator.present:
        return StepResult(PASSED, (*measured, f"nobody looked ({question})"))
    for line in measured:
        task.operator.say(f"  {line}")
    right = task.operator.judges(question)
    return StepResult(
        PASSED if right else FAILED, (*measured, f"operator: {question} {'yes' if right else 'no'}")
    )


def examine(task: BringUpTask) -> StepResult:
    """Whether all devices answer."""
    reports = list(examine_devices(task.cell, task.hand))
    well = all(report.well for report in reports)
    return StepResult(PASSED if well else FAILED, tuple(report.words for report in reports))


def read(part: str) -> Callable[[BringUpTask], StepResult]:
    """Read a device and let a person compare. part: "arm" or "hand"."""
    do, question = {
        "arm": ("Compare the joints with the pendant.", "Do the joints agree with the pendant?"),
        "hand": (
            "Move each finger by hand meanwhile, where it gives way.",
            "Did the right joints move, with the right sign and size?",
        ),
    }[part]

    def run(task: BringUpTask) -> StepResult:
        task.operator.begin(f"{do} Nothing moves by itself, for {READ_TIME:g} s.")
        names, rows, stamps = joint_names(part, task.cell, task.hand), [], []
        seconds = READ_TIME if task.operator.present else 1.0
        with bare_driver(part, task.cell, task.hand) as driver:
            for state in read_joints(driver, seconds):
                rows.append(state.positions.copy())
                stamps.append(state.device_time)
                if task.operator.present:
                    task.operator.say("  " + "  ".join(f"{q:.3f}" for q in state.positions))
        low, high = np.min(rows, axis=0), np.max(rows, axis=0)
        measured = [f"{n}: {a:.3f} to {b:.3f} rad" for n, a, b in zip(names, low, high, strict=True)]
        if len(stamps) > 1 and stamps[-1] <= stamps[0]:
            return StepResult(FAILED, (*measured, "the device's time stamp stands still"))
        return judged(task, question, measured)

    return run


def compare_kinematics(task: BringUpTask) -> StepResult:
    """Take the arm and let its driver compare model and controller."""
    task.operator.begin("Take control of the arm: a program that runs on it ends, and it holds where it is.")
    with guarded_driver("arm", task.cell, task.hand, task.switch) as driver:
        driver.take_control()
        end, said = time.monotonic() + COMPARED, ""
        while not said and time.monotonic() < end:
            time.sleep(GOAL_PERIOD)
            said = driver.read().message
    if not said:
        return StepResult(SKIPPED, (f"the driver '{task.cell.arm.driver}' compares nothing",))
    return StepResult(PASSED, (said,))


def compare_payload(task: BringUpTask) -> StepResult:
    """Whether the cell says what the arm carries; its driver has refused another value of the pendant."""
    options = task.cell.arm.options
    mass, center = options.get("payload", -1.0), options.get("payload_center", ())
    if mass < 0:
        said = "the cell does not say what the arm carries: weigh it, and set 'payload' in [arm] options"
        return StepResult(FAILED if is_wired(task.cell) else SKIPPED, (said,))
    with guarded_driver("arm", task.cell, task.hand, task.switch) as driver:
        driver.take_control()
    return StepResult(PASSED, (f"{mass:g} kg at {list(center)} m, as the pendant says",))


def hold(part: str) -> Callable[[BringUpTask], StepResult]:
    """Let a device hold where it is. part: "arm" or "hand"."""

    def run(task: BringUpTask) -> StepResult:
        task.operator.begin(f"The {part} is switched on and holds for {HOLD_TIME:g} s. It must not move.")
        with guarded_driver(part, task.cell, task.hand, task.switch) as driver:
            moved = hold_in_place(driver, HOLD_TIME)
        said = f"held within {moved:.4f} rad, {STILL[part]:g} rad are allowed"
        return StepResult(PASSED if moved <= STILL[part] else FAILED, (said,))

    return run


def jog_each(part: str) -> Callable[[BringUpTask], StepResult]:
    """Move each joint of a device alone. part: "arm" or "hand"."""

    def run(task: BringUpTask) -> StepResult:
        names = joint_names(part, task.cell, task.hand)
        measured, wrong, left_out = [], 0, 0
        with guarded_driver(part, task.cell, task.hand, task.switch) as driver:
            for number, name in enumerate(names):
                try:
                    task.operator.begin(f"'{name}' moves by {BY:g} rad at {JOG_SPEED:g} rad/s, and back.")
                except StepSkipped as skipped:
                    measured.append(f"{name}: left out: {skipped}")
                    left_out += 1
                    continue
                words, well = _jogged(driver, number, part)
                measured.append(f"{name}: {words}{'' if well else ' (wrong)'}")
                task.operator.say(f"  {measured[-1]}")
                wrong += not well
        status = FAILED if wrong else SKIPPED if left_out == len(names) else PASSED
        return StepResult(status, tuple(measured))

    return run


def _jogged(driver: GuardedDriver, joint: int, part: str) -> tuple[str, bool]:
    """Move a joint to where it has more room, and back; what was measured, and whether it was right."""
    rest, limits = driver.read().positions, driver.limits
    by = BY if limits.upper[joint] - rest[joint] > rest[joint] - limits.lower[joint] else -BY
    far, back = jog(driver, joint, by)
    moved = far.positions - back.positions
    others = float(np.abs(np.delete(moved, joint)).max())
    missed = abs(float(back.positions[joint] - rest[joint]))
    well = abs(moved[joint] - by) < 0.5 * BY and max(others, missed) < STILL[part]
    said = f"asked {by:+.2f}, moved {moved[joint]:+.3f} rad, others by {others:.3f}, back within {missed:.3f}"
    return said, bool(well)


def check_touched(task: BringUpTask) -> StepResult:
    """Whether the base is where the cell says, by points that the flange has touched."""
    if task.touched is None:
        said = "no touched points (--touched FILE): 'fungrasp robots touch' makes a file of them"
        if not is_wired(task.cell):
            raise StepSkipped(said)
        task.operator.begin(f"There are {said}.")
        return StepResult(FAILED, (said,))
    base = check_touched_base(task.touched, task.cell, task.hand)
    if base.fault:
        raise FungraspError(base.fault)
    return StepResult(PASSED, (f"{base.count} touched points within {1e3 * base.miss:.1f} mm",))


def check_mount(task: BringUpTask) -> StepResult:
    """Whether the hand is on the flange as the cell says: by points that it has touched, and by a ruler."""
    touched = None if task.touched is None else check_touched_mount(task.touched, task.cell, task.hand)
    if touched is not None and touched.fault:
        raise FungraspError(touched.fault)
    pose = mounting_pose(task.hand, task.cell.mount)
    x, y, z = 1e3 * np.array((task.cell.mount.pose_flange_hand or (0.0, 0.0, MOUNTING_GAP))[:3])
    out = rotate(pose[3:], task.hand.palm_normal)
    fingers = rotate(pose[3:], task.hand.palm_fingers)
    measured = [
        f"the middle of the palm's lower end is ({x:.0f}, {y:.0f}, {z:.0f}) mm from the flange's middle",
        f"the palm faces {_direction(out)} and the fingers point along {_direction(fingers)} of the flange",
    ]
    if touched is not None:
        measured.append(f"{touched.count} points that the hand touched within {1e3 * touched.miss:.1f} mm")
    return judged(task, "Does a ruler on the hand say so, too?", measured)


def _direction(vector: np.ndarray) -> str:
    """A direction in words."""
    axis = int(np.argmax(np.abs(vector)))
    if abs(vector[axis]) > 0.999:
        return f"{'+-'[int(vector[axis] < 0)]}{'xyz'[axis]}"
    return f"({', '.join(f'{v:.2f}' for v in vector)})"


def try_stops(task: BringUpTask) -> StepResult:
    """Stop a moving joint of the arm by each way of the switch."""
    file = task.cell.stop_file
    ways = {"the key Enter": None, **({"the stop file": Path(file)} if file else {})}
    measured, well = [], True
    for words, path in ways.items():
        person = task.operator.present and task.switch.keyboard
        how = f"Stop it by {words} while it moves." if person else f"The program does as {words} would."
        task.operator.begin(f"The last joint of the arm moves by {2 * BY:g} rad. {how}")
        said, right = _stopped(task, path, person)
        measured.append(f"{words}{'' if person else ', by the program'}: {said}")
        well &= right
    return StepResult(PASSED if well else FAILED, tuple(measured))


def _stopped(task: BringUpTask, file: Path | None, person: bool) -> tuple[str, bool]:
    """Move until the switch stops the arm; what was measured, and whether it stopped and stays so."""
    with (
        guarded_driver("arm", task.cell, task.hand, task.switch) as driver,
        _pressed(task.switch, file, person),
    ):
        joint = len(driver.limits.lower) - 1
        rest = driver.read().positions[joint]
        by = 2 * BY if driver.limits.upper[joint] - rest > rest - driver.limits.lower[joint] else -2 * BY
        try:
            jog(driver, joint, by)
            return "it was not stopped", False
        except SafetyStop:
            begun, place = time.monotonic(), driver.read().positions.copy()
        while np.abs((state := driver.read()).velocities).max() > AT_REST:
            if time.monotonic() > begun + LONGEST_REST:
                return "the arm does not come to rest", False
            time.sleep(0.002)
        waited, further = time.monotonic() - begun, float(np.abs(state.positions - place).max())
        try:
            driver.command(state.positions)
        except (SafetyStop, RobotError):
            return (
                f"at rest {1e3 * waited:.0f} ms later and {further:.4f} rad further; it stays stopped",
                True,
            )
        return "it takes commands again without a new start", False


@contextmanager
def _pressed(switch: StopSwitch, file: Path | None, person: bool) -> Iterator[None]:
    """Press a switch in a moment where no person does; afterwards it can be used again."""

    def press() -> None:
        if file is None:
            switch.press("pressed to try it")
        else:
            file.touch()

    timer = threading.Timer(STOP_AFTER, press)
    if not person:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if file is not None:
            file.unlink(missing_ok=True)
        switch.release()
