"""A robot hand that follows a moving human hand frame by frame, free or near one object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_conjugate,
    quaternion_multiply,
    rotate,
    rotation_vector,
    transform_points,
)
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid, project_to_surface
from fungrasp.grasps.diagnosis import BENT, diagnosis
from fungrasp.grasps.human_hand import joint_bends, joint_order, mirror_points
from fungrasp.hands import Hand, as_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem
from fungrasp.retargeting.contact_optimization import initial_pose

NO_OBJECT = SignedDistanceBank([SignedDistanceGrid(np.zeros(3), 1.0, np.ones((2, 2, 2), dtype=np.float32))])
"""Placeholder object of a free hand; no cost term uses it."""


@dataclass(frozen=True)
class RetargeterSettings(CheckedRecord):
    """Scale of each cost term (the value that counts as one unit), and iterations."""

    fingertip_unit: float = 0.004
    """Distance of a fingertip from its target [m]."""
    inner_weight: float = 0.2
    """Factor for other joints of the fingers [-]."""
    direction_unit: float = 0.5
    """Difference of the unit vectors along a link [-]."""
    object_unit: float = 0.001
    """Penetration of the object [m]."""
    table_unit: float = 0.001
    """Penetration of the table [m]."""
    self_unit: float = 0.001
    """Self-penetration of the hand [m]."""
    joint_unit: float = 0.5
    """Change of a joint from one frame to the next [rad]."""
    position_unit: float = 0.05
    """Change of the wrist's position in the object from one frame to the next [m]."""
    rotation_unit: float = 0.5
    """Change of the wrist's rotation in the object from one frame to the next [rad]."""
    near: float = 0.012
    """Distance between object and human joint in contact, because of the flesh [m]. The robot's link then
    touches the surface."""
    far: float = 0.03
    """Distance beyond which the object has no effect on the target of a joint [m]."""
    joint_step: float = 0.05
    """Largest change of a joint per frame while the person stands still [rad]."""
    joint_gain: float = 30.0
    """Additional change per meter of human motion [rad/m]: more than twice the rotation of an 8 cm finger."""
    wrist_step: float = 0.005
    """Largest change of the wrist's position relative to the object per frame while the person stands still
    [m]."""
    wrist_gain: float = 2.0
    """Additional change per meter of human motion [-]."""
    rate: float | None = 30.0
    """Frame rate [Hz] for the smoothing of the human joints; None for no smoothing."""
    cutoff: float = 1.0
    """Cutoff frequency of the smoothing for a joint at rest [Hz], as in the paper of the filter."""
    lag: float = 0.004
    """Largest lag by the smoothing, at any speed [m]: about the noise of a tracker."""
    iterations: int = 8
    """Solver iterations of a frame."""
    first_iterations: int = 40
    """Solver iterations of the first frame."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value of the smoothing is not positive.
        """
        super().__post_init__()
        for name in ("rate", "cutoff", "lag"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise FungraspError(f"{name} must be positive, not {value:g}")


class FollowedPose(NamedTuple):
    """A robot hand at one frame."""

    wrist_pose: np.ndarray
    """Pose of the palm body, world frame, shape [7]."""
    joint_positions: np.ndarray
    """Positions of all joints of the hand's model [rad], shape [M]."""


class OneEuroFilter:
    """Smooths moving points: strongly at rest, little in motion.

    A first-order low-pass filter with cutoff frequency f = cutoff + |v| / (2 pi lag), v the smoothed velocity
    (Casiez, Roussel and Vogel, "1 Euro Filter", CHI 2012): a point at speed |v| lags by |v| / (2 pi f) < lag.
    """

    def __init__(self, rate: float, cutoff: float, lag: float):
        """Args: see ``RetargeterSettings``."""
        self._rate, self._cutoff, self._lag = rate, cutoff, lag
        self._seen: np.ndarray | None = None

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the smoothed points of the next frame [m]. points: shape [P, 3]."""
        if self._seen is None:
            self._smooth, self._velocity = points, np.zeros_like(points)
        else:
            velocity = (points - self._seen) * self._rate
            self._velocity = self._velocity + self._share(self._cutoff) * (velocity - self._velocity)
            speed = np.linalg.norm(self._velocity, axis=-1, keepdims=True)
            share = self._share(self._cutoff + speed / (2 * np.pi * self._lag))
            self._smooth = self._smooth + share * (points - self._smooth)
        self._seen = points
        return self._smooth

    def _share(self, frequency: float | np.ndarray) -> Any:
        """Return the fraction of a change that passes in one frame."""
        turn = 2 * np.pi * frequency / self._rate
        return turn / (1 + turn)


class Retargeter:
    """Follows a human hand, free or near one object, which may move.

    The human joints are smoothed, in the object's frame if there is one. Each frame starts from the previous
    result, and the change is bounded: small human motions cause small robot motions. Fingertips and joints
    follow the human's, within joint limits and without self-collision. Near the object, they move to its
    surface where the human touches it. For single grasps, ``fungrasp.retarget`` takes more time and also
    optimizes contacts and the balance of forces.
    """

    def __init__(
        self,
        hand: Hand | str | Path,
        model: ObjectModel | None = None,
        settings: RetargeterSettings | None = None,
        *,
        order: str = "fungrasp",
    ):
        """
        Args:
            hand: robot hand, its name, or the path of its TOML file.
            model: the object; None for a free hand.
            settings: weights and iterations; defaults if None.
            order: joint order of the input of ``follow``: "mediapipe", "openpose", "mano" and others.

        Raises:
            FungraspError: hand or order is unknown, or ``model`` is not an object.
        """
        if not isinstance(model, ObjectModel | None):
            raise FungraspError(
                f"model must be an object (fungrasp.load_object, fungrasp.object_from_mesh), not a "
                f"{type(model).__name__}"
            )
        self.hand = as_hand(hand)
        """The robot hand. Results follow its ``joint_names``."""
        self._settings, self._order = RetargeterSettings.given(settings), joint_order(order)
        self._points = HandPoints(HandKinematics(self.hand, 1))
        self._scene = None
        if model is not None:
            origin = np.array([[0, 0, 0, 1.0, 0, 0, 0]])
            self._scene = CollisionScene.settled([model.name], origin, {model.name: model})
        self._last: tuple[np.ndarray, np.ndarray] | None
        self._joints = np.zeros((1, 21, 3))
        self.reset()

    def reset(self) -> None:
        """Forget the previous frame; the next one is solved from scratch."""
        self._last, self._smooth, self._side_seen = None, self._filter(), False

    def _filter(self) -> Callable[[np.ndarray], np.ndarray]:
        s = self._settings
        return (lambda points: points) if s.rate is None else OneEuroFilter(s.rate, s.cutoff, s.lag)

    def follow(self, hand_joints: np.ndarray, object_pose: np.ndarray | None = None) -> FollowedPose:
        """Return the robot hand at the next frame.

        Args:
            hand_joints: human joints of the robot hand's side [m], world frame, shape [21, 3]. For a free
                hand, any fixed frame works.
            object_pose: world frame, shape [7]; the table is the plane z = 0. None for a free hand.

        Raises:
            FungraspError: a shape is wrong, a value is not finite, or a pose is given without an object or
                missing with one. At the first frame: the joints are in another order or unit. Until the
                fingers have bent: the hand is of the other side.
        """
        if (object_pose is None) != (self._scene is None):
            raise FungraspError("object_pose is given where the retargeter has an object, and only there")
        for name, array, shape in (
            ("hand_joints", hand_joints, (21, 3)),
            ("object_pose", np.zeros(7) if object_pose is None else object_pose, (7,)),
        ):
            if np.shape(array) != shape or not np.all(np.isfinite(array)):
                raise FungraspError(f"{name} must be finite numbers of shape {shape}")
        world = np.asarray(hand_joints, dtype=float)[self._order]
        self._check_convention(world)
        if object_pose is None:
            # In the palm frame, motions of a free hand as a whole are not limited.
            world = self._smooth(world)
            pose = _palm_frame(world)
            joints = transform_points(invert(pose), world)[None]
        else:
            pose = np.asarray(object_pose, dtype=float)
            joints = self._smooth(transform_points(invert(pose), world))[None]
        problem = self._problem(joints, pose)
        first = self._last is None
        start = initial_pose(self._points, problem) if self._last is None else self._last
        wrist, independent, _ = minimize(
            self._points,
            problem,
            self._objective(problem, None if first else start),
            *start,
            self._settings.first_iterations if first else self._settings.iterations,
        )
        if self._last is not None:
            motion = float(np.linalg.norm(joints - self._joints, axis=-1).max())
            wrist, independent = self._bounded(self._last, (wrist, independent), motion)
        self._last, self._joints = (wrist, independent), joints
        return FollowedPose(compose(pose, wrist[0]), self._points.kinematics.hand.all_joints(independent[0]))

    def _check_convention(self, joints: np.ndarray) -> None:
        right = joints if self.hand.side == "right" else mirror_points(joints)
        if self._last is None:
            fault = diagnosis({"hand_joints": right[None]}, {}, sides=False).fatal
            if fault is not None:
                raise FungraspError(
                    f"hand_joints: {fault.words}; follow takes meters, and joints in the order that "
                    "Retargeter(order=...) names"
                )
        if not self._side_seen:
            # Outer finger joints hardly bend backwards. A flat hand shows no side.
            bend = joint_bends(right)[0][:4, 1:].sum()
            if bend < -BENT:
                raise FungraspError(
                    f"hand_joints: the fingers bend backwards for a {self.hand.side} hand, the side of "
                    f"'{self.hand.name}'; mirror the joints (fungrasp.grasps.human_hand.mirror_points), or "
                    "use a robot hand of the other side"
                )
            self._side_seen = bool(bend > BENT)

    def _problem(self, joints: np.ndarray, pose: np.ndarray) -> RetargetingProblem:
        up = rotate(quaternion_conjugate(pose[3:]), np.array([0.0, 0.0, 1.0]))[None, None]
        far = joints[:, self._points.match.human_far]
        if self._scene is None:
            scene = CollisionScene(NO_OBJECT, np.zeros(1, dtype=int), up, pose[None, 2:3])
            surface, normals = far, np.zeros_like(far)
        else:
            scene = replace(self._scene, up=up, height=pose[None, 2:3])
            surface, normals = project_to_surface(scene.bank, scene.grid, far)
        return RetargetingProblem(
            **{f.name: getattr(scene, f.name) for f in fields(CollisionScene)},
            joints=joints,
            contacts=np.zeros((1, 1 + len(self._points.match.far)), dtype=bool),
            surface=surface,
            normals=normals,
            center=np.zeros((1, 3)),
            extent=np.ones(1),
            weight=np.ones(1),
        )

    def _bounded(
        self, last: tuple[np.ndarray, np.ndarray], found: tuple[np.ndarray, np.ndarray], motion: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the allowed part of the change since the previous frame. A much better posture is reached
        over several frames.

        Args:
            last, found: wrist pose, shape [1, 7], and independent joints, shape [1, U].
            motion: human motion since the last frame, object frame [m].
        """
        s, (pose, joints) = self._settings, last
        turn = rotation_vector(quaternion_multiply(found[0][:, 3:], quaternion_conjugate(pose[:, 3:])))
        tangent = np.concatenate([found[0][:, :3] - pose[:, :3], turn, found[1] - joints], axis=1)
        joint_limit, wrist_limit = s.joint_step + s.joint_gain * motion, s.wrist_step + s.wrist_gain * motion
        largest = max(
            np.abs(tangent[0, 3:]).max() / joint_limit, np.linalg.norm(tangent[0, :3]) / wrist_limit
        )
        return found if largest <= 1 else self._points.kinematics.step(pose, joints, tangent / largest)

    def _objective(
        self, problem: RetargetingProblem, last: tuple[np.ndarray, np.ndarray] | None
    ) -> list[partial]:
        s, match = self._settings, self._points.match
        weight = np.where(match.is_last, 1.0, s.inner_weight)[None] / s.fingertip_unit
        objective = [
            partial(terms.keypoint_position, which=match.far, target=self._targets(problem), weight=weight),
            partial(terms.link_direction, unit=s.direction_unit),
            partial(terms.self_penetration, unit=s.self_unit),
        ]
        if self._scene is not None:
            objective += [
                partial(terms.object_penetration, unit=s.object_unit),
                partial(terms.table_penetration, unit=s.table_unit),
            ]
        if last is not None:
            units = {"unit": s.joint_unit, "position_unit": s.position_unit, "rotation_unit": s.rotation_unit}
            objective.append(partial(terms.stay_near, start=last, **units))
        return objective

    def _targets(self, problem: RetargetingProblem) -> np.ndarray:
        """Return targets of the links' far key points [m], shape [1, S, 3]."""
        s, human = self._settings, self._points.match.human_far
        if self._scene is None:
            return problem.joints[:, human]
        joints, surface, normals = problem.joints[:, human], problem.surface, problem.normals
        touching = surface + self._points.far_radius[:, None] * normals
        distance = np.sum((joints - surface) * normals, axis=-1, keepdims=True)
        share = np.clip((s.far - distance) / (s.far - s.near), 0.0, 1.0)
        # Smooth at both ends, to avoid jerks when a hand approaches.
        share = share * share * (3 - 2 * share)
        return joints + share * (touching - joints)


def _palm_frame(joints: np.ndarray) -> np.ndarray:
    """Return a frame that moves with the palm: origin at the wrist, one axis to the middle finger, one
    across.

    Args:
        joints: human joints, shape [21, 3].

    Returns:
        Pose in the frame of the joints, shape [7].
    """
    fingers, across = joints[5] - joints[0], joints[1] - joints[13]
    x = fingers / np.linalg.norm(fingers)
    z = np.cross(x, across)
    z = z / np.linalg.norm(z)
    turn = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=-1))
    return np.concatenate([joints[0], turn.as_quat(scalar_first=True)])
