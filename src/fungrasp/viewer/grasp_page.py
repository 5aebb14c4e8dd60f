"""Page of human grasps: human and robot grasp side by side; the robot hand follows drags."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.hand_registry import hand_files
from fungrasp.objects import ObjectModel
from fungrasp.retargeting import METHODS
from fungrasp.viewer.episode_tab import EpisodeTab, Trial
from fungrasp.viewer.figures import HumanFigure, ObjectFigure, move, pose_of
from fungrasp.viewer.page import BrowserPage, JointSliders, add_table, look_at, values_table
from fungrasp.viewer.robot_view import LEGEND, RobotView, add_downloads, quality_rows, view_across

if TYPE_CHECKING:
    from viser import ClientHandle

    from fungrasp.evaluation import StaticQuality

APART = 0.3
"""Distance between the hands [m]."""

SAY_PERIOD = 0.3
"""Update period of the numbers during a drag [s]; browsers update text more slowly than shapes."""

NOTHING = "nothing"

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class PickableGrasps:
    """Initial choice of a page of grasps."""

    grasps: HumanGraspSet
    """Grasps to choose from."""
    objects: Mapping[str, ObjectModel]
    """Objects of the grasps by name."""
    hand: str = "allegro"
    """Name of a hand, or the path of its TOML file."""
    row: int = 0
    """Row of the initial grasp."""


class GraspPage(BrowserPage):
    """Page to select a grasp and hands, drag the object or the wrist, move joints, compare and save."""

    def __init__(self, client: ClientHandle, choice: PickableGrasps):
        super().__init__(client)
        self._choice = choice
        self._human: HumanGrasp = choice.grasps[choice.row]
        self._picked = self._human
        self._motion = IDENTITY
        self._figures: list[Any] = []
        self._robots: list[RobotView] = []
        self._syncing = False
        self._said, self._shown = 0.0, 0
        add_table(client)
        self._controls()
        self.worker.ask("pick", self._show_picked)

    # Controls.

    def _controls(self) -> None:
        gui, choice = self.client.gui, self._choice
        names = sorted(set(choice.grasps.object_name.tolist()))
        hands = list(dict.fromkeys([choice.hand, *hand_files()]))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Grasp"):
            self._object = gui.add_dropdown("Object", names, initial_value=self._human.object_name)
            rows = self._rows(self._human.object_name)
            self._row = gui.add_dropdown("Grasp", list(rows), initial_value=self._label(choice.row))
            self._hand = gui.add_dropdown("Hand", hands, initial_value=choice.hand)
            self._method = gui.add_dropdown("Method", list(METHODS))
            self._other = gui.add_dropdown(
                "Compare with", [NOTHING, *hands], hint="A second hand beside the first"
            )
            self._other_method = gui.add_dropdown("Its method", list(METHODS), visible=False)
            self._numbers = gui.add_markdown("Retargeting …")
            with gui.add_folder("Move", expand_by_default=True):
                self._what = gui.add_button_group("Handles on", ("object", "wrist", "none"))
                self._shift = gui.add_vector3(
                    "Object [mm]", (0.0, 0.0, 0.0), step=1.0, hint="Where the object is, from where it was"
                )
                self._turn = gui.add_slider("Turn object [°]", -180, 180, 1, 0)
                self._back = gui.add_button("Put back", hint="As the person held it")
            with gui.add_folder("Joints", expand_by_default=False) as self._joint_folder:
                pass
            add_downloads(self, lambda: self._robots[0] if self._robots else None)
        with tabs.add_tab("Lift"):
            self._lift = EpisodeTab(self, self._trial, self._show_episode)
        self._sliders: JointSliders | None = None
        self._object.on_update(lambda _: self._on_object())
        self._row.on_update(lambda _: self._on_row())
        for control in (self._hand, self._method, self._other, self._other_method):
            control.on_update(lambda _: self._on_hand())
        self._what.on_click(lambda _: self.worker.ask("handles", self._show_handles))
        self._shift.on_update(lambda _: self._on_numbers())
        self._turn.on_update(lambda _: self._on_numbers())
        self._back.on_click(lambda _: self.worker.ask("pick", self._show_picked))

    def _rows(self, name: str) -> dict[str, int]:
        found = np.flatnonzero(self._choice.grasps.object_name == name)
        return {self._label(int(row)): int(row) for row in found}

    def _label(self, row: int) -> str:
        task = "" if self._choice.grasps.task is None else str(self._choice.grasps.task[row])
        return f"{row}: {task}" if task else f"{row}"

    def _on_object(self) -> None:
        labels = list(self._rows(self._object.value))
        # Setting the options selects the first one, which triggers an update.
        self._row.options = labels
        self._on_row()

    def _on_row(self) -> None:
        row = self._rows(self._object.value).get(self._row.value)
        if row is None:
            return
        self._picked = self._choice.grasps[row]
        self.worker.ask("pick", self._show_picked)

    def _on_hand(self) -> None:
        self._other_method.visible = self._other.value != NOTHING
        self.worker.ask("pick", self._show_picked)

    # Display.

    def _show_picked(self) -> None:
        grasp = self._picked
        model = self._choice.objects[grasp.object_name]
        wanted = [(self._hand.value, self._method.value)]
        if self._other.value != NOTHING:
            wanted.append((self._other.value, self._other_method.value))
        hands = [(load_hand(name), method) for name, method in wanted]
        self._clear()
        self._human, self._motion = grasp, IDENTITY
        # Grasps may be anywhere on the table; show them side by side around the middle.
        aside, count = view_across(grasp), 1 + len(hands)
        center = np.array([*-grasp.object_pose[:2], 0.0])
        places = [center + (i - (count - 1) / 2) * APART * aside for i in range(count)]
        scene = self.client.scene
        height = float(grasp.object_pose[2])
        look_at(self.client, (0.0, 0.0, height), 0.30 + 0.24 * count, aside)
        # Unique names keep removed nodes and new nodes apart.
        self._shown += 1
        person = f"/human-{self._shown}"
        with self.client.atomic():
            root = scene.add_frame(person, show_axes=False, position=places[0])
            self._person = HumanFigure(scene, f"{person}/hand", grasp.hand_joints, grasp.link_contacts)
            self._thing = ObjectFigure(scene, f"{person}/object", model)
            self._thing.place(grasp.object_pose)
            self._figures = [root]
            self._label_at(f"{person}/label", "person", grasp)
            self._add_handles(person, grasp)
        for i, (hand, _) in enumerate(hands):
            name = f"/robot{i}-{self._shown}"
            with self.client.atomic():
                self._robots.append(RobotView(scene, name, places[1 + i], hand, model))
                self._label_at(f"{name}/label", hand.name, grasp)
        self._reset_numbers()
        self._show_handles()
        self._imitate()
        self._lift.choose_policy(hands[0][0])
        self._make_sliders()

    def _label_at(self, name: str, words: str, grasp: HumanGrasp) -> None:
        x, y, _ = grasp.object_pose[:3]
        self.client.scene.add_label(name, words, position=(x, y, 0.0), anchor="top-center")

    def _trial(self) -> Trial:
        if not self._robots or self._robots[0].grasp is None:
            raise FungraspError("there is no robot grasp yet")
        robot = self._robots[0]
        return Trial(robot.hand, robot.model, robot.grasp_set())

    def _show_episode(self) -> None:
        """Hide the grasps for an episode."""
        self._stand(False)

    def _stand(self, visible: bool) -> None:
        """Show or hide the grasps."""
        if visible:
            self._lift.player.clear()
        for node in self._figures:
            node.visible = visible
        for robot in self._robots:
            robot.show(visible)

    def _clear(self) -> None:
        self._lift.player.clear()
        with self.client.atomic():
            for robot in self._robots:
                robot.remove()
            for figure in self._figures:
                figure.remove()
            if self._sliders is not None:
                self._sliders.remove()
        self._robots, self._figures, self._sliders = [], [], None

    def _imitate(self) -> None:
        self._stand(True)
        methods = [self._method.value, self._other_method.value]
        start = time.perf_counter()
        for robot, method in zip(self._robots, methods, strict=False):
            robot.imitate(self._human, method)
        took = time.perf_counter() - start
        if self.worker.waits("pick") or self.worker.waits("follow"):
            return
        quality = [robot.quality(self._human) for robot in self._robots]
        self._say(f"retargeted in {1e3 * took:.0f} ms", [q for q in quality if q is not None])
        self._set_sliders()

    def _follow(self) -> None:
        start = time.perf_counter()
        with self.client.atomic():
            for robot in self._robots:
                robot.follow(self._human)
        now = time.perf_counter()
        if now - self._said > SAY_PERIOD:
            self._said = now
            self._say(f"follows in {1e3 * (now - start):.0f} ms", [])

    def _say(self, words: str, quality: list[StaticQuality]) -> None:
        """Show the numbers."""
        heads = ("", *(robot.hand.name for robot in self._robots))
        rows = quality_rows(self._robots, quality)
        table = values_table(rows, heads)
        self._numbers.content = f"{table}\n\n*{words}.* {LEGEND}"

    # Motion.

    def _add_handles(self, person: str, grasp: HumanGrasp) -> None:
        scene = self.client.scene
        limits = {"scale": 0.11, "depth_test": False, "line_width": 3.0}
        self._object_handle = scene.add_transform_controls(f"{person}/move object", **limits)
        self._wrist_handle = scene.add_transform_controls(f"{person}/move wrist", **limits)
        move(self._object_handle, grasp.object_pose)
        self._wrist_start = np.concatenate([grasp.hand_joints[0], [1.0, 0.0, 0.0, 0.0]])
        move(self._wrist_handle, self._wrist_start)
        for handle in (self._object_handle, self._wrist_handle):
            handle.on_update(lambda event: self._on_handles(event.phase == "end"))

    def _show_handles(self) -> None:
        self._object_handle.visible = self._what.value == "object"
        self._wrist_handle.visible = self._what.value == "wrist"

    def _on_handles(self, released: bool = False) -> None:
        self._moved(pose_of(self._object_handle), pose_of(self._wrist_handle))
        if released:
            self.worker.ask("imitate", self._imitate)

    def _on_numbers(self) -> None:
        """Move the object as entered in the number fields."""
        if self._syncing:
            return
        angle = np.radians(self._turn.value)
        turn = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
        start = self._picked.object_pose
        place = start[:3] + 1e-3 * np.array(self._shift.value)
        turned = compose(np.concatenate([np.zeros(3), turn]), np.concatenate([np.zeros(3), start[3:]]))
        pose = np.concatenate([place, turned[3:]])
        move(self._object_handle, pose)
        self._moved(pose, pose_of(self._wrist_handle))
        self.worker.ask("imitate", self._imitate)

    def _moved(self, object_pose: np.ndarray, wrist: np.ndarray) -> None:
        motion = compose(wrist, invert(self._wrist_start))
        joints = transform_points(motion, self._picked.hand_joints)
        self._human = replace(self._picked, object_pose=object_pose, hand_joints=joints)
        with self.client.atomic():
            self._thing.place(object_pose)
            self._person.place(motion)
        self.worker.ask("follow", self._follow)

    def _reset_numbers(self) -> None:
        self._syncing = True
        self._shift.value, self._turn.value = (0.0, 0.0, 0.0), 0
        self._syncing = False

    # Joints.

    def _make_sliders(self) -> None:
        ask = lambda: self.worker.ask("bend", self._bend)  # noqa: E731
        self._sliders = JointSliders(self.client.gui, self._joint_folder, self._robots[0].hand, ask)
        self._set_sliders()

    def _set_sliders(self) -> None:
        grasp = self._robots[0].grasp if self._robots else None
        if grasp is not None and self._sliders is not None:
            self._sliders.show(grasp.joint_positions)

    def _bend(self) -> None:
        if not self._robots or self._sliders is None:
            return
        with self.client.atomic():
            self._robots[0].set_joints(self._sliders.joints)
        self._say("bent by hand", [])
