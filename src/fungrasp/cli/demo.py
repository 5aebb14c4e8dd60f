"""``fungrasp demo``: a few human grasps, or the one in an image, retargeted, tried and shown."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fungrasp.cli.console import Answer, Answering, progress_bar
from fungrasp.cli.options import optional_value

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.media.demonstration import Demonstration, Opening
    from fungrasp.perception.perceived import Perceived

FAVORITES = ("drill:drill", "mug:hand over", "flashlight:light", "bottle:pour")
"""What is shown if nothing is picked, as far as the grasps have it."""

LOW_CONFIDENCE = 3
"""Exit status when the page was written but the robot did not try the grasp."""

Folder = Annotated[str | None, optional_value("[FOLDER]", "builtin", "folder")]
"""An option with or without a value."""


@dataclass(frozen=True)
class Demo(Answering):
    """Grasp a few objects as people do, and show it: a film and a page."""

    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    pick: tuple[str, ...] = ()
    """Grasps to show: an object ("mug"), object and task ("mug:drink") or a number; else a varied few."""
    count: int = 3
    """How many to show if none are picked."""
    from_image: Folder = None
    """Start from an image with depth of a person holding an object: the built-in one, or that of a folder
    with rgb.png, depth.png and K.json. It takes the place of --grasps, --objects, --pick and --count."""
    mesh: str | None = None
    """The object in the folder's image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]; a built-in one has its own."""
    task: str = ""
    """What the grasp in the folder's image is for: "drink", "hand over" ..."""
    policy: str | None = None
    """What moves the hand: "reference" (the planned motion, open loop) or a policy (`fungrasp policies
    list`). By default the freely licensed student of the hand, or "reference" if there is none."""
    seed: int = 0
    """Seed of what is perceived in an image."""
    out: Path = Path("demo")
    """Folder for the film and the page."""
    threads: int = 0
    """0 means all processors; the grasps do not depend on it."""

    def run(self) -> Answer:
        from fungrasp.hands import load_hand

        self._check()
        hand = load_hand(self.hand)
        policy = self._policy(hand)
        shown = self._from_grasps(hand, policy) if self.from_image is None else self._from_image(hand, policy)
        if isinstance(shown, Answer):
            return shown
        lines = [
            f"{report.title}: {' '.join(filter(None, (report.outcome, report.use_outcome)))}"
            for report in shown.grasps
        ]
        told = ("title", "object_name", "task", "success", "outcome", "use_success", "use_outcome")
        grasps = [{name: getattr(report, name) for name in told} for report in shown.grasps]
        value = {"film": shown.film, "page": shown.page, "grasps": grasps}
        return Answer(value, "\n".join([*lines, f"film: {shown.film}", f"page: {shown.page}"]))

    def _from_grasps(self, hand: Hand, policy: str) -> Demonstration:
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.grasps.picks import picked_rows
        from fungrasp.media.demonstration import Opening, demonstrate

        everything = load_human_grasps(self.grasps)
        rows = picked_rows(everything, self.pick, self.count, FAVORITES)
        human = everything.select(rows)
        source = {"Policy": policy, "Grasps": f"{self.grasps}, rows {', '.join(map(str, rows))}"}
        return demonstrate(
            human,
            load_objects(human, self.objects),
            hand,
            policy,
            self.out,
            opening=Opening(source=source),
            seed=self.seed,
            threads=self.threads,
            stages=progress_bar,
        )

    def _from_image(self, hand: Hand, policy: str) -> Demonstration | Answer:
        from fungrasp.media.demonstration import demonstrate

        with progress_bar("looking at the image", 1) as show:
            seen, opening = self._seen(policy)
            show(1)
        for note in seen.notes:
            print(note)
        if not seen.confident:
            return self._page_of_low_confidence(seen, opening)
        return demonstrate(
            seen.grasps,
            seen.objects,
            hand,
            policy,
            self.out,
            opening=opening,
            seed=self.seed,
            threads=self.threads,
            stages=progress_bar,
        )

    def _seen(self, policy: str) -> tuple[Perceived, Opening]:
        """What is in the image, and what the page says of it."""
        from fungrasp.media.perception_page import perceived_opening, true_errors
        from fungrasp.perception.io.scene_folders import BUILTIN, builtin_truth
        from fungrasp.perception.pipeline import perceive_folder

        folder = self.from_image
        assert folder is not None
        seen = perceive_folder(folder, self.mesh, self.mass, self.task, self.seed)
        known = folder == BUILTIN
        errors = true_errors(builtin_truth(), seen) if known else []
        image = "the built-in one" if known else folder
        return seen, perceived_opening(seen, {"Policy": policy, "Image": image}, errors)

    def _page_of_low_confidence(self, seen: Perceived, opening: Opening) -> Answer:
        """Write the page on what was seen: the robot does not try a grasp of low confidence."""
        from fungrasp.core.provenance import page_provenance
        from fungrasp.media.perception_page import write_perception_page

        page = self.out / "index.html"
        write_perception_page(page, seen, page_provenance(opening.source or {}, self.seed))
        for warning in seen.warnings:
            print(f"fungrasp: warning: {warning}", file=sys.stderr)
        print(f"fungrasp: {seen.acceptance.summary()}: the robot does not try it", file=sys.stderr)
        return Answer({"page": page, "grasps": []}, f"page: {page}", status=LOW_CONFIDENCE)

    def _check(self) -> None:
        from fungrasp.core.errors import FungraspError

        least = {"count": 1, "seed": 0, "threads": 0}
        for name, value in least.items():
            if getattr(self, name) < value:
                raise FungraspError(f"--{name} must be at least {value}, not {getattr(self, name)}")
        if self.from_image is None:
            idle = {"--mesh": self.mesh, "--mass": self.mass, "--task": self.task}
            needs = "--from-image FOLDER"
        else:
            other = self.grasps if self.grasps != "builtin" else None
            idle = {"--grasps": other, "--objects": self.objects, "--pick": self.pick}
            needs = "grasps, not an image"
        for name, value in idle.items():
            if value:
                raise FungraspError(f"{name} needs {needs}")

    def _policy(self, hand: Hand) -> str:
        """The name of what moves the hand.

        Raises:
            FungraspError: there is no such policy.
        """
        from fungrasp.policies import default_policy, policy_files

        if self.policy is None:
            return default_policy(hand.name)
        policy_files(self.policy, hand.name)
        return self.policy


COMMAND = Demo
