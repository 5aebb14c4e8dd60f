"""Page of robot grasps: view and test each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.viewer.episode_tab import EpisodeTab, Trial
from fungrasp.viewer.page import BrowserPage, add_table, look_at, values_table
from fungrasp.viewer.robot_view import RobotView, add_downloads

if TYPE_CHECKING:
    from viser import ClientHandle


class RobotGraspsPage(BrowserPage):
    """Page of the grasps of one hand."""

    def __init__(self, client: ClientHandle, grasps: RobotGraspSet, objects: Mapping[str, ObjectModel]):
        """
        Args:
            grasps: grasps of a known hand.
        """
        super().__init__(client)
        self._grasps, self._objects, self._hand = grasps, objects, grasps.load_hand()
        self._view: RobotView | None = None
        add_table(client)
        tabs = client.gui.add_tab_group()
        with tabs.add_tab("Grasp"):
            client.gui.add_markdown(f"**{self._hand.title}**")
            labels = [self._label(row) for row in range(len(grasps))]
            self._row = client.gui.add_dropdown("Grasp", labels)
            self._numbers = client.gui.add_markdown("")
            add_downloads(self, lambda: self._view)
        with tabs.add_tab("Lift"):
            self._lift = EpisodeTab(self, self._trial, lambda: self._stand(False))
            self._lift.choose_policy(self._hand)
        self._row.on_update(lambda _: self.worker.ask("show", self._show))
        self.worker.ask("show", self._show)

    def _label(self, row: int) -> str:
        task = "" if self._grasps.task is None else str(self._grasps.task[row])
        return f"{row}: {self._grasps.object_name[row]} {task}".strip()

    def _index(self) -> int:
        return int(self._row.value.split(":")[0])

    def _trial(self) -> Trial:
        grasps = self._grasps.select(np.array([self._index()]))
        return Trial(self._hand, self._objects[str(grasps.object_name[0])], grasps)

    def _stand(self, visible: bool) -> None:
        if visible:
            self._lift.player.clear()
        if self._view is not None:
            self._view.show(visible)

    def _show(self) -> None:
        grasp = self._grasps[self._index()]
        self._lift.player.clear()
        if self._view is not None:
            self._view.remove()
        center = np.array([*-grasp.object_pose[:2], 0.0])
        look_at(self.client, (0.0, 0.0, float(grasp.object_pose[2])), 0.55)
        with self.client.atomic():
            model = self._objects[grasp.object_name]
            self._view = RobotView(self.client.scene, "/robot", center, self._hand, model, mirrored=False)
            self._view.hold(grasp)
        touch, asked = self._view.touch, np.asarray(grasp.link_contacts, dtype=bool)
        assert touch is not None
        rows = [
            ("Object", f"{grasp.object_name}, {1e3 * grasp.object_mass:.0f} g"),
            ("Penetration of the object", f"{max(0.0, -1e3 * float(touch.clearance.min())):.1f} mm"),
            ("Contacts reached", f"{int((touch.reached & asked).sum())} of {int(asked.sum())}"),
        ]
        if self._view.marks is not None:
            rows.append(("As shown", self._view.marks.words))
        rows += [
            (name.replace("_", " "), f"{float(v):.3g}") for name, v in grasp.extra.items() if np.ndim(v) == 0
        ]
        self._numbers.content = values_table(rows)
