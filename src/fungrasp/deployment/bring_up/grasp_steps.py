"""The last steps of a bring-up: a plan that is looked at, its way to the object, a lift, in slow motion."""

from __future__ import annotations

from pathlib import Path
from time import strftime

import numpy as np

from fungrasp.deployment.bring_up.log import FAILED, PASSED, StepResult
from fungrasp.deployment.bring_up.steps import BringUpTask, judged
from fungrasp.deployment.deployment_result import DeploymentSpec, Until
from fungrasp.deployment.log import read_log
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.plan_ahead import execute_plan, plan_ahead
from fungrasp.deployment.saved_plan import load_plan
from fungrasp.task import LiftProtocol


def make_plan(task: BringUpTask) -> StepResult:
    """Plan, draw, and let a person look."""
    task.operator.begin("Put the object where the arm reaches it. Nothing moves.")
    grasp, objects = task.choice.robot(task.hand, task.seed)
    source = task.choice.source(objects[str(grasp.object_name[0])])
    spec = DeploymentSpec(task.name, task.policy, seed=task.seed)
    threads = task.choice.threads
    saved = plan_ahead(
        grasp, objects, source, spec, about=task.choice.words, switch=task.switch, threads=threads
    )
    saved.save(task.plan)
    pictures = task.draw(task.plan, saved)
    measured = [saved.words(), f"plan: {task.plan.name}", *(f"look at: {path.name}" for path in pictures)]
    return judged(task, "Is the way free, and the grasp one that you want?", measured)


def approach(task: BringUpTask) -> StepResult:
    """Go to the start of the grasp in slow motion."""
    task.operator.begin(f"The arm goes to the start of the grasp at {task.speed:g} of its speed.")
    return StepResult(*_executed(task, "approach")[:2])


def lift(task: BringUpTask) -> StepResult:
    """Carry the whole plan out in slow motion."""
    task.operator.begin(
        f"Grasp, lift, put down and home at {task.speed:g} of the speed. A soft object, first."
    )
    status, measured, log = _executed(task, "home")
    if status == FAILED:
        return StepResult(status, measured)
    messages = read_log(log).messages["/setpoint"]
    heights = {phase: [m["object"][2] for m in messages if m["phase"] == phase] for phase in Phase}
    raised = float(np.min(heights[Phase.HOLD]) - np.median(heights[Phase.MOVE_TO_START]))
    said = f"the tracker saw the object {100 * raised:.1f} cm higher, at least, while it was held"
    high = raised >= LiftProtocol.success_height
    return StepResult(PASSED if high else FAILED, (*measured, said))


def _executed(task: BringUpTask, until: Until) -> tuple[str, tuple[str, ...], Path]:
    """How an execution of the plan went, what was measured, and its log."""
    log = task.plan.with_name(strftime(f"{task.plan.stem}-{until}-%Y%m%d-%H%M%S.mcap"))
    result = execute_plan(
        load_plan(task.plan),
        until=until,
        speed=task.speed,
        log=log,
        switch=task.switch,
        on_phase=lambda phase: task.operator.say(f"  {phase}"),
        on_connect=lambda: task.operator.say(f"  to stop: {task.switch.ways or 'Ctrl-C'}"),
        confirm=task.operator.confirm,
    )
    measured = (
        f"10 Hz: {result.ticks.summary()}",
        f"50 Hz: {result.setpoints.summary()}",
        f"log: {log.name}",
    )
    if result.fault:
        return FAILED, (result.words(), *measured), log
    return PASSED, measured, log
