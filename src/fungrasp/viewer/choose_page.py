"""Choice of a page by type or file content, from the list ``KINDS``."""

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
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet, load_grasps, load_objects
from fungrasp.grasps.grasp_arguments import Objects, as_grasp_set, named_objects
from fungrasp.hands import Hand, hand_origin, load_hand
from fungrasp.hands.hand_registry import hand_files
from fungrasp.task import GraspPlan

if TYPE_CHECKING:
    from viser import ClientHandle

    from fungrasp.perception.perceived import Perceived
    from fungrasp.viewer.grasp_page import PickableGrasps
    from fungrasp.viewer.page import BrowserPage

Maker = Callable[["ClientHandle"], "BrowserPage"]
"""Creates the page of a browser."""


@dataclass(frozen=True)
class ChosenPage:
    """A page to serve."""

    title: str
    """Title of the browser's tab."""
    make: Maker
    """Creates the page of a browser."""
    prepare: Callable[[], None] | None = None
    """Loads data before the first browser connects."""


def _human_grasps(grasps: HumanGraspSet, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.grasp_page import GraspPage, PickableGrasps

    name = (hand_origin(hand) or hand.name) if isinstance(hand, Hand) else hand
    load_hand(name)
    choice = PickableGrasps(grasps, load_objects(grasps, objects), name)
    return ChosenPage("Grasps", partial(GraspPage, choice=choice), partial(_load_solver, choice))


def _robot_grasps(grasps: RobotGraspSet, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.robot_grasps_page import RobotGraspsPage

    grasps.load_hand()
    make = partial(RobotGraspsPage, grasps=grasps, objects=load_objects(grasps, objects))
    return ChosenPage("Robot grasps", make)


def _plans(plans: GraspPlan, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.plan_page import PlanPage

    load_hand(plans.hand)
    known = named_objects(plans.object_name.tolist(), plans.object_mass.tolist(), objects)
    return ChosenPage("Plans", partial(PlanPage, plans=plans, objects=known))


def _result(result: LiftTestResult, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.result_page import ResultPage, ShownResult

    return ChosenPage("Result", partial(ResultPage, shown=ShownResult.of(result)))


def _episode(trajectory: Trajectory, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.result_page import RecordingPage

    known = named_objects([trajectory.object_name], [trajectory.object_mass], objects)
    return ChosenPage("Episode", partial(RecordingPage, trajectory=trajectory, objects=known))


def _perceived(seen: Perceived, objects: Objects, hand: str | Hand) -> ChosenPage:
    from fungrasp.viewer.capture_page import CapturePage

    return ChosenPage("Capture", partial(CapturePage, capture=seen.capture, perceive=lambda: seen))


def _npz(path: Path) -> HumanGraspSet | RobotGraspSet | GraspPlan | Trajectory:
    fields = read_npz(path, "file", ("qpos", "closing_step").__contains__)
    if "qpos" in fields:
        return replay(path)
    return GraspPlan.load(path) if "closing_step" in fields else load_grasps(path)


def _log_file(path: Path) -> ChosenPage:
    from fungrasp.deployment.log import read_log
    from fungrasp.viewer.log_page import LogPage, check_log

    log = read_log(path)
    check_log(log, path)
    return ChosenPage("Deployment", partial(LogPage, log=log))


def _hand_file(path: Path, title: str = "") -> ChosenPage:
    from fungrasp.viewer.hand_page import HandPage

    return ChosenPage(title or path.parent.name, partial(HandPage, path=path))


KINDS: dict[str, tuple[str, Callable[[Any, Objects, str | Hand], ChosenPage]]] = {
    "HumanGraspSet": ("human grasps", _human_grasps),
    "RobotGraspSet": ("robot grasps", _robot_grasps),
    "GraspPlan": ("plans", _plans),
    "LiftTestResult": ("a result", _result),
    "Trajectory": ("a recorded episode", _episode),
    "Perceived": ("what was perceived", _perceived),
    "Hand": ("a hand", lambda shown, objects, hand: _hand_file(shown.path, shown.title)),
}
"""Types that can be viewed, by class name to avoid imports: description, and function that creates the page
from the value, its objects and the initial hand for human grasps."""

FILES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    ".npz": ("grasps, plans or an episode", _npz),
    ".json": ("a result", lambda path: shown_result(path)),
    ".mcap": ("a deployment's log", _log_file),
    ".toml": ("a hand", _hand_file),
}
"""Contents of files by suffix, and their readers. A folder has a hand or a capture."""


def choose_page(what: Any, objects: Objects, hand: str | Hand) -> ChosenPage:
    """Return the page of a value or file. Files are read here, so that errors occur before the server starts.

    Args:
        what: see ``view``.
        objects: objects of grasps or plans, as for ``retarget``.
        hand: initial hand for human grasps.

    Raises:
        FungraspError: ``what`` can't be viewed.
    """
    if what is None or isinstance(what, str | Path):
        what = _read("builtin" if what is None else what)
    if isinstance(what, HumanGrasp | RobotGrasp | list):
        what = as_grasp_set(what)  # pyright: ignore[reportArgumentType]
    if isinstance(what, HumanGraspSet | RobotGraspSet) and not len(what):
        raise FungraspError("there are no grasps to view: the set is empty")
    if isinstance(what, ChosenPage):
        return what
    name = type(what).__name__
    if name not in KINDS:
        known = ", ".join(words for words, _ in KINDS.values())
        raise FungraspError(f"can't view a {name}; {known}, and their files, can be viewed")
    return KINDS[name][1](what, objects, hand)


def _load_solver(choice: PickableGrasps) -> None:
    from fungrasp.retargeting import retarget

    # RuntimeError: the interpreter is shutting down and starts no more threads.
    with contextlib.suppress(FungraspError, RuntimeError):
        first = choice.grasps.select(np.array([choice.row]))
        retarget(first, choice.objects, choice.hand, threads=1)


def _read(what: str | Path) -> Any:
    """Read a file or folder: a value to view, or its page."""
    name, path = str(what), Path(what)
    if name == "builtin":
        return load_grasps(name)
    if not path.exists():
        if name in hand_files():
            return load_hand(name)
        raise FungraspError(f"there is no file, folder or hand '{what}' to view")
    if path.is_dir():
        return _hand_file(path / "hand.toml") if (path / "hand.toml").is_file() else capture_page(path)
    if path.suffix not in FILES:
        known = ", ".join(f"{suffix} ({words})" for suffix, (words, _) in FILES.items())
        raise FungraspError(f"{path}: these files can be viewed: {known}; or the folder of a capture")
    return FILES[path.suffix][1](path)


def capture_page(folder: str | Path, mesh: str | None = None) -> ChosenPage:
    """Return the page of a capture.

    Args:
        mesh: file of the object's mesh or name of a built-in object, to detect hand and object. If None, only
            the image is shown.

    Raises:
        FungraspError: the folder or mesh does not exist, or perception is not set up.
    """
    from fungrasp.perception.io.scene_folders import read_folder
    from fungrasp.viewer.capture_page import CapturePage

    look = None
    if mesh is not None:
        from fungrasp.objects.resolved_object import resolve_object
        from fungrasp.perception.pipeline import perceive

        held = resolve_object(mesh, None)
        look = lambda: perceive(capture, held)  # noqa: E731
    capture = read_folder(folder)
    return ChosenPage("Capture", partial(CapturePage, capture=capture, perceive=look))


def shown_result(
    path: str | Path,
    grasps: Path | None = None,
    objects: Path | None = None,
    recordings: Path | None = None,
) -> ChosenPage:
    """Return the page of a result file. Its grasps, objects and recordings may have been moved.

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
