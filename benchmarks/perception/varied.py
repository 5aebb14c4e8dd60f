"""``python -m benchmarks.perception varied``: captures as difficult as real ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.command import check_positive
from fungrasp.cli.console import progress_bar

if TYPE_CHECKING:
    from benchmarks.synthetic_captures.capture_settings import CaptureSettings
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class Varied:
    """Render captures with the errors of real cameras, left hands, hands of other sizes, rings, watches,
    faces and hands of other people, and half as many images without a hand; measure them like recorded
    ones."""

    keep: Path
    """Folder of the captures; those that are there already are not rendered again."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    captures: int = 20
    """How many to render, with a hand."""
    seed: int = 1000
    """Decides the captures."""
    json: Path | None = None
    """Write the numbers here (.json), each answer to a CSV file beside it."""

    def run(self) -> None:
        from benchmarks.perception.recorded import report_recorded
        from fungrasp.grasps import load_human_grasps, load_objects

        check_positive(captures=self.captures)
        human = load_human_grasps(self.grasps)
        render_varied(self.keep, human, load_objects(human, self.objects), self.captures, self.seed)
        report_recorded(self.keep, self.json)


def render_varied(
    folder: Path,
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    count: int,
    seed: int,
    settings: CaptureSettings | None = None,
) -> None:
    """Render a validation set: captures of grasps, and half as many without a hand. Those that are there
    already are not rendered again.

    Args:
        folder: where each gets a folder of its own.
        human: grasps of right hands.
        objects: by name.
        count: of captures of grasps.
        seed: decides everything.
        settings: by default varied ones.
    """
    from benchmarks.perception.capture_files import TRUTH_FILE, write_capture
    from benchmarks.perception.no_hand_capture import no_hand_capture
    from benchmarks.perception.scene_additions import varied_settings
    from benchmarks.synthetic_captures.render_capture import capture_at
    from fungrasp.objects import mirrored_name, mirrored_object
    from fungrasp.perception.io.scene_folders import LENS_FILE, write_folder

    settings = settings or varied_settings()
    empty = (count + 1) // 2
    with progress_bar("rendering", count + empty) as show:
        for i in range(count):
            place = folder / f"{seed}_{i:04d}"
            if not (place / TRUTH_FILE).is_file():
                known = capture_at(i, human, objects, seed, settings)
                # The grasp's row decides the object; of a left hand it is named after its mirror image.
                name = known.grasp.object_name
                model = (
                    objects[name] if known.side == "right" else mirrored_object(objects[mirrored_name(name)])
                )
                write_capture(known, place, model)
            show(i + 1)
        for i in range(empty):
            place = folder / f"{seed}_{i:04d}_no_hand"
            if not (place / LENS_FILE).is_file():
                write_folder(no_hand_capture(seed, i, settings)[0], place)
            show(count + i + 1)
