"""What a page gives to be kept: the robot's grasp, a picture."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import save_robot_grasps
from fungrasp.viewer.page import BrowserPage
from fungrasp.viewer.robot_view import RobotView


def add_downloads(page: BrowserPage, robot: Callable[[], RobotView | None]) -> None:
    """Buttons that save a grasp and a picture.

    Args:
        page: in whose controls they are put.
        robot: gives what is shown now; None if nothing is.
    """
    gui = page.client.gui
    with gui.add_folder("Keep", expand_by_default=False):
        grasp = gui.add_button("Save grasp (.npz)")
        picture = gui.add_button("Save picture (.png)")
    grasp.on_click(lambda _: page.worker.ask("save", lambda: _save_grasp(page, robot())))
    picture.on_click(lambda _: page.worker.ask("picture", lambda: _save_picture(page, robot())))


def _save_grasp(page: BrowserPage, robot: RobotView | None) -> None:
    if robot is None or robot.grasp is None:
        raise FungraspError("there is no robot grasp yet")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "grasp.npz"
        save_robot_grasps(file, robot.grasp_set())
        page.client.send_file_download(f"{robot.model.name}-{robot.hand.name}.npz", file.read_bytes())


def _save_picture(page: BrowserPage, robot: RobotView | None) -> None:
    from PIL import Image

    try:
        picture = page.client.get_render(720, 1280, transport_format="png", timeout=20.0)
    except (RuntimeError, TimeoutError) as error:
        raise FungraspError(f"the browser gave no picture: {error}") from error
    background = np.full((*picture.shape[:2], 4), 255, np.uint8)
    whole = Image.alpha_composite(Image.fromarray(background), Image.fromarray(picture))
    buffer = io.BytesIO()
    whole.convert("RGB").save(buffer, "PNG")
    name = "picture" if robot is None else robot.model.name
    page.client.send_file_download(f"{name}.png", buffer.getvalue())
