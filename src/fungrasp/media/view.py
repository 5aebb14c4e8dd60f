"""What a verb has returned, as a page that needs no other file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.plots import RateBars, rates_svg
from fungrasp.core.provenance import page_provenance
from fungrasp.deployment.log import read_log
from fungrasp.evaluation import LiftTestResult
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGraspSet, load_objects
from fungrasp.media.deployment_page import write_deployment_page
from fungrasp.media.grasp_demo import grasp_title, outcome_words
from fungrasp.media.grasp_pictures import DRAWN_GRASPS, spread_rows
from fungrasp.media.grasp_scenes import grasp_scene
from fungrasp.media.page import GraspReport, Page, write_page
from fungrasp.media.page_parts import text_card
from fungrasp.media.perception_page import write_perception_page
from fungrasp.media.render import render
from fungrasp.media.viewpoints import look_at_grasp
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.perception.perceived import Perceived

WIDTH, HEIGHT = 560, 420
"""Size of each picture [pixels]."""


def write_view(what: Any, objects: Mapping[str, ObjectModel] | None, out: str | Path) -> Path:
    """Write a page about grasps, the result of a lift test, what was perceived, or a deployment.

    Args:
        what: human or robot grasps, of which a few of different objects are drawn; a result, of which some
            episodes of either outcome are; what ``perceive`` returned; or the path of a deployment's log.
        objects: those of grasps, by name; built-in objects if None. A result has its own.
        out: HTML file to write; it needs no other file and no network.

    Returns:
        The path of the page.

    Raises:
        FungraspError: something else, an object that is missing, or a file that can't be written.
    """
    path = Path(out)
    if isinstance(what, Perceived):
        write_perception_page(path, what, page_provenance({}, 0))
    elif isinstance(what, str | Path):
        write_deployment_page(path, read_log(Path(what)))
    elif isinstance(what, LiftTestResult):
        _write_result(path, what)
    elif isinstance(what, HumanGraspSet | RobotGraspSet):
        known = load_objects(what) if objects is None else objects
        check_objects(what.object_name.tolist(), known)
        rows = spread_rows(what.object_name)
        reports = [_report(what, row, known) for row in rows]
        hand = what.load_hand().title if isinstance(what, RobotGraspSet) else "Human hand"
        count = f"{len(rows)} of {len(what)} grasps" if len(rows) < len(what) else ""
        write_page(path, Page("Grasps", reports, hand, count, page_provenance({}, 0)))
    else:
        raise FungraspError(
            "a page on disk can be made of grasps, a result, what was perceived or the path of a "
            f"deployment's log, not of {'nothing' if what is None else 'a ' + type(what).__name__}"
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
    reports = [
        _report(
            grasps,
            int(result.index[row]),
            result.objects,
            bool(result.success[row]),
            outcome_words(
                bool(result.success[row]),
                str(result.outcomes.reason[row]),
                bool(result.rollouts[row]),
            ),
        )
        for row in rows
    ]
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


def grasp_picture(
    grasps: HumanGraspSet | RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    width: int = WIDTH,
    height: int = HEIGHT,
) -> np.ndarray:
    """A picture of one grasp.

    Args:
        grasps: human or robot ones.
        row: which.
        objects: theirs, by name.
        width, height: [pixels].

    Returns:
        sRGB, shape [height, width, 3] uint8.
    """
    grasp = grasps[row]
    hand = grasps.load_hand() if isinstance(grasps, RobotGraspSet) else None
    model, qpos = grasp_scene(grasp, objects[grasp.object_name], hand)
    return render(model, qpos, look_at_grasp(model, qpos, width=width, height=height))[0]


def _report(
    grasps: HumanGraspSet | RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    success: bool | None = None,
    outcome: str = "",
) -> GraspReport:
    """What the page says of one grasp, with its picture."""
    grasp, picture = grasps[row], grasp_picture(grasps, row, objects)
    is_human = isinstance(grasp, HumanGrasp)
    title, human, robot = grasp_title(grasp), picture if is_human else None, None if is_human else picture
    mass = float(grasp.object_mass)
    return GraspReport(
        title, object_mass=mass, success=success, outcome=outcome, human_picture=human, robot_picture=robot
    )
