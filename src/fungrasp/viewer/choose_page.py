"""Which page shows what: by what it is, or by what the file holds."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.evaluation import LiftTestResult, Trajectory, read_result, replay
from fungrasp.grasps import (
    HumanGrasp,
    HumanGraspSet,
    RobotGrasp,
    RobotGraspSet,
    load_grasps,
    load_objects,
)
from fungrasp.grasps.grasp_arguments import Objects, as_grasp_set, named_objects, resolve_objects
from fungrasp.hands import Hand, hand_origin, load_hand
from fungrasp.hands.hand_registry import hand_files
from fungrasp.task import GraspPlan

if TYPE_CHECKING:
    from viser import ClientHandle

    from fungrasp.viewer.grasp_page import PickableGrasps
    from fungrasp.viewer.page import BrowserPage

Maker = Callable[["ClientHandle"], "BrowserPage"]
"""Makes what a browser sees."""


@dataclass(frozen=True)
class ChosenPage:
    """The page of something."""

    title: str
    """Of the browser's tab."""
    make: Maker
    """Makes what a browser sees."""
    prepare: Callable[[], None] | None = None
    """Loads what is to be there when the first browser comes; None if nothing is."""


def choose_page(what: Any, objects: Objects, hand: str | Hand) -> ChosenPage:
    """The page of something. Everything is read here, so that mistakes are met before the
    server runs.

    Args:
        what: see ``view``.
        objects: those of grasps or plans, as for ``retarget``.
        hand: that imitates human grasps at first.

    Raises:
        FungraspError: it can't be viewed.
    """
    if isinstance(what, str | Path):
        what = _read(what)
    if what is None:
        what = load_grasps("builtin")
    if isinstance(what, HumanGrasp | RobotGrasp):
        what = as_grasp_set(what)
    if isinstance(what, HumanGraspSet):
        from fungrasp.viewer.grasp_page import GraspPage, PickableGrasps

        if not len(what):
            raise FungraspError("there are no grasps to view: the set is empty")
        name = (hand_origin(hand) or hand.name) if isinstance(hand, Hand) else hand
        load_hand(name)
        choice = PickableGrasps(what, resolve_objects(what, objects), name)
        return ChosenPage("Grasps", partial(GraspPage, choice=choice), partial(_load_solver, choice))
    if isinstance(what, RobotGraspSet):
        from fungrasp.viewer.robot_grasps_page import RobotGraspsPage

        if not len(what):
            raise FungraspError("there are no grasps to view: the set is empty")
        what.load_hand()
        make = partial(RobotGraspsPage, grasps=what, objects=resolve_objects(what, objects))
        return ChosenPage("Robot grasps", make)
    if isinstance(what, LiftTestResult):
        from fungrasp.viewer.result_page import ResultPage, ShownResult

        return ChosenPage("Result", partial(ResultPage, shown=ShownResult.of(what)))
    if isinstance(what, Trajectory):
        from fungrasp.viewer.result_page import RecordingPage

        known = named_objects([what.object_name], [what.object_mass], objects)
        return ChosenPage("Episode", partial(RecordingPage, trajectory=what, objects=known))
    if isinstance(what, GraspPlan):
        from fungrasp.viewer.plan_page import PlanPage

        load_hand(what.hand)
        known = named_objects(what.object_name.tolist(), what.object_mass.tolist(), objects)
        return ChosenPage("Plans", partial(PlanPage, plans=what, objects=known))
    from fungrasp.perception.perceived import Perceived

    if isinstance(what, Perceived):
        from fungrasp.viewer.capture_page import CapturePage

        return ChosenPage("Capture", partial(CapturePage, capture=what.capture, perceive=lambda: what))
    if isinstance(what, Hand):
        from fungrasp.viewer.hand_page import HandPage

        return ChosenPage(what.title, partial(HandPage, path=what.path))
    if isinstance(what, ChosenPage):
        return what
    raise FungraspError(
        "grasps, plans, a result, a recorded episode, what was perceived, a hand, or the path of one of "
        f"their files, of a deployment's log or of a capture can be viewed, not a {type(what).__name__}"
    )


def _load_solver(choice: PickableGrasps) -> None:
    from fungrasp.retargeting import retarget

    # RuntimeError: Python ends already, and begins no more threads.
    with contextlib.suppress(FungraspError, RuntimeError):
        first = choice.grasps.select(np.array([choice.row]))
        retarget(first, choice.objects, choice.hand, threads=1)


def _read(what: str | Path) -> Any:
    """What a file or folder holds: something to view, or what makes its page."""
    name, path = str(what), Path(what)
    if name == "builtin":
        return load_grasps(name)
    if not path.exists() and name in hand_files():
        return load_hand(name)
    if path.is_dir():
        if (path / "hand.toml").is_file():
            return _hand(path / "hand.toml")
        return _capture(path)
    if not path.exists():
        raise FungraspError(f"there is no file, folder or hand '{what}' to view")
    if path.suffix == ".toml":
        return _hand(path)
    if path.suffix == ".json":
        from fungrasp.viewer.result_page import ResultPage, ShownResult

        return ChosenPage("Result", partial(ResultPage, shown=ShownResult.read(path, read_result(path))))
    if path.suffix == ".mcap":
        from fungrasp.deployment.log import read_log
        from fungrasp.viewer.log_page import LogPage, check_log

        log = read_log(path)
        check_log(log, path)
        return ChosenPage("Deployment", partial(LogPage, log=log))
    if path.suffix == ".npz":
        fields = read_npz(path, "file", ("qpos", "closing_step").__contains__)
        if "qpos" in fields:
            return replay(path)
        if "closing_step" in fields:
            return GraspPlan.load(path)
        return load_grasps(path)
    raise FungraspError(
        f"{path}: a .npz of grasps, plans or an episode, a result .json, a log .mcap, a hand .toml or the "
        "folder of a capture can be viewed"
    )


def _hand(path: Path) -> Any:
    from fungrasp.viewer.hand_page import HandPage

    return ChosenPage(path.parent.name, partial(HandPage, path=path))


def _capture(folder: Path) -> Any:
    from fungrasp.perception.io.scene_folders import read_folder
    from fungrasp.viewer.capture_page import CapturePage

    return ChosenPage("Capture", partial(CapturePage, capture=read_folder(folder), perceive=None))


def perceived_capture(folder: str, mesh: str) -> Any:
    """The page of a capture in which hand and object are looked for.

    Args:
        mesh: file of the object's mesh, or the name of a built-in object.

    Raises:
        FungraspError: no such folder or mesh, or the perception is not set up.
    """
    from fungrasp.objects.resolved_object import resolve_object
    from fungrasp.perception.io.scene_folders import read_folder
    from fungrasp.perception.pipeline import perceive
    from fungrasp.viewer.capture_page import CapturePage

    held = resolve_object(mesh, None)
    capture = read_folder(folder)
    return ChosenPage(
        "Capture", partial(CapturePage, capture=capture, perceive=lambda: perceive(capture, held))
    )


def shown_result(path: str, grasps: Path | None, objects: Path | None, recordings: Path | None) -> Any:
    """The page of a result whose files are somewhere else than they were.

    Raises:
        FungraspError: a file can't be read.
    """
    from fungrasp.grasps import load_robot_grasps
    from fungrasp.viewer.result_page import ResultPage, ShownResult

    shown = ShownResult.read(Path(path), read_result(path))
    if grasps is not None:
        robot = load_robot_grasps(grasps)
        shown = replace(shown, grasps=robot, objects=load_objects(robot, objects), missing="")
    if recordings is not None:
        if not recordings.is_dir():
            raise FungraspError(f"there is no folder {recordings} of recorded episodes")
        shown = replace(shown, recordings=recordings)
    return ChosenPage("Result", partial(ResultPage, shown=shown))
