"""A robot hand in a page: retargeting, following drags, measurement, saving."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import StaticQuality, static_quality
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet, save_robot_grasps
from fungrasp.grasps.as_shown import PlaceMarks, place_marks
from fungrasp.grasps.conversion import mirrored_grasps
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_variants import mirrored_object
from fungrasp.optimization.link_contacts import LinkDistances, LinkTouch
from fungrasp.retargeting import retarget
from fungrasp.retargeting.retargeter import Retargeter, RetargeterSettings
from fungrasp.viewer.figures import ContactMarks, ObjectFigure, RobotFigure
from fungrasp.viewer.page import BrowserPage

if TYPE_CHECKING:
    from viser import SceneApi

MARKED = 0.006
"""Maximum clearance of links with a mark [m]."""


class RobotView:
    """A robot hand with a copy of the object."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        place: np.ndarray,
        hand: Hand,
        model: ObjectModel,
        mirrored: bool = True,
    ):
        """
        Args:
            name: name of the root node.
            place: position of the root node [m], shape [3].
            mirrored: whether a left hand gets the mirror image of the object, as of the human grasp.
        """
        self.hand = hand
        self.model = model if hand.side == "right" or not mirrored else mirrored_object(model)
        self._root = scene.add_frame(name, show_axes=False, position=place)
        self.figure = RobotFigure(scene, f"{name}/hand", hand)
        self.object = ObjectFigure(scene, f"{name}/object", self.model)
        self._marks = ContactMarks(scene, f"{name}/object")
        self._distances = LinkDistances(hand, self.model)
        self._follower: Retargeter | None = None
        self.grasp: RobotGrasp | None = None
        """The current grasp; its contacts are those of the human grasp."""
        self.touch: LinkTouch | None = None
        """Nearest points of its links."""
        self.marks: PlaceMarks | None = None
        """Human and robot contact points; None while the hand follows or if they are unknown."""

    def imitate(self, human: HumanGrasp, method: str) -> None:
        """Retarget a grasp with contacts and force closure."""
        self._follower = None
        one = _one_sided(human, self.hand)
        self.grasp = retarget(one, {self.model.name: self.model}, self.hand, method, threads=1)[0]
        self._put()

    def hold(self, grasp: RobotGrasp) -> None:
        """Show a grasp unchanged."""
        self._follower, self.grasp = None, grasp
        self._put()

    def follow(self, human: HumanGrasp) -> None:
        """Follow a human hand and object that are moved."""
        if self.grasp is None:
            return
        one = _one_sided(human, self.hand)[0]
        if self._follower is None:
            # No filter: the mouse has no noise, and there is no last frame when it stops.
            self._follower = Retargeter(self.hand, self.model, RetargeterSettings(rate=None))
        pose = self._follower.follow(one.hand_joints, one.object_pose)
        self.grasp = replace(
            self.grasp,
            object_pose=one.object_pose,
            wrist_pose=pose.wrist_pose,
            joint_positions=pose.joint_positions,
            shown_places=None,
            shown_normals=None,
        )
        self._put()

    def set_joints(self, joint_positions: np.ndarray) -> None:
        """Set the joints. joint_positions: [rad], shape [M]."""
        if self.grasp is not None:
            self._follower = None
            self.grasp = replace(self.grasp, joint_positions=joint_positions)
            self._put()

    def quality(self, human: HumanGrasp) -> StaticQuality | None:
        """Return the static quality of the current grasp; None if there is no grasp."""
        if self.grasp is None:
            return None
        robot, one = self.grasp_set(), _one_sided(human, self.hand)
        return static_quality(robot, one, {self.model.name: self.model}, self.hand)

    def grasp_set(self) -> RobotGraspSet:
        """Return the current grasp as a set, for saving."""
        from fungrasp.hands import hand_origin

        assert self.grasp is not None
        pose, joints = self.grasp.wrist_pose[None], self.grasp.joint_positions[None]
        keypoints = HandKinematics(self.hand, 1).keypoints(pose, joints)
        grasp = replace(self.grasp, keypoints=keypoints[0])
        columns: dict[str, Any] = {
            f.name: np.asarray(getattr(grasp, f.name))[None]
            for f in fields(grasp)
            if f.name in _KEPT and getattr(grasp, f.name) is not None
        }
        return RobotGraspSet(
            hand=self.hand.name,
            hand_file=hand_origin(self.hand),
            joint_names=self.hand.joint_names,
            **columns,
        )

    def show(self, visible: bool) -> None:
        """Show or hide the hand and the object."""
        self._root.visible = visible

    def remove(self) -> None:
        """Remove the nodes from the scene."""
        self._marks.clear()
        self._root.remove()

    def _put(self) -> None:
        grasp = self.grasp
        assert grasp is not None
        self.figure.place(grasp.wrist_pose, grasp.joint_positions)
        self.object.place(grasp.object_pose)
        self.touch = self._distances.of(grasp.wrist_pose, grasp.joint_positions, grasp.object_pose)
        self.figure.paint(self.touch.reached, np.asarray(grasp.link_contacts, dtype=bool))
        self._marks.points(self.touch.place, self.touch.clearance, MARKED)
        known = grasp.shown_places is not None
        objects = {self.model.name: self.model}
        self.marks = place_marks(self.grasp_set(), 0, objects, hand=self.hand) if known else None
        self._marks.places(self.marks)


_KEPT = (
    "object_name",
    "object_mass",
    "object_pose",
    "object_rest_pose",
    "wrist_pose",
    "joint_positions",
    "keypoints",
    "link_contacts",
    "task",
    "shown_places",
    "shown_normals",
)


def _one_sided(human: HumanGrasp, hand: Hand) -> HumanGraspSet:
    """Return the grasp as a set, mirrored for a left hand."""
    one = HumanGraspSet.of([replace(human, hand_qpos=None)])
    return one if hand.side == "right" else mirrored_grasps(one)


LEGEND = (
    "Orange: asked to touch, and touches. Pink: asked to, and does not. Yellow: touches without being asked. "
    "Points: green on the surface, red inside the object. Lines: from the person's places to the robot's, "
    "green as shown, red not."
)

QUANTITIES = {
    "object_penetration_mm": ("Penetration of the object", "mm"),
    "contact_gap_mm": ("Gap at wanted contacts", "mm"),
    "held_as_shown": ("As shown", ""),
    "shown_share": ("Links as shown", ""),
    "place_error_mm": ("Place error", "mm"),
    "link_direction_error_deg": ("Directions off the person's", "°"),
    "force_closure_residual": ("Forces that stay unbalanced", ""),
    "force_closure_epsilon": ("Weakest wrench resisted", ""),
}
"""Title and unit of the displayed fields of ``StaticQuality``."""


def quality_rows(robots: Sequence[RobotView], quality: Sequence[StaticQuality]) -> list[tuple[str, ...]]:
    """Return table rows with a column for each hand.

    Args:
        quality: quality of each hand; empty during a drag, when only cheap numbers are shown.
    """
    rows: list[tuple[str, ...]] = []
    if quality:
        for name, (title, unit) in QUANTITIES.items():
            values = [float(getattr(each, name)[0]) for each in quality]
            rows.append((title, *(_worded(name, value, unit) for value in values)))
    else:
        deepest = [max(0.0, -float(r.touch.clearance.min())) if r.touch else 0.0 for r in robots]
        rows.append(("Penetration of the object", *(f"{1e3 * d:.1f} mm" for d in deepest)))
    touches = []
    for robot in robots:
        if robot.touch is not None and robot.grasp is not None:
            asked = np.asarray(robot.grasp.link_contacts, dtype=bool)
            touches.append(f"{int((robot.touch.reached & asked).sum())} of {int(asked.sum())}")
    return [*rows, ("Contacts reached", *touches)]


def view_across(grasp: HumanGrasp) -> np.ndarray:
    """Return the horizontal unit vector that points right for a viewer who looks across the forearm from the
    side of the thumb and fingertips, shape [3]."""
    forearm = (grasp.hand_joints[0] - grasp.hand_joints[9])[:2]
    size = float(np.linalg.norm(forearm))
    aside = forearm / size if size > 0.02 else np.array([1.0, 0.0])
    towards = np.array([aside[1], -aside[0]])
    # The viewer is on the side of the knuckles where the tips are.
    tips = grasp.hand_joints[[4, 8, 12, 20]][:, :2].mean(axis=0) - grasp.hand_joints[[5, 17]][:, :2].mean(
        axis=0
    )
    if float(tips @ towards) < 0:
        aside = -aside
    return np.array([aside[0], aside[1], 0.0])


def _worded(name: str, value: float, unit: str) -> str:
    """Return a number as text, with a mark if it is good or bad."""
    if not np.isfinite(value):
        return "–"
    if name == "held_as_shown":
        return "yes ✓" if value else "no ✗"
    good = {"object_penetration_mm": value < 2.0, "force_closure_residual": value < 0.1}.get(name)
    mark = "" if good is None else " ✓" if good else " ✗"
    return f"{value:.2f} {unit}".strip() + mark


def add_downloads(page: BrowserPage, robot: Callable[[], RobotView | None]) -> None:
    """Add buttons that save the grasp and a picture.

    Args:
        page: page for the buttons.
        robot: returns the displayed robot hand, or None.
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
