"""The result of ``perceive``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.grasps import HUMAN_LINKS, HumanGrasp, HumanGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.perception.acceptance import Acceptance
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.object_pose.shape_fit import FittedShape


@dataclass(frozen=True, eq=False)
class HandCandidate:
    """A hand that may hold the object, with the table and the object found for it."""

    detected: DetectedHand | None
    """Detection in the image; None for the estimate of another estimator."""
    hand: HandEstimate
    """Estimate of the hand before the object is known, camera frame."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]``, camera frame, shape [4]; None if not found."""
    object: ObjectEstimate
    """Estimate of the object, camera frame."""
    holds: bool
    """Whether the object's pose is probably right and the hand is near the object."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """Uncertainties in the choice of the hand."""

    @property
    def worth(self) -> float:
        """Product of the scores of object and hand. Candidates are ranked by ``holds``, then by this."""
        return self.object.score * self.hand.score


@dataclass(frozen=True, eq=False, repr=False)
class Perceived:
    """The result for one image."""

    capture: Capture
    """Input image."""
    object_model: ObjectModel
    """Model of the object, not mirrored."""
    grasp: HumanGrasp
    """Grasp of a right hand, world frame. The scene of a left hand is reflected in the plane y = 0: the
    object's name then ends in "_mirrored", and its mesh must be reflected as well (see ``mirror_pose``)."""
    pose_world_camera: np.ndarray
    """Pose of the camera in the world, not mirrored, shape [7]; see ``world_from_table``."""
    hand: HandEstimate
    """Hand after the fit to the object, camera frame, not mirrored."""
    object: ObjectEstimate
    """Object, camera frame, not mirrored."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame, shape
    [4]."""
    table_found: bool
    """Whether the table was given or found; otherwise it is guessed."""
    warnings: tuple[PerceptionWarning, ...]
    """Uncertainties; may be empty."""
    acceptance: Acceptance
    """Whether the result is sure, with evidence and advice. A guessed table or an ambiguous orientation of a
    nearly symmetric object only gives a warning, because the hand on the object does not depend on it."""
    notes: tuple[str, ...] = ()
    """Assumptions about the object, such as a guessed mass, as sentences."""
    candidates: tuple[HandCandidate, ...] = ()
    """Candidates that were examined, best first; the result is based on the first."""
    mass_range: tuple[float, float] | None = None
    """80 % interval of a guessed mass [kg]."""
    fitted: FittedShape | None = None
    """Shape fitted to an object without a mesh; None if a mesh was given."""

    def __repr__(self) -> str:
        return f"<Perceived: {self.grasp!r}, {'sure' if self.confident else 'not sure'}>"

    @property
    def confident(self) -> bool:
        """Whether the result is sure."""
        return self.acceptance.sure

    @property
    def grasps(self) -> HumanGraspSet:
        """The grasp as a set, for ``retarget``."""
        return HumanGraspSet.of([self.grasp])

    @property
    def objects(self) -> dict[str, ObjectModel]:
        """The object of the grasp by name, mirrored for a left hand."""
        return dict(self.grasp.objects)

    def as_json(self) -> dict[str, Any]:
        """Return the result for a JSON file. Lengths are in meters, poses are ``[x y z qw qx qy qz]``;
        unknown values are None."""
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
