"""What pages and notebooks say about grasps: pictures, contacts, numbers, outcomes; the page of what a verb
returned.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.plots import RateBars, rates_svg
from fungrasp.core.provenance import page_provenance
from fungrasp.evaluation import LiftTestResult, StaticQuality, Trajectory
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet, load_objects
from fungrasp.grasps.grasp_arguments import Objects, as_grasp_set, resolve_objects
from fungrasp.hands import Hand
from fungrasp.media.grasp_scenes import frame_geoms, grasp_scene, look_at_grasp, view_angles
from fungrasp.media.page import Contact, GraspReport, Page, Quantity, figure, text_card, write_page
from fungrasp.media.perception_page import write_perception_page
from fungrasp.media.pictures import DRAWN_GRASPS, grasp_picture, grid, spread_rows
from fungrasp.media.render import render
from fungrasp.objects import ObjectModel
from fungrasp.perception.perceived import Perceived
from fungrasp.task import GraspPlan
from fungrasp.task.use import UseOutcomes

DIGITS = 3
"""Digits after the point to which numbers are rounded."""

WIDTH, HEIGHT = 560, 420
"""Size of each picture [pixels]."""

MEANINGS: dict[str, tuple[str, str, str]] = {
    "contact_error_mm": ("Contact error", "mm", "Between where person and robot touch, on the surface."),
    "contact_gap_mm": ("Contact gap", "mm", "Between the object and the links that should touch it."),
    "link_direction_error_deg": (
        "Link direction error",
        "°",
        "Between person and robot, mean of the finger links.",
    ),
    "object_penetration_mm": ("Depth in the object", "mm", "Deepest point of the hand inside the object."),
    "table_penetration_mm": ("Depth in the table", "mm", "Deepest point of the hand below the table top."),
    "limit_violation_rad": ("Beyond joint limits", "rad", "Of the joint that exceeds its limits most."),
    "force_closure_epsilon": (
        "Force closure ε",
        "",
        "Weakest push that the contacts resist; 0 if not all.",
    ),
}
"""Name, unit and meaning of the numbers of ``StaticQuality`` that a page shows."""


def write_view(what: Any, objects: Objects, out: str | Path) -> Path:
    """Write a page about grasps, the result of a lift test, or what was perceived.

    Args:
        what: human or robot grasps, of which a few of different objects are drawn; a result, of which some
            episodes of either outcome are; or what ``perceive`` returned.
        objects: those of grasps, as for ``retarget``. A result has its own.
        out: HTML file to write; it needs no other file and no network.

    Returns:
        The path of the page.

    Raises:
        FungraspError: something else, an object that is missing, or a file that can't be written.
    """
    path = Path(out)
    if isinstance(what, Perceived):
        write_perception_page(path, what, page_provenance({}, 0))
    elif isinstance(what, LiftTestResult):
        _write_result(path, what)
    elif isinstance(what, HumanGraspSet | RobotGraspSet | HumanGrasp | RobotGrasp):
        what = as_grasp_set(what)
        known = resolve_objects(what, objects)
        rows = spread_rows(what.object_name)
        reports = [_report(what, row, known) for row in rows]
        hand = what.load_hand().title if isinstance(what, RobotGraspSet) else "Human hand"
        count = f"{len(rows)} of {len(what)} grasps" if len(rows) < len(what) else ""
        write_page(path, Page("Grasps", reports, hand, count, page_provenance({}, 0)))
    else:
        raise FungraspError(
            "a page on disk can be made of grasps, a result or what was perceived, not of "
            f"{'nothing' if what is None else 'a ' + type(what).__name__}; without out= a browser shows more"
        )
    return path


def _write_result(path: Path, result: LiftTestResult) -> None:
    grasps = result.grasps
    if grasps is None:
        raise FungraspError("the result does not know its grasps: view what evaluate has returned")
    # Failures are what one looks for: as many of them as there are, up to half of the pictures.
    failed, held = (np.flatnonzero(flags) for flags in (~result.success, result.success))
    few = failed[spread_rows(result.object_name[failed], DRAWN_GRASPS // 2)]
    rows = [*few, *held[spread_rows(result.object_name[held], DRAWN_GRASPS - len(few))]]
    reports = []
    for row in rows:
        success, reason = bool(result.success[row]), str(result.outcomes.reason[row])
        words = outcome_words(success, reason, bool(result.rollouts[row]))
        reports.append(_report(grasps, int(result.index[row]), result.objects, success, words))
    held_count = f"{int(result.success.sum())} of {len(result.success)} episodes lifted and held"
    introduction = f"Policy {result.policy}, protocol {result.spec.protocol}: {held_count}."
    seeds = result.spec.seeds
    page = Page("Lift test", reports, result.hand, introduction, page_provenance({}, seeds[0]))
    write_page(path, page, [rates_by_object(result), text_card("By object", result.table())])


def rates_by_object(result: LiftTestResult) -> str:
    """Rates of success by object, drawn."""
    names = sorted(set(result.object_name.tolist()))
    flags = [result.success[result.object_name == name] for name in names]
    bars = RateBars(
        "Lifted and held, with 95 % intervals",
        names,
        np.array([each.mean() for each in flags]),
        np.array([wilson_interval(int(each.sum()), len(each)) for each in flags]),
        [f"{int(each.sum())} of {len(each)}" for each in flags],
    )
    return f"<figure>{rates_svg(bars)}</figure>"


def _report(
    grasps: HumanGraspSet | RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    success: bool | None = None,
    outcome: str = "",
) -> GraspReport:
    """What the page says of one grasp, with its picture."""
    grasp = grasps[row]
    picture, is_human = grasp_picture(grasps, row, objects, WIDTH, HEIGHT), isinstance(grasp, HumanGrasp)
    return GraspReport(
        grasp_title(grasp),
        object_mass=float(grasp.object_mass),
        success=success,
        outcome=outcome,
        human_picture=picture if is_human else None,
        robot_picture=None if is_human else picture,
    )


def grasp_title(grasp: HumanGrasp | RobotGrasp) -> str:
    """ "Spray bottle, to spray"."""
    name = grasp.object_name.replace("_", " ")
    return f"{name[:1].upper()}{name[1:]}{f', to {grasp.task}' if grasp.task else ''}"


def outcome_words(success: bool, reason: str, rollouts: bool = False) -> str:
    """How an episode ended, in a sentence.

    Args:
        success: whether the object was lifted and held.
        reason: why not, as a phrase.
        rollouts: whether the plan was chosen in simulated rollouts.
    """
    if not success:
        return f"It did not hold: {reason}."
    how = "with a plan that was chosen in simulated rollouts" if rollouts else "at the first try"
    return f"Lifted and held for 3 s, {how}."


def use_outcome(use: UseOutcomes, row: int) -> str:
    """How a use test ended, in a sentence. row: of the grasp in ``use``."""
    motion = str(use.motion[row]).replace("_", " ")
    moved = f"by {1e3 * use.shift_m[row]:.0f} mm and {np.rad2deg(use.turn_rad[row]):.0f}°"
    if use.success[row]:
        return f"Use ({motion}): passed, moved {moved} in the palm."
    return f"Use ({motion}): failed, {use.reason[row]}."


def grasp_pictures(
    human: HumanGrasp, robot: RobotGrasp, hand: Hand, obj: ObjectModel
) -> tuple[np.ndarray, np.ndarray]:
    """The human grasp of an object and the robot's that imitates it, seen from the same side; links in
    contact are orange.

    Returns:
        two pictures, sRGB, shape [HEIGHT, WIDTH, 3] uint8.
    """
    person, _ = grasp_scene(human, obj)
    model, qpos = grasp_scene(robot, obj, hand)
    camera = look_at_grasp(model, qpos, width=WIDTH, height=HEIGHT)
    theirs = frame_geoms(person, person.qpos0, *view_angles(camera), width=WIDTH, height=HEIGHT)
    return render(person, person.qpos0, theirs)[0], render(model, qpos, camera)[0]


def contacts(robot: RobotGrasp, trajectory: Trajectory, hand: Hand) -> list[Contact]:
    """Which links should touch the object, and which do during more than half of the hold."""
    hold = trajectory.phase == trajectory.phase.max()
    reached = trajectory.link_contacts[hold].mean(axis=0) > 0.5
    return [
        Contact(name, bool(target), bool(touches))
        for name, target, touches in zip(hand.link_names, robot.link_contacts, reached, strict=True)
        if target or touches
    ]


def quantities(quality: StaticQuality, result: LiftTestResult, row: int) -> list[Quantity]:
    """Numbers of one grasp: the retargeted grasp's static quality, then what was measured in simulation."""
    static = [
        Quantity(name, round(float(getattr(quality, key)[row]), DIGITS), unit, meaning)
        for key, (name, unit, meaning) in MEANINGS.items()
        if np.isfinite(getattr(quality, key)[row])
    ]
    t = result.outcomes
    lifted, slip, pushed = 1e3 * t.lifted_height_m[row], t.sim_distance_hand_mm_s[row], 1e3 * t.pushed_m[row]
    return [
        *static,
        Quantity("Lifted by", round(float(lifted), DIGITS), "mm", "At least, during the hold."),
        Quantity("Slip", round(float(slip), DIGITS), "mm/s", "Of the object in the hand, during the hold."),
        Quantity("Pushed by", round(float(pushed), DIGITS), "mm", "While the hand approached and closed."),
    ]


PICTURES = 4
"""Grasps that are drawn."""

ROWS = 8
"""Lines of a table."""


def notebook_html(value: Any) -> str | None:
    """HTML of grasps, a plan or a result; None of anything else."""
    if isinstance(value, HumanGraspSet | RobotGraspSet):
        return _grasps(value)
    if isinstance(value, LiftTestResult):
        return f"{escape(repr(value))}{rates_by_object(value)}<pre>{escape(value.table())}</pre>"
    if isinstance(value, GraspPlan):
        return _plans(value)
    return None


def _grasps(grasps: HumanGraspSet | RobotGraspSet) -> str:
    task = np.full(len(grasps), "") if grasps.task is None else grasps.task
    rows = [
        (
            str(row),
            str(grasps.object_name[row]),
            str(task[row]),
            f"{1e3 * float(grasps.object_mass[row]):.0f} g",
        )
        for row in range(min(len(grasps), ROWS))
    ]
    words = _table(("row", "object", "task", "mass"), rows, len(grasps))
    return f"{escape(repr(grasps))}{_pictures(grasps)}{words}"


def _pictures(grasps: HumanGraspSet | RobotGraspSet) -> str:
    """A few of them; none where their objects are not built in."""
    chosen = spread_rows(grasps.object_name, PICTURES)
    try:
        objects = load_objects(grasps.select(np.array(chosen)))
        drawn = [grasp_picture(grasps, row, objects, 280, 210) for row in chosen]
    except FungraspError:
        return ""
    labels = [str(grasps.object_name[row]) for row in chosen]
    return figure(grid(drawn, labels, columns=PICTURES), f"{len(chosen)} of {len(grasps)} grasps")


def _plans(plans: GraspPlan) -> str:
    expected = plans.expected_success
    rows = [
        (
            str(row),
            str(plans.object_name[row]),
            f"{plans.control_period * int(plans.closing_step[row]):.1f} s",
            f"{plans.control_period * int(plans.lift_step[row]):.1f} s",
            "–" if expected is None else f"{100 * float(expected[row]):.0f} %",
        )
        for row in range(min(len(plans), ROWS))
    ]
    heads = ("row", "object", "closes at", "lifts at", "expected success")
    return f"{escape(f'<GraspPlan: {len(plans)} plans>')}{_table(heads, rows, len(plans))}"


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]], count: int) -> str:
    """A table, and how many rows are not in it."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    more = f"<p>and {count - len(rows)} more</p>" if count > len(rows) else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
