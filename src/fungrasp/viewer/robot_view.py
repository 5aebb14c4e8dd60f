"""One robot hand in a page: it imitates the human hand, follows it while it is dragged, and is judged."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fungrasp.evaluation import StaticQuality, static_quality
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet
from fungrasp.grasps.mirroring import mirrored_grasps
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.mirroring import mirrored_object
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE, contacts_of_links
from fungrasp.optimization.problem import CollisionScene
from fungrasp.retargeting import retarget
from fungrasp.retargeting.retargeter import Retargeter
from fungrasp.viewer.figures import ContactMarks, ObjectFigure
from fungrasp.viewer.robot_figure import RobotFigure

if TYPE_CHECKING:
    from viser import SceneApi

MARKED = 0.006
"""Links farther from the object than this get no mark [m]."""


@dataclass(frozen=True, eq=False)
class LinkTouch:
    """Where the links of a hand are nearest to the object, object frame."""

    place: np.ndarray
    """[m], shape [L, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [L, 3]."""
    clearance: np.ndarray
    """[m], negative inside, shape [L]."""

    @property
    def reached(self) -> np.ndarray:
        """Links that touch, shape [L] bool."""
        return self.clearance < CONTACT_DISTANCE


class LinkDistances:
    """How far the links of a hand are from one object, in a millisecond."""

    def __init__(self, hand: Hand, model: ObjectModel):
        self._hand = hand
        self._points = HandPoints(HandKinematics(hand, 1), 0.006)
        self._scene = CollisionScene.settled(
            [model.name], np.array([[0, 0, 0, 1.0, 0, 0, 0]]), {model.name: model}
        )

    def of(self, wrist_pose: np.ndarray, joints: np.ndarray, object_pose: np.ndarray) -> LinkTouch:
        """Of a hand somewhere.

        Args:
            wrist_pose: of the palm body, world frame, shape [7].
            joints: all of the hand [rad], shape [M].
            object_pose: world frame, shape [7].
        """
        pose = compose(invert(object_pose), wrist_pose)[None]
        found = contacts_of_links(self._points, self._scene, pose, self._hand.independent(joints)[None])
        return LinkTouch(found.place[0], found.inward[0], found.clearance[0])


class RobotView:
    """A robot hand beside its own copy of the object."""

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
            scene: of the page.
            name: of the node that carries all of it.
            place: of that node [m], shape [3].
            hand: any hand.
            model: the object.
            mirrored: whether a left hand gets the mirror image of the object, as it does of the human grasp.
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
        """Where it is now; contacts are those that the human grasp asks for."""
        self.touch: LinkTouch | None = None
        """What it touches."""

    def imitate(self, human: HumanGrasp, method: str) -> None:
        """Retarget a grasp, with contacts and the balance of forces."""
        self._follower = None
        one = _one_sided(human, self.hand)
        self.grasp = retarget(one, {self.model.name: self.model}, self.hand, method, threads=1)[0]
        self._put()

    def hold(self, grasp: RobotGrasp) -> None:
        """Take a grasp as it is."""
        self._follower, self.grasp = None, grasp
        self._put()

    def follow(self, human: HumanGrasp) -> None:
        """Stay with a hand and an object that are being moved."""
        if self.grasp is None:
            return
        one = _one_sided(human, self.hand)[0]
        if self._follower is None:
            self._follower = Retargeter(self.hand, self.model)
        pose = self._follower.follow(one.hand_joints, one.object_pose)
        self.grasp = replace(
            self.grasp,
            object_pose=one.object_pose,
            wrist_pose=pose.wrist_pose,
            joint_positions=pose.joint_positions,
        )
        self._put()

    def set_joints(self, joint_positions: np.ndarray) -> None:
        """Bend it by hand. joint_positions: shape [M]."""
        if self.grasp is not None:
            self._follower = None
            self.grasp = replace(self.grasp, joint_positions=joint_positions)
            self._put()

    def quality(self, human: HumanGrasp) -> StaticQuality | None:
        """The numbers of the docs, of this one grasp."""
        if self.grasp is None:
            return None
        robot, one = self.grasp_set(), _one_sided(human, self.hand)
        return static_quality(robot, one, {self.model.name: self.model}, self.hand)

    def grasp_set(self) -> RobotGraspSet:
        """The grasp as it is, to be kept."""
        from fungrasp.hands import hand_origin

        assert self.grasp is not None
        pose, joints = self.grasp.wrist_pose[None], self.grasp.joint_positions[None]
        keypoints = HandKinematics(self.hand, 1).keypoints(pose, joints)
        grasp = replace(self.grasp, keypoints=keypoints[0])
        columns: dict[str, Any] = {
            f.name: np.asarray(getattr(grasp, f.name))[None] for f in fields(grasp) if f.name in _KEPT
        }
        return RobotGraspSet(
            hand=self.hand.name,
            hand_file=hand_origin(self.hand),
            joint_names=self.hand.joint_names,
            **columns,
        )

    def show(self, visible: bool) -> None:
        """Whether it is seen."""
        self._root.visible = visible

    def remove(self) -> None:
        """Take it out of the scene."""
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
)


def _one_sided(human: HumanGrasp, hand: Hand) -> HumanGraspSet:
    """The grasp as a set, of a left hand for a left one."""
    one = HumanGraspSet.of([replace(human, hand_qpos=None)])
    return one if hand.side == "right" else mirrored_grasps(one)
