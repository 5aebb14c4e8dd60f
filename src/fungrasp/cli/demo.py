"""``fungrasp demo``: retarget, test and show a few human grasps, one of which is from an image."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fungrasp.cli.console import LOW_CONFIDENCE, Answering, CommandResult, progress_bar
from fungrasp.cli.options import GraspsOption, optional_value
from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.media.demonstration import Shown
    from fungrasp.perception.perceived import Perceived

FAVORITES = ("drill:drill", "mug:hand over", "flashlight:light", "bottle:pour")
"""Grasps to show without --grasp, if the file has them."""

RENDERED = "<p>The image is rendered, not a photograph, so the true poses are known.</p>"

Folder = Annotated[str | None, optional_value("[FOLDER]", "builtin", "folder")]
"""An option with an optional value."""


@dataclass(frozen=True)
class Demo(GraspsOption, Answering):
    """Grasp a few built-in objects, and with hand models the object in the built-in image; write a film and a
    page."""

    hand: str = "allegro"
    """Name of a hand, or the path of its TOML file."""
    grasp: tuple[str, ...] = ()
    """Grasps to show: an object ("mug"), object and task ("mug:drink") or a row number. Default: a few
    different ones and the built-in image."""
    count: int = 3
    """Number of grasps to show without --grasp, including the image."""
    from_image: Folder = None
    """Show only the grasp in an RGB-D image: the built-in image, or a folder with rgb.png, depth.png and
    K.json. Replaces --grasps, --objects, --grasp and --count."""
    mesh: str | None = None
    """The object in the image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]. Default: known for built-in objects."""
    task: str = ""
    """Purpose of the grasp in the image: "drink", "hand over" ..."""
    policy: str | None = None
    """Policy that moves the hand: "reference" (planned motion, open loop) or a learned one (`fungrasp
    policies list`). Default: the freely licensed student of the hand, or "reference" if there is none."""
    seed: int = 0
    """Random seed of perception."""
    out: Path = Path("demo")
    """Folder for film and page."""
    threads: int = 0
    """0 means all processors; results are the same for any number."""

    def run(self) -> CommandResult:
        from fungrasp.hands import load_hand
        from fungrasp.policies import default_policy, policy_source

        self._check()
        hand = load_hand(self.hand)
        policy = self.policy or default_policy(hand.name)
        policy_source(policy, hand.name)
        folder = self.from_image or self._usual_image()
        picked = None
        if self.from_image is None:
            picked = self._picked(self.count if folder is None else max(self.count - 1, 1))
        seen = None
        if folder is not None:
            seen = self._seen(folder, None if picked is None else lambda: _compile(picked, self.hand))
            for note in seen.notes:
                print(note, file=sys.stderr)
            if not seen.confident:
                print(f"fungrasp: {seen.acceptance.summary()}: the robot does not try it", file=sys.stderr)
                if picked is None:
                    return self._page_of_low_confidence(seen)
        from fungrasp.media.demonstration import demonstrate

        shown = _joined(picked, seen if seen is not None and seen.confident else None, folder)
        made = demonstrate(
            shown, hand, policy, self.out, seed=self.seed, threads=self.threads, stages=progress_bar
        )
        lines = [
            f"{report.title}: {' '.join(filter(None, (report.outcome, report.use_outcome)))}"
            for report in made.grasps
        ]
        told = ("title", "success", "as_shown", "outcome", "use_success", "use_outcome")
        grasps = [
            {"object_name": grasp.object_name, "task": grasp.task}
            | {name: getattr(report, name) for name in told}
            for grasp, report in zip(shown.human, made.grasps, strict=True)
        ]
        value = {"film": made.film, "page": made.page, "grasps": grasps}
        return CommandResult(value, "\n".join([*lines, f"film: {made.film}", f"page: {made.page}"]))

    def _picked(self, count: int) -> Shown:
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.grasp_arguments import picked_rows
        from fungrasp.media.demonstration import Shown

        everything = load_human_grasps(self.grasps)
        rows = picked_rows(everything, self.grasp, count, FAVORITES)
        human = everything.select(rows)
        source = {"Grasps": f"{self.grasps}, rows {', '.join(map(str, rows))}"}
        return Shown(human, load_objects(human, self.objects), source)

    def _usual_image(self) -> str | None:
        """Return the built-in image if no other grasps are requested and the hand models are installed."""
        from importlib.util import find_spec

        from fungrasp.perception.hand.mediapipe_models import have_weights
        from fungrasp.perception.io.scene_folders import BUILTIN

        usual = not self.grasp and self.grasps == Demo.grasps
        return BUILTIN if usual and find_spec("ai_edge_litert") and have_weights() else None

    def _seen(self, folder: str, meanwhile: Callable[[], None] | None) -> Perceived:
        """Perceive an image. meanwhile: work for this process at the same time, or None."""
        from fungrasp.perception.pipeline import perceive_folder

        arguments = (folder, self.mesh, self.mass, self.task, self.seed)
        with progress_bar("looking at the image", 1) as show:
            if meanwhile is None:
                seen = perceive_folder(*arguments)
            else:
                # A process, not a thread: compilation in the first run cannot run in parallel threads.
                from concurrent.futures import ProcessPoolExecutor
                from multiprocessing import get_context

                with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                    looking = pool.submit(perceive_folder, *arguments)
                    meanwhile()
                    seen = looking.result()
            show(1)
        return seen

    def _page_of_low_confidence(self, seen: Perceived) -> CommandResult:
        """Write the perception page; the robot does not try a grasp with low confidence."""
        from fungrasp.core.provenance import page_provenance
        from fungrasp.media.perception_page import write_perception_page

        page = self.out / "index.html"
        write_perception_page(page, seen, page_provenance({"Image": str(self.from_image)}, self.seed))
        for warning in seen.warnings:
            logging.getLogger(__name__).warning(warning)
        return CommandResult({"page": page, "grasps": []}, f"page: {page}", status=LOW_CONFIDENCE)

    def _check(self) -> None:
        least = {"count": 1, "seed": 0, "threads": 0}
        for name, value in least.items():
            if getattr(self, name) < value:
                raise FungraspError(f"--{name} must be at least {value}, not {getattr(self, name)}")
        if self.from_image is None:
            idle = {"--mesh": self.mesh, "--mass": self.mass, "--task": self.task}
            needs = "--from-image FOLDER"
        else:
            other = self.grasps if self.grasps != Demo.grasps else None
            idle = {"--grasps": other, "--objects": self.objects, "--grasp": self.grasp}
            needs = "grasps, not an image"
        for name, value in idle.items():
            if value:
                raise FungraspError(f"{name} needs {needs}")


def _compile(picked: Shown, hand: str) -> None:
    """Compile the solver by retargeting the first grasp."""
    from fungrasp.retargeting import retarget

    retarget(picked.human.select([0]), picked.objects, hand, threads=1)


def _joined(picked: Shown | None, seen: Perceived | None, folder: str | None) -> Shown:
    """Join the picked grasps and the perceived one."""
    from html import escape

    from fungrasp.grasps import HumanGraspSet
    from fungrasp.media.demonstration import Shown
    from fungrasp.media.perception_page import perception_parts, perception_title, true_errors
    from fungrasp.perception.io.scene_folders import BUILTIN, builtin_truth

    if seen is None:
        assert picked is not None
        return picked
    known = folder == BUILTIN
    parts = perception_parts(seen, true_errors(builtin_truth(), seen) if known else ())
    rendered = RENDERED if known else ""
    head = f'<header class="top"><h2>{escape(perception_title(seen))}</h2>{rendered}</header>'
    source = {"Image": "the built-in one" if known else str(folder)}
    if picked is None:
        return Shown(seen.grasps, seen.objects, source, {0: [head, *parts]})
    human = HumanGraspSet.of([*picked.human, *seen.grasps])
    before = {len(picked.human): [head, *parts]}
    return Shown(human, {**picked.objects, **seen.objects}, {**picked.source, **source}, before)


COMMAND = Demo
