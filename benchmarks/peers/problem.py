"""What every peer is given: the same human grasps, hand and start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import process_time

import numpy as np

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.retargeting.contact_optimization import initial_pose

HUMAN_ORDER = np.array([0, 17, 18, 19, 20, *range(1, 17)])
"""Our joints in the order of MANO and MediaPipe: wrist, thumb, index, middle, ring, pinky."""


@dataclass(frozen=True)
class PeerProblem:
    """N human grasps for one hand."""

    human: HumanGraspSet
    """The grasps."""
    objects: Mapping[str, ObjectModel]
    """By name."""
    hand: Hand
    """The robot hand."""
    points: HandPoints
    """Its points, for the correspondence of links."""
    targets: RetargetingProblem
    """The grasps in their objects' frames."""
    wrist_start: np.ndarray
    """Palms laid along the human ones, world frame, shape [N, 7]."""
    joints_start: np.ndarray
    """Independent joints, a quarter closed [rad], shape [N, U]."""

    @classmethod
    def of(cls, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand) -> PeerProblem:
        """Set up."""
        points = HandPoints(HandKinematics(hand, len(human)))
        targets = RetargetingProblem.from_grasps(human, objects, points.match)
        wrist, joints = initial_pose(points, targets)
        return cls(human, objects, hand, points, targets, compose(human.object_pose, wrist), joints)

    def solved(self, wrist_pose: np.ndarray, joint_positions: np.ndarray) -> RobotGraspSet:
        """A peer's solution, joints brought onto this hand's limits and couplings.

        Args:
            wrist_pose: of the palm, world frame, shape [N, 7].
            joint_positions: all joints [rad], shape [N, M].
        """
        kinematics, human = self.points.kinematics, self.human
        independent = np.clip(self.hand.independent(joint_positions), kinematics.lower, kinematics.upper)
        in_object = HandKinematics(self.hand, len(human))
        in_object.update(wrist_pose, independent)
        return RobotGraspSet(
            hand=self.hand.name,
            object_name=human.object_name,
            object_mass=human.object_mass,
            object_pose=human.object_pose,
            object_rest_pose=human.object_rest_pose,
            wrist_pose=wrist_pose,
            joint_names=self.hand.joint_names,
            joint_positions=self.hand.all_joints(independent),
            keypoints=in_object.points(self.points.keypoints),
            link_contacts=self.targets.contacts,
            task=human.task,
        )

    def contact_points(self) -> np.ndarray:
        """Where the far key points of links should be: on the surface where the human touches, else at the
        human joint; world frame [m], shape [N, S, 3]."""
        match, targets = self.points.match, self.targets
        human = match.human_far
        surface = targets.surface + self.points.far_radius[:, None] * targets.normals
        wanted = targets.contacts[:, 1:, None]
        return transform_points(self.human.object_pose, np.where(wanted, surface, targets.joints[:, human]))


@dataclass
class CpuClock:
    """Processor time of a ``with`` block."""

    seconds: float = 0.0
    """Of all threads of this process [s]."""

    def __enter__(self) -> CpuClock:
        self._start = process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = process_time() - self._start
