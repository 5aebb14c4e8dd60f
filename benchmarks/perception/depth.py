"""``python -m benchmarks.perception depth``: how depth images look, measured ones beside rendered ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import progress_bar, table

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

    from fungrasp.perception import Intrinsics


@dataclass(frozen=True)
class BenchDepth:
    """Measure how outlines, holes and noise look in depth images: of a camera of yours, and of rendered
    captures.

    Rendered captures that look like your camera's tell what perception will do with it.
    """

    folders: tuple[Path, ...] = ()
    """Folders of captures, see `fungrasp perceive --folder`; together they are one column."""
    cameras: tuple[str, ...] = ("simple", "d435i", "d435i_filtered", "d435i_high_accuracy", "xtion", "tof")
    """Cameras as which captures are rendered; "simple" is what tests and the benchmark of perception have."""
    captures: int = 8
    """How many to render of each."""
    seed: int = 600
    """Decides the captures."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        from benchmarks.perception.depth_statistics import beside, depth_statistics
        from fungrasp.core.errors import FungraspError
        from fungrasp.perception.io.scene_folders import read_folder

        if self.captures < 1 or self.seed < 0:
            raise FungraspError(
                f"--captures must be at least 1 and --seed not negative, not {self.captures} and {self.seed}"
            )
        columns = []
        if self.folders:
            read = (read_folder(folder) for folder in self.folders)
            columns.append(("measured", depth_statistics((c.depth, c.intrinsics) for c in read)))
        with progress_bar("rendering", len(self.cameras)) as show:
            for i, camera in enumerate(self.cameras):
                columns.append((camera, depth_statistics(self._rendered(camera))))
                show(i + 1)
        if not columns:
            raise FungraspError("nothing to measure: give --folders or --cameras")
        rows = beside(columns)
        print(table(rows))
        if self.json is not None:
            self._write(self.json, rows)

    def _rendered(self, camera: str) -> Iterator[tuple[np.ndarray, Intrinsics]]:
        """Depth from 0.6 to 0.9 m and from above, as people look at a table."""
        from dataclasses import replace

        from benchmarks.synthetic_captures.capture_settings import CaptureSettings, camera_settings
        from benchmarks.synthetic_captures.render_capture import render_captures
        from fungrasp.grasps import builtin_grasps, load_objects

        settings = CaptureSettings() if camera == "simple" else camera_settings(camera)
        settings = replace(settings, distance=(0.6, 0.9), elevation=(45.0, 65.0))
        grasps = builtin_grasps()
        objects = load_objects(grasps, None)
        for known in render_captures(grasps, objects, self.captures, self.seed, settings):
            yield known.capture.depth, known.capture.intrinsics

    def _write(self, path: Path, rows: list[tuple[str, ...]]) -> None:
        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation.result_files import write_result

        head, *body = rows
        record = run_record(self.seed) | {"head": list(head)}
        write_result(path, record, [{f"c{i}": cell for i, cell in enumerate(row)} for row in body])
