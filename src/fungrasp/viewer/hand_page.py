"""Page of a hand: joints, key points, contact links, shapes and findings of the check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.adding.add_hand import check_hand_files
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.viewer.figures import RobotFigure
from fungrasp.viewer.page import BrowserPage, JointSliders, add_table, look_at

if TYPE_CHECKING:
    from viser import ClientHandle

STANDING = 0.1
"""Height of the hand's lowest point [m]."""


class HandPage(BrowserPage):
    """Page of a hand above the table with joint sliders."""

    def __init__(self, client: ClientHandle, path: Path):
        """
        Args:
            path: TOML file. If it can't be read, the page shows the findings.
        """
        super().__init__(client)
        self._path, self._figure, self._shapes = path, None, None
        self._marks: list[Any] = []
        self._sliders: JointSliders | None = None
        add_table(client, 0.8)
        self._title = client.gui.add_markdown(f"reading {path} …")
        self._what = client.gui.add_folder("Show")
        with self._what:
            self._collision = client.gui.add_checkbox("Collision shapes", False)
            self._links = client.gui.add_checkbox("Contact links", False, hint="Each in a color of its own")
            self._points = client.gui.add_checkbox(
                "Key points", False, hint="What human joints are compared with"
            )
        self._joints = client.gui.add_folder("Joints [rad]")
        self._findings = client.gui.add_markdown("")
        self._hand: Hand | None = None
        self._height = 0.0
        for box in (self._collision, self._links, self._points):
            box.on_update(lambda _: self.worker.ask("draw", self._draw))
        self.worker.ask("load", self._load)

    def _load(self) -> None:
        findings = check_hand_files(self._path)
        words = "\n".join(f"- **{finding.severity}**: {finding.message}" for finding in findings)
        self._findings.content = f"**Check**\n\n{words or 'nothing found'}"
        try:
            self._hand = load_hand(self._path)
        except FungraspError as error:
            self._title.content = f"**{self._path.name}** can't be read: {error}"
            return
        hand = self._hand
        counts = f"{len(hand.fingers)} fingers, {len(hand.actuators)} driven joints, {hand.side}"
        self._title.content = f"**{hand.title}**\n\n{counts}"
        scene = self.client.scene
        self._figure = RobotFigure(scene, "/hand", hand)
        # The palm's origin may be far from the visible shapes.
        ends = transform_points(self._wrist(hand), self._figure.corners)
        self._height = STANDING - float(ends[:, 2].min())
        low, high = ends.min(axis=0), ends.max(axis=0)
        x, y, z = (0.5 * (low + high) + np.array([0.0, 0.0, self._height])).tolist()
        look_at(self.client, (x, y, z), 2.2 * float(high[2] - low[2]), np.array([0.0, 1.0, 0.0]))
        if not self._figure.handles:
            self.note("this hand has no visual meshes that can be drawn: its collision shapes are shown")
            self._collision.value = True
        self._shapes = RobotFigure(scene, "/shapes", hand, collision=True, opacity=0.6)
        ask = lambda: self.worker.ask("draw", self._draw)  # noqa: E731
        self._sliders = JointSliders(self.client.gui, self._joints, hand, ask)
        self._draw()

    def _wrist(self, hand: Hand) -> np.ndarray:
        """Return the palm pose: fingers up, palm to the front, shape [7]."""
        # Fingers along z, palm normal along x toward the eye.
        axes = np.stack([hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal), hand.palm_fingers])
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
        return np.concatenate([[0.0, 0.0, self._height], quaternion])

    def _draw(self) -> None:
        hand, figure, shapes = self._hand, self._figure, self._shapes
        if hand is None or figure is None or shapes is None or self._sliders is None:
            return
        joints = self._sliders.joints
        wrist = self._wrist(hand)
        with self.client.atomic():
            for each in (figure, shapes):
                each.place(wrist, joints)
            figure.show(not self._collision.value)
            shapes.show(self._collision.value)
            for each in (figure, shapes):
                each.paint_links(LINK_COLORS if self._links.value else None)
            self._draw_points(hand, wrist, joints)

    def _draw_points(self, hand: Hand, wrist: np.ndarray, joints: np.ndarray) -> None:
        for mark in self._marks:
            mark.remove()
        self._marks = []
        if not self._points.value:
            return
        places = HandKinematics(hand, 1).keypoints(wrist[None], joints[None])[0].astype(np.float32)
        scene = self.client.scene
        self._marks.append(
            scene.add_point_cloud("/points", places, (20, 60, 200), point_size=0.008, point_shape="circle")
        )
        for name, place in zip(hand.keypoint_names, places, strict=True):
            self._marks.append(
                scene.add_label(f"/labels/{name}", name, position=place, font_size_mode="screen")
            )


LINK_COLORS = np.array(
    [
        [0.60, 0.60, 0.60],
        *([r, g, b] for r, g, b in ((0.12, 0.47, 0.71), (0.40, 0.66, 0.85), (0.68, 0.82, 0.93))),
        *([r, g, b] for r, g, b in ((0.17, 0.63, 0.17), (0.45, 0.77, 0.46), (0.73, 0.89, 0.70))),
        *([r, g, b] for r, g, b in ((1.00, 0.50, 0.05), (0.99, 0.68, 0.42), (0.99, 0.82, 0.64))),
        *([r, g, b] for r, g, b in ((0.58, 0.40, 0.74), (0.74, 0.62, 0.84), (0.86, 0.80, 0.92))),
        *([r, g, b] for r, g, b in ((0.84, 0.15, 0.16), (0.93, 0.45, 0.45), (0.97, 0.72, 0.70))),
    ]
)
"""Colors of contact links in the order of ``Hand.links``: the palm, then three shades for each finger."""
