"""Pages and notebook output about grasps: pictures, contacts, numbers, outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import check_suffix
from fungrasp.core.plots import RateBars, rates_svg
from fungrasp.core.provenance import page_provenance
from fungrasp.evaluation import LiftTestResult, StaticQuality, Trajectory
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.geometry.poses import compose
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet, load_grasps, load_objects
from fungrasp.grasps.as_shown import place_marks
from fungrasp.grasps.grasp_arguments import Objects, as_grasp_set
from fungrasp.hands import Hand
from fungrasp.media.page import Contact, GraspReport, Page, Quantity, figure, text_card, write_page
from fungrasp.media.perception_page import write_perception_page
from fungrasp.media.pictures import DRAWN_GRASPS, MARKS_MEAN, grasp_pictures, grid, spread_rows
from fungrasp.objects import ObjectModel
from fungrasp.perception.perceived import Perceived
from fungrasp.task import GraspPlan
from fungrasp.task.use import UseOutcomes

DIGITS = 3
"""Decimal places of rounded numbers."""

SIZE = (560, 420)
"""Width and height of each picture [pixels]."""

MEANINGS: dict[str, tuple[str, str, str]] = {
    "shown_share": (
        "Links as shown",
        "",
        "Share of the wanted links at the person's places, from the same side.",
    ),
    "place_error_mm": (
        "Place error",
        "mm",
        "Between where person and robot touch, mean of the wanted links.",
    ),
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
"""Name, unit and meaning of the fields of ``StaticQuality`` on a page."""


WRITES = (
    "it writes pages of grasps and of what evaluate and perceive return; without out=, a browser shows more"
)


def write_view(what: Any, objects: Objects, out: str | Path) -> Path:
    """Write a page about grasps, a lift test or a perceived grasp.

    Args:
        what: human or robot grasps or their file (up to ``DRAWN_GRASPS`` are drawn; None: the built-in
            grasps), a result (some successes and failures are drawn), or the result of ``perceive``.
        objects: objects of the grasps, as for ``retarget``. A result has its own.
        out: self-contained HTML file to write.

    Returns:
        The path of the page.

    Raises:
        FungraspError: wrong type or suffix, a missing object, or a file can't be read or written.
    """
    path = check_suffix(out, "a page", ".html")
    if what is None or isinstance(what, str | Path):
        if what is not None and Path(what).suffix not in ("", ".npz"):
            raise FungraspError(f"out= reads only grasp files (.npz), not {what}: {WRITES}")
        what = load_grasps(what or "builtin")
    if isinstance(what, Perceived):
        write_perception_page(path, what, page_provenance({}, 0))
    elif isinstance(what, LiftTestResult):
        _write_result(path, what)
    elif isinstance(what, HumanGraspSet | RobotGraspSet | HumanGrasp | RobotGrasp):
        what = as_grasp_set(what)
        known = load_objects(what, objects)
        rows = spread_rows(what.object_name)
        reports = [_report(what, row, known) for row in rows]
        hand = what.load_hand().title if isinstance(what, RobotGraspSet) else "Human hand"
        words = f"{len(rows)} of {len(what)} grasps. " if len(rows) < len(what) else ""
        if isinstance(what, RobotGraspSet) and what.shown_places is not None:
            words += MARKS_MEAN
        write_page(path, Page("Grasps", reports, hand, words.strip(), page_provenance({}, 0)))
    else:
        raise FungraspError(f"out= can't write a page of a {type(what).__name__}: {WRITES}")
    return path


def _write_result(path: Path, result: LiftTestResult) -> None:
    grasps = result.grasps
    if grasps is None:
        raise FungraspError("the result has no grasps: view the object that evaluate returned")
    shown = result.outcomes.held_as_shown if result.knows_places else result.success
    rows: list[int] = []
    # Up to a third of the pictures each for failures and for objects not held as shown.
    for share, flags in ((3, ~result.success), (2, result.success & ~shown), (1, shown)):
        which = np.flatnonzero(flags)
        some = spread_rows(result.object_name[which], (DRAWN_GRASPS - len(rows)) // share)
        rows += which[some].tolist()
    held = in_the_hold(result)
    reports = []
    for row in rows:
        reached = result.success[row] and result.hold is not None
        touching = result.hold.touching[row, 1:] if reached and result.hold is not None else None
        human = None if result.human is None else result.human.select(result.index)
        report = _report(held, row, result.objects, human, touching)
        reports.append(replace(report, **outcome(result, row)))
    words = f"Policy {result.policy}, protocol {result.spec.protocol}: {result.count()}."
    words += " The robot hand is drawn as it was in the middle of the hold, where there was one."
    made = page_provenance({}, result.spec.seeds[0])
    page = Page(
        "Lift test", reports, result.hand, f"{words} {MARKS_MEAN}" if result.knows_places else words, made
    )
    write_page(path, page, [rates_by_object(result), text_card("By object", result.table())])


def in_the_hold(result: LiftTestResult) -> RobotGraspSet:
    """Return the grasp of each episode: in the middle of the hold if the object was held, else as given."""
    assert result.grasps is not None
    grasps, hold = result.grasps.select(result.index), result.hold
    if hold is None:
        return grasps
    held = result.success[:, None]
    return replace(
        grasps,
        wrist_pose=np.where(held, compose(grasps.object_pose, hold.palm_pose), grasps.wrist_pose),
        joint_positions=np.where(held, hold.joint_positions, grasps.joint_positions),
    )


def rates_by_object(result: LiftTestResult) -> str:
    """Return an SVG figure of the rates of success, and of success as shown, by object."""
    names, known = sorted(set(result.object_name.tolist())), result.knows_places
    which = [result.object_name == name for name in names]
    held = np.array([result.success[flags].mean() for flags in which])
    flags = result.outcomes.held_as_shown if known else result.success
    bars = RateBars(
        "Held as shown, with 95 % intervals; pale: held" if known else "Held, with 95 % intervals",
        names,
        np.array([flags[each].mean() for each in which]),
        np.array([wilson_interval(int(flags[each].sum()), int(each.sum())) for each in which]),
        [result.count(each) for each in which],
        held if known else None,
    )
    return f"<figure>{rates_svg(bars)}</figure>"


def _report(
    grasps: HumanGraspSet | RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    human: HumanGraspSet | None = None,
    touching: np.ndarray | None = None,
) -> GraspReport:
    """Return the report of one grasp. Arguments as for ``grasp_pictures`` and ``place_marks``."""
    grasp, marks = grasps[row], None
    if isinstance(grasps, RobotGraspSet):
        marks = place_marks(grasps, row, objects, touching)
    pictures = grasp_pictures(grasps, row, objects, SIZE, human, marks)
    return GraspReport(
        grasp_title(grasp),
        object_mass=float(grasp.object_mass),
        outcome="" if marks is None else f"As shown: {marks.words}.",
        human_picture=pictures[0] if isinstance(grasp, HumanGrasp) or human is not None else None,
        robot_picture=pictures[-1] if isinstance(grasp, RobotGrasp) else None,
    )


def grasp_title(grasp: HumanGrasp | RobotGrasp) -> str:
    """ "Spray bottle, to spray"."""
    name = grasp.object_name.replace("_", " ")
    return f"{name[:1].upper()}{name[1:]}{f', to {grasp.task}' if grasp.task else ''}"


def outcome(result: LiftTestResult, row: int) -> dict[str, Any]:
    """Return ``success``, ``as_shown`` and ``outcome`` of an episode for a ``GraspReport``."""
    o, known = result.outcomes, bool(np.isfinite(result.outcomes.place_error_mm[row]))
    success, as_shown = bool(o.success[row]), bool(o.held_as_shown[row])
    how = "with a plan that was chosen in simulated rollouts" if result.rollouts[row] else "at the first try"
    words = f"Lifted and held for 3 s, {how}." if success else f"It did not hold: {o.reason[row]}."
    if success and known and result.grasps is not None:
        wanted = int(result.grasps.link_contacts[result.index[row], 1:].sum())
        number = f"{o.shown_share[row] * wanted:.0f} of {wanted} links, {o.place_error_mm[row]:.0f} mm"
        but = f"Held, but not as shown: {o.not_as_shown[row]} ({number})."
        words += f" Held as shown: {number}." if as_shown else f" {but}"
    return {"success": success, "as_shown": as_shown if known else None, "outcome": words}


def use_outcome(use: UseOutcomes, row: int) -> str:
    """Return the outcome of a use test in a sentence. row: row of the grasp in ``use``."""
    motion = str(use.motion[row]).replace("_", " ")
    moved = f"by {1e3 * use.shift_m[row]:.0f} mm and {np.rad2deg(use.turn_rad[row]):.0f}°"
    if use.success[row]:
        return f"Use ({motion}): passed, moved {moved} in the palm."
    return f"Use ({motion}): failed, {use.reason[row]}."


def contacts(robot: RobotGrasp, trajectory: Trajectory, hand: Hand) -> list[Contact]:
    """Return the links that should touch the object or do so during more than half of the hold."""
    hold = trajectory.phase == trajectory.phase.max()
    reached = trajectory.link_contacts[hold].mean(axis=0) > 0.5
    return [
        Contact(name, bool(target), bool(touches))
        for name, target, touches in zip(hand.link_names, robot.link_contacts, reached, strict=True)
        if target or touches
    ]


def quantities(quality: StaticQuality, result: LiftTestResult, row: int) -> list[Quantity]:
    """Return the numbers of one grasp: static quality, then measurements in simulation."""
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
"""Number of grasps that are drawn."""

ROWS = 8
"""Maximum number of table rows."""


def notebook_html(value: Any) -> str | None:
    """Return the HTML of grasps, plans or a result; None for other types."""
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
    """Return pictures of a few grasps, or "" if an object can't be loaded."""
    chosen = spread_rows(grasps.object_name, PICTURES)
    try:
        objects = load_objects(grasps.select(np.array(chosen)))
        drawn = [grasp_pictures(grasps, row, objects, (280, 210))[0] for row in chosen]
    except FungraspError:
        return ""
    labels = [str(grasps.object_name[row]) for row in chosen]
    return figure(grid(drawn, labels, columns=PICTURES), f"{len(chosen)} of {len(grasps)} grasps")


def _plans(plans: GraspPlan) -> str:
    expected = (plans.expected_success, plans.expected_as_shown)
    rows = [
        (
            str(row),
            str(plans.object_name[row]),
            f"{plans.control_period * int(plans.closing_step[row]):.1f} s",
            f"{plans.control_period * int(plans.lift_step[row]):.1f} s",
            *("–" if each is None else f"{100 * float(each[row]):.0f} %" for each in expected),
        )
        for row in range(min(len(plans), ROWS))
    ]
    heads = ("row", "object", "closes at", "lifts at", "expected success", "expected as shown")
    return f"{escape(f'<GraspPlan: {len(plans)} plans>')}{_table(heads, rows, len(plans))}"


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]], count: int) -> str:
    """Return a table and the number of omitted rows."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    more = f"<p>and {count - len(rows)} more</p>" if count > len(rows) else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"
