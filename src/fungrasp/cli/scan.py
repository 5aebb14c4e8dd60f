"""``fungrasp scan``: the mesh of an object out of a few images with depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fungrasp.cli.console import Answer, Answering, table

MESHES = (".ply", ".obj", ".stl", ".glb")
"""Kinds of files that can be written; ``.ply`` and ``.glb`` keep the colors."""


@dataclass(frozen=True)
class Scan(Answering):
    """Make a mesh of an object from images with depth of it, taken from all round: 8 to 16, at most 45
    degrees apart.

    The object stands on a newspaper on a table, in the middle of the image, and stays as it stands; the
    camera is moved around it and found again by the print. Or it stands with a printed sheet on a turntable
    that fills the image. The side on which the object stands is closed straight down, what no image shows
    is filled.
    """

    folders: tuple[Path, ...]
    """A folder for each image, in order, see `fungrasp perceive --folder`; or one folder that has such
    folders."""
    out: Path = Path("scan.ply")
    """Write the mesh here: .ply, .obj, .stl or .glb."""
    cell: float = 0.002
    """Size of the finest thing that is kept [m]."""
    seed: int = 0
    """The same seed gives the same mesh."""

    def run(self) -> Answer:
        import numpy as np

        from fungrasp.core.errors import FungraspError
        from fungrasp.core.files import atomic_path
        from fungrasp.perception.io.scene_folders import read_folder
        from fungrasp.perception.scan import ScanSettings, scan_object

        if self.out.suffix.lower() not in MESHES:
            raise FungraspError(f"--out must end in one of {', '.join(MESHES)}, not '{self.out.suffix}'")
        settings = ScanSettings(self.cell, self.seed)
        scan = scan_object([read_folder(folder) for folder in self._views()], settings)
        with atomic_path(self.out) as path:
            scan.mesh.export(path, file_type=self.out.suffix.lower()[1:])
        rows = [("view", "turned [deg]", "off the others [mm]")]
        for i, (yaw, off) in enumerate(zip(scan.yaws, scan.residuals, strict=True), start=1):
            rows.append((str(i), f"{np.degrees(yaw) % 360:.0f}", f"{1000 * off:.1f}" if i > 1 else ""))
        size = " x ".join(f"{1000 * edge:.0f}" for edge in scan.mesh.extents)
        value = {
            "mesh": self.out,
            "size": scan.mesh.extents,
            "triangles": len(scan.mesh.faces),
            "volume": scan.mesh.volume,
            "watertight": scan.mesh.is_watertight,
            "yaws": scan.yaws,
            "residuals": scan.residuals,
        }
        return Answer(
            value,
            f"{table(rows)}\n{self.out}: {size} mm, "
            f"{len(scan.mesh.faces)} triangles, {1e6 * scan.mesh.volume:.0f} cm3, "
            f"{'closed' if scan.mesh.is_watertight else 'not closed'}",
        )

    def _views(self) -> list[Path]:
        """The folders, or those in the only one given, by name."""
        if len(self.folders) != 1:
            return list(self.folders)
        inner = sorted(path for path in self.folders[0].glob("*") if path.is_dir())
        return inner or list(self.folders)


COMMAND = Scan
