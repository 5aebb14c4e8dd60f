"""What perception makes of an image: the record that ``perceive`` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.grasps import HUMAN_LINKS, HumanGrasp, HumanGraspSet
from fungrasp.objects import ObjectModel, mirrored_object
from fungrasp.perception.acceptance import Acceptance
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.object_pose.shape_fit import FittedShape


@dataclass(frozen=True, eq=False)
class HandCandidate:
    """A hand that may be the one that holds the object, and the table and the object that go with it."""

    detected: DetectedHand | None
    """The hand in the image; None for another estimator's."""
    hand: HandEstimate
    """The hand in meters, before the object is known, camera frame."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]``, camera frame, shape [4]; None if none was seen."""
    object: ObjectEstimate
    """The object's pose, camera frame."""
    holds: bool
    """Whether the object's pose is rather right than wrong and the hand is at it."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """What was uncertain in the choice of the hand."""

    @property
    def worth(self) -> float:
        """The product of the scores of hand and object: of candidates that hold the object, or of those that
        don't where none does, the highest is chosen."""
        return self.object.score * self.hand.score


@dataclass(frozen=True, eq=False)
class Perceived:
    """What was made of an image."""

    capture: Capture
    """The image."""
    object_model: ObjectModel
    """The object in the image."""
    grasp: HumanGrasp
    """World frame, a right hand. If the image shows a left one, the scene reflected in the plane y = 0: the
    object's name then ends in "_mirrored", and its mesh must be reflected as well (see ``mirror_pose``)."""
    pose_world_camera: np.ndarray
    """Camera in the world, shape [7], before any reflection; ``world_from_table`` says where it is."""
    hand: HandEstimate
    """The hand after refinement against the object, camera frame, not mirrored."""
    object: ObjectEstimate
    """The object, camera frame, not mirrored."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame, shape
    [4]."""
    table_found: bool
    """Whether the table was given or seen; else it is a guess."""
    warnings: tuple[PerceptionWarning, ...]
    """What was uncertain; empty if nothing was."""
    acceptance: Acceptance
    """Whether it can be used, the numbers that say so, and what would help. A table that is only guessed
    gives a warning, but the hand on the object does not depend on it; so does the question which way round a
    nearly symmetric object is."""
    notes: tuple[str, ...] = ()
    """Assumptions about the object, as sentences to print: a mass that was guessed."""
    candidates: tuple[HandCandidate, ...] = ()
    """Hands that were looked at more closely; the result is made of the first."""
    mass_range: tuple[float, float] | None = None
    """Between which the object's mass lies in eight of ten cases, where it was guessed [kg]."""
    fitted: FittedShape | None = None
    """The shape that stands for an object without a mesh; None where a mesh was given."""

    @property
    def confident(self) -> bool:
        """Whether the answer is sure."""
        return self.acceptance.sure

    @property
    def grasps(self) -> HumanGraspSet:
        """The grasp as the set that ``retarget`` takes."""
        return HumanGraspSet.of([self.grasp])

    @property
    def objects(self) -> dict[str, ObjectModel]:
        """The object of the grasps by its name, reflected if the hand was a left one."""
        model, name = self.object_model, self.grasp.object_name
        return {name: model if name == model.name else mirrored_object(model)}

    def as_json(self) -> dict[str, Any]:
        """All that was found, to be written as JSON. Meters; poses ``[x y z qw qx qy qz]``; what could not be
        measured is null."""
        grasp, hand, obj = self.grasp, self.hand, self.object
        links = zip(HUMAN_LINKS, grasp.link_contacts, strict=True)
        return {
            "version": 4,
            "sure": self.confident,
            "acceptance": self.acceptance.as_json(),
            "doubts": [str(warning) for warning in self.warnings],
            "warnings": [{"code": warning.code, "values": dict(warning.values)} for warning in self.warnings],
            "grasp": {
                "object_name": grasp.object_name,
                "object_mass": grasp.object_mass,
                "object_pose": grasp.object_pose.tolist(),
                "object_rest_pose": grasp.object_rest_pose.tolist(),
                "hand_joints": grasp.hand_joints.tolist(),
                "links_in_contact": [name for name, touches in links if touches],
                "task": grasp.task,
            },
            "pose_world_camera": self.pose_world_camera.tolist(),
            "table_camera": self.table.tolist(),
            "table_found": self.table_found,
            "hand": {
                "side": hand.side,
                "score": hand.score,
                "joints_camera": hand.joints_camera.tolist(),
                "pixels": hand.pixels.tolist(),
                "confidence": hand.confidence.tolist(),
            },
            "fitted_shape": None
            if self.fitted is None
            else {"name": self.fitted.name, "explained": self.fitted.quality},
            "object_mass_range": self.mass_range,
            "object": {
                "pose_camera": obj.pose_camera_object.tolist(),
                "score": obj.score,
                "accepted": obj.accepted,
                "note": obj.note,
                "alternatives": [
                    {"pose_camera": pose.tolist(), "score": score} for pose, score in obj.alternatives
                ],
            },
        }
