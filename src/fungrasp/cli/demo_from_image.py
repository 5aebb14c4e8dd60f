"""The part of ``fungrasp demo --from-image`` that ends with a human grasp."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from fungrasp.cli.optional_value import optional_value

if TYPE_CHECKING:
    from fungrasp.perception.perceived import Perceived
    from fungrasp.report import Quantity

BUILTIN = "builtin"
"""Stands for the image that comes with the package."""

LOW_CONFIDENCE = 3
"""Exit status when the page was written but the robot did not try the grasp."""

INTRODUCTION = (
    "One colour image with depth, and a mesh of the object, become a human grasp; the robot hand takes it "
    "over and tries it in simulation."
)

RENDERED = " The image is no photograph: it was rendered, which is why the truth is known."


Folder = Annotated[str | None, optional_value("[FOLDER]", BUILTIN, "folder")]
"""An option with or without a value."""


@dataclass(frozen=True, eq=False)
class SeenGrasp:
    """What was seen in an image."""

    perceived: Perceived
    """What ``perceive`` found in it."""
    source: str
    """Where the image came from, as text to print."""
    truth: Sequence[Quantity]
    """Errors, where the truth is known."""

    def opening(self) -> list[str]:
        """What the page says before the robot's grasp."""
        from fungrasp.report.perception_page import perception_parts

        return perception_parts(self.perceived, self.truth)


def seen_grasp(folder: str, mesh: str | None, mass: float | None, task: str, seed: int) -> SeenGrasp:
    """The grasp in an image.

    Args:
        folder: of the capture, see ``read_folder``, or ``BUILTIN``.
        mesh: a mesh file, or the name of a built-in object.
        mass: of the object [kg]; None takes a built-in object's own, or guesses it from the mesh.
        task: what the grasp is for.
        seed: the same seed gives the same grasp.

    Raises:
        FungraspError: the folder or the mesh is bad, no hand is seen, or the hand models are not set up.
    """
    from fungrasp.errors import FungraspError
    from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE
    from fungrasp.perception.pipeline import perceive
    from fungrasp.report.demo_capture import demo_truth, true_errors

    if folder == BUILTIN:
        if mesh is not None or mass is not None:
            raise FungraspError("the built-in image has its own object: --mesh and --mass need a folder")
        truth = demo_truth()
        perceived = perceive(BUILTIN_CAPTURE, truth.object_name, task=task or truth.task, seed=seed)
        return SeenGrasp(perceived, "the built-in one", true_errors(truth, perceived))
    if mesh is None:
        raise FungraspError(
            f"--from-image {folder}: --mesh must say what is held: a mesh file, or a built-in object's name"
        )
    return SeenGrasp(perceive(folder, mesh, mass=mass, task=task, seed=seed), folder, ())


def image_title(seen: SeenGrasp) -> str:
    """Title of the page."""
    from fungrasp.report.perception_page import perception_title

    return f"{perception_title(seen.perceived)}, taken over by a robot hand"


def image_words(seen: SeenGrasp) -> str:
    """Introduction under the page's title."""
    return INTRODUCTION + (RENDERED if seen.truth else "")


def write_low_confidence(path: Path, seen: SeenGrasp, provenance: Mapping[str, str]) -> NoReturn:
    """Write the page on what was seen, and end: the robot does not try a grasp of low confidence.

    Raises:
        SystemExit: always.
    """
    from fungrasp.report.perception_page import write_perception_page

    write_perception_page(path, seen.perceived, provenance)
    for warning in seen.perceived.warnings:
        print(f"fungrasp: warning: {warning}", file=sys.stderr)
    print("fungrasp: low confidence in the perceived grasp: the robot does not try it", file=sys.stderr)
    print(f"page: {path}")
    raise SystemExit(LOW_CONFIDENCE)
