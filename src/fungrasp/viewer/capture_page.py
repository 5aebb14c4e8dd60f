"""Page of a capture: the colored point cloud with the detected hand and object."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.media.grasp_scenes import CONTACT
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.perceived import Perceived
from fungrasp.viewer.figures import HumanFigure, ObjectFigure
from fungrasp.viewer.page import BrowserPage, look_at, values_table

if TYPE_CHECKING:
    from viser import ClientHandle

MOST_POINTS = 120_000
"""Maximum number of points sent to a browser."""

LEVEL_CAMERA = np.array([0.0, 0.0, 0.4, 0.5, -0.5, 0.5, -0.5])
"""Assumed camera pose before perception: level, looking along x."""


class CapturePage(BrowserPage):
    """Page of a capture in 3D."""

    def __init__(
        self, client: ClientHandle, capture: Capture, perceive: Callable[[], Perceived] | None = None
    ):
        """
        Args:
            perceive: detects hand and object, which takes a while; only the image is shown if None.
        """
        super().__init__(client)
        self._capture, self._perceive = capture, perceive
        self._nodes: dict[str, Any] = {}
        gui = client.gui
        gui.add_image(np.ascontiguousarray(capture.color[::2, ::2]), label="Image")
        self._boxes = {
            name: gui.add_checkbox(name, True, visible=False) for name in ("points", "hand", "object")
        }
        self._alternative = gui.add_dropdown("Alternative", ["none"], visible=False)
        self._words = gui.add_markdown("")
        for box in self._boxes.values():
            box.on_update(lambda _: self.worker.ask("visible", self._show_chosen))
        self._alternative.on_update(lambda _: self.worker.ask("alternative", self._show_alternative))
        self._seen: Perceived | None = None
        self.worker.ask("show", self._show)

    def _show(self) -> None:
        self._add_points(LEVEL_CAMERA)
        if self._perceive is None:
            self._words.content = (
                "Only what the camera saw: `--mesh` says what object is held, and finds hand and object."
            )
            return
        self._words.content = "Looking for hand and object …"
        try:
            seen = self._perceive()
        except FungraspError as error:
            self._words.content = f"**nothing was found**: {error}"
            return
        self._seen = seen
        camera = seen.pose_world_camera
        with self.client.atomic():
            joints = transform_points(camera, seen.hand.joints_camera)
            held = compose(camera, seen.object.pose_camera_object)
            self._add_points(camera, 0.5 * (joints.mean(axis=0) + held[:3]))
            scene = self.client.scene
            self._nodes["hand"] = HumanFigure(scene, "/hand", joints, seen.grasp.link_contacts).handle
            figure = ObjectFigure(scene, "/object", seen.object_model)
            figure.place(held)
            self._nodes["object"] = figure.handle
        for name, box in self._boxes.items():
            box.visible = name in self._nodes
        choices = [f"object {i}: score {score:.2f}" for i, (_, score) in enumerate(seen.object.alternatives)]
        self._alternative.options = ["none", *choices]
        self._alternative.visible = bool(choices)
        self._say(seen)

    def _say(self, seen: Perceived) -> None:
        judged = seen.acceptance
        head, *rows = judged.rows()
        warnings = "\n".join(f"- {warning}" for warning in (*seen.warnings, *seen.notes, *judged.help))
        mark = "✓" if judged.sure else "?"
        self._words.content = f"**{mark} {judged.summary()}**\n\n{values_table(rows, head)}\n\n{warnings}"

    def _add_points(self, camera: np.ndarray, target: np.ndarray | None = None) -> None:
        """Add the points, viewed from the camera's side. target: view target [m]; their median if None."""
        points, colors = self._capture.points(), self._capture.color
        seen = np.isfinite(points[..., 2]) & (points[..., 2] > 0)
        places, colors = transform_points(camera, points[seen]), colors[seen]
        step = len(places) // MOST_POINTS + 1
        places, colors = places[::step], colors[::step]
        if not len(places):
            raise FungraspError("the image has no depth: there is nothing to show in space")
        middle = np.median(places, axis=0)
        self._nodes["points"] = self.client.scene.add_point_cloud(
            "/points", (places - middle).astype(np.float32), colors, point_size=0.0022, position=middle
        )
        middle = middle if target is None else target
        away = middle - camera[:3]
        aside = np.array([away[1], -away[0], 0.0])
        distance = float(np.linalg.norm(away))
        look_at(self.client, tuple(middle), 0.95 * distance, aside / max(float(np.linalg.norm(aside)), 1e-9))

    def _show_chosen(self) -> None:
        for name, box in self._boxes.items():
            if name in self._nodes:
                self._nodes[name].visible = box.value

    def _show_alternative(self) -> None:
        if "alternative" in self._nodes:
            self._nodes.pop("alternative").remove()
        seen, choice = self._seen, str(self._alternative.value)
        if seen is None or choice == "none":
            return
        number, camera, scene = int(choice.split()[1][:-1]), seen.pose_world_camera, self.client.scene
        figure = ObjectFigure(scene, "/alternative", seen.object_model, opacity=0.5, color=CONTACT)
        figure.place(compose(camera, seen.object.alternatives[number][0]))
        self._nodes["alternative"] = figure.handle
