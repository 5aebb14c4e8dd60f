"""``fungrasp robots calibrate``: the pose of a cell's camera."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import Answering, CommandResult
from fungrasp.cli.options import CellName
from fungrasp.core.errors import FungraspError
from fungrasp.robots.calibration.camera import Board

if TYPE_CHECKING:
    from fungrasp.robots.calibration.camera import CameraCalibration
    from fungrasp.robots.cell import RobotCell


@dataclass(frozen=True)
class Calibrate(Answering):
    """Calibrate the fixed camera of a cell from images of a board in the hand. The result, the pose of the
    camera in the world frame, is written to a file for the cell."""

    cell: CellName
    """A built-in robot cell, or a TOML file."""
    out: Path
    """File to write (.toml)."""
    images: Path
    """Folder with images of the board, arm.json (arm joints [rad] by image file name) and camera.json
    (intrinsics)."""
    board: Board = field(default_factory=Board)
    """Calibration board."""

    def run(self) -> CommandResult:
        from fungrasp.robots.calibration.camera import save_calibration
        from fungrasp.robots.cell import load_cell

        found, source = self._from_images(load_cell(self.cell), self.images)
        save_calibration(self.out, found, source)
        place = ", ".join(f"{x:.4f}" for x in found.pose_world_camera[:3])
        text = (
            f"camera at ({place}) m from {source}; residual {1000 * found.residual:.2f} mm\n"
            f"standard deviation {1000 * found.position_deviation:.1f} mm, "
            f"{1000 * found.rotation_deviation:.2f} mrad\n"
            f"written to {self.out}: set 'calibration' to it under [tracker] in the cell file"
        )
        return CommandResult({"calibration": self.out, "source": source, **asdict(found)}, text)

    def _from_images(self, cell: RobotCell, folder: Path) -> tuple[CameraCalibration, str]:
        import numpy as np

        from fungrasp.core.formats.text_files import read_json
        from fungrasp.hands import load_hand
        from fungrasp.perception.io.image_files import read_color
        from fungrasp.perception.io.intrinsics_files import read_intrinsics
        from fungrasp.robots.calibration.camera import BoardView, calibrate_from_board, find_corners
        from fungrasp.robots.kinematics.arm_model import ArmKinematics

        arm = ArmKinematics(cell, load_hand(cell.hand))
        path = folder / "arm.json"
        joints = read_json(path, "joints of the arm by image")
        if not isinstance(joints, dict) or not joints:
            raise FungraspError(f"{path} must hold arm joints by image file name")
        views = []
        for name, values in joints.items():
            numbers = values if isinstance(values, list) else []
            real = [v for v in numbers if isinstance(v, int | float) and np.isfinite(v)]
            if len(numbers) != len(arm.lower) or len(real) != len(numbers):
                raise FungraspError(f"{path}: '{name}' must have {len(arm.lower)} joints [rad]")
            color = read_color(folder / name)
            points, pixels = find_corners(color, self.board)
            views.append(BoardView(arm.palm_pose(np.array(real)), points, pixels))
            size = color.shape[1], color.shape[0]
        lens = read_intrinsics(folder / "camera.json", size).intrinsics
        used = sum(len(view.points) > 0 for view in views)
        return calibrate_from_board(views, lens), f"{used} of {len(views)} images of a board"
