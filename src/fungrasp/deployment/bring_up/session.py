"""A bring-up from the first step that is not done yet to the last, or to where one fails."""

from __future__ import annotations

from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import digest
from fungrasp.deployment.bring_up import grasp_steps, steps
from fungrasp.deployment.bring_up.log import FAILED, SKIPPED, BringUpLog, StepResult
from fungrasp.deployment.bring_up.operator import BringUpEnded, StepSkipped
from fungrasp.deployment.bring_up.steps import BringUpStep, BringUpTask
from fungrasp.robots.device import SafetyStop

STEPS = (
    BringUpStep("doctor", "Every device answers; nothing moves.", steps.examine),
    BringUpStep("read-arm", "The arm's joints are those of the pendant.", steps.read("arm")),
    BringUpStep("kinematics", "The model's flange is where the controller has it.", steps.compare_kinematics),
    BringUpStep("payload", "Cell and pendant say the same payload.", steps.compare_payload),
    BringUpStep("hold-arm", "The arm holds still where it is.", steps.hold("arm")),
    BringUpStep("jog-arm", "Each joint of the arm moves alone, as asked.", steps.jog_each("arm")),
    BringUpStep("stop", "What stops the arm stops it, and it stays stopped.", steps.try_stops),
    BringUpStep("base", "The base is where the cell has it.", steps.check_touched),
    BringUpStep("mount", "The hand is on the flange as the cell says.", steps.check_mount),
    BringUpStep("read-hand", "The hand's joints are the right ones.", steps.read("hand")),
    BringUpStep("hold-hand", "The hand holds still where it is.", steps.hold("hand")),
    BringUpStep("jog-hand", "Each joint of the hand moves alone, as asked.", steps.jog_each("hand")),
    BringUpStep("plan", "The whole way is planned, and looked at.", grasp_steps.make_plan),
    BringUpStep("approach", "The arm goes to the start of the grasp in slow motion.", grasp_steps.approach),
    BringUpStep("lift", "Grasp, lift, put down and home in slow motion.", grasp_steps.lift),
)
"""In order."""


def bring_up(task: BringUpTask, path: str | Path, start: str = "") -> None:
    """Go through the steps that are not done, each written to the log as it ends.

    Args:
        task: what is brought up.
        path: of the log; one that is there goes on.
        start: a step to begin with though it is done; "" for the first that is not.

    Raises:
        FungraspError: a step failed, or the operator ended the session; the log has what was done. No such
            step, or a file that is no log of this cell.
    """
    names = [step.name for step in STEPS]
    if start and start not in names:
        raise UnknownNameError("step", start, names)
    log = BringUpLog(path, task.cell.name, digest(task.cell, task.hand))
    done = [name for name, status in log.done.items() if status != FAILED]
    first = (
        names.index(start) if start else next((i for i, n in enumerate(names) if n not in done), len(names))
    )
    say = task.operator.say
    if first:
        say(f"{path}: {first} of {len(names)} steps are done")
    if log.other_cell:
        say(
            f"the cell has changed since; '--start {names[0]}' begins anew, if that touches what was measured"
        )
    for number in range(first, len(STEPS)):
        step = STEPS[number]
        say(f"[{number + 1}/{len(STEPS)}] {step.name}: {step.title}")
        result = _done(step, task)
        log.append(step.name, step.title, result)
        shown = result.measured if result.status == FAILED else result.measured[-1:]
        say("\n".join(f"  {line}" for line in (*shown, result.status)))
        if result.status == FAILED:
            raise FungraspError(f"the step '{step.name}' failed; the same command goes on there ({path})")
    say(f"brought up; the log is {path}")


def _done(step: BringUpStep, task: BringUpTask) -> StepResult:
    """How a step went, whatever came of it."""
    try:
        return step.run(task)
    except StepSkipped as skipped:
        return StepResult(SKIPPED, (str(skipped),))
    except BringUpEnded:
        raise
    except SafetyStop as stop:
        return StepResult(FAILED, (stop.reason,))
    except FungraspError as error:
        return StepResult(FAILED, (str(error),))
