"""``python -m benchmarks.perception captures --varied``: captures as difficult as real ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.objects import ObjectModel
    from fungrasp.synthetic_captures.capture_settings import CaptureSettings


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
    from benchmarks.perception.no_hand_capture import no_hand_capture
    from fungrasp.objects import mirrored_name, mirrored_object
    from fungrasp.perception.io.scene_folders import LENS_FILE, write_folder
    from fungrasp.synthetic_captures.capture_files import TRUTH_FILE, write_capture
    from fungrasp.synthetic_captures.capture_settings import varied_settings
    from fungrasp.synthetic_captures.render_capture import capture_at

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
