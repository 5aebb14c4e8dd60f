"""Skeleton of a right hand with adjustable bone lengths, its derivatives, and robust least squares.

Palm frame: origin at the wrist, x toward the middle finger's knuckle, y toward the index finger's side, z out
of the back of the hand. A finger has three bones along their own x axes; each of its three joints rotates
about z (deviation, toward the index finger's side), then y (flexion), then x (twist).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.grasps.human_hand import FLEXION_RANGE

FINGERS, JOINTS_OF_FINGER = 5, 3

BASES = np.array(
    [[87.5, 23.5, -5.5], [94.5, 0.0, 0.0], [82.5, -24.0, -1.0], [70.5, -41.5, -5.5], [23.5, 25.5, -17.0]]
)
BASES *= 1e-3
"""Finger bases of an adult's hand [m], palm frame, shape [5, 3]: those of the built-in grasps, like most data
sets of tracked hands. Radiographs put knuckles about 8 mm nearer to the wrist, but define another wrist."""

LENGTHS = np.array(
    [[33.0, 22.0, 23.5], [31.5, 23.5, 31.5], [29.0, 25.0, 30.5], [21.0, 19.0, 23.0], [31.0, 27.0, 38.0]]
)
LENGTHS *= 1e-3
"""Bone lengths of the same hand [m], shape [5, 3]; the last bones end at the skin."""

# Direction of the thumb's metacarpal at rest, palm frame: 45 degrees from the palm's plane and index finger.
THUMB_DIRECTION = np.array([0.66, 0.53, -0.53])
# Direction in which the flexing thumb's tip moves, palm frame: across the palm.
THUMB_FLEXION = np.array([0.0, -0.8, -0.6])
# Layout of a step: position [m] and rotation of the palm (camera frame), logarithm of the hand's size, shifts
# of the five finger bases [m] (palm frame), logarithms of 15 bone lengths, 45 angles [rad]: finger, joint,
# (deviation, flexion, twist).
PARAMETERS = {
    "position": slice(0, 3),
    "turn": slice(3, 6),
    "size": slice(6, 7),
    "bases": slice(7, 22),
    "bones": slice(22, 37),
    "angles": slice(37, 82),
}
SIZE = 82  # Number of parameters.


def _base_frames() -> np.ndarray:
    frames = np.empty((FINGERS, 3, 3))
    # Extended fingers spread half as much as the bones of the palm.
    spread = 0.5 * np.arctan2(BASES[:4, 1], BASES[:4, 0])
    frames[:4] = Rotation.from_euler("z", spread[:, None]).as_matrix().reshape(4, 3, 3)
    x = THUMB_DIRECTION / np.linalg.norm(THUMB_DIRECTION)
    y = np.cross(x, THUMB_FLEXION)
    y /= np.linalg.norm(y)
    frames[4] = np.stack([x, y, np.cross(x, y)], axis=1)
    return frames


BASE_FRAMES = _base_frames()  # Axes of extended fingers as columns, palm frame, shape [5, 3, 3].


def _angle_priors() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    low, high = np.full((5, 3, 3), -np.inf), np.full((5, 3, 3), np.inf)
    low[..., 1], high[..., 1] = FLEXION_RANGE[..., 0], FLEXION_RANGE[..., 1]
    mean, spread = np.zeros((5, 3, 3)), np.empty((5, 3, 3))
    mean[:4, 0, 0] = np.radians([-9.0, -7.0, -2.0, 2.0])
    mean[:, :, 1] = np.radians([[20, 41, 14], [29, 42, 17], [31, 44, 15], [36, 38, 12], [18, 4, 20]])
    spread[:] = np.radians([5.0, 25.0, 6.0])
    spread[:, :, 1] = np.radians([25.0, 20.0, 12.0])
    spread[:4, 0, 0], spread[:4, 0, 2] = np.radians([7.0, 6.0, 5.0, 9.0]), np.radians(8.0)
    spread[4, 0], spread[4, 1] = np.radians([25.0, 15.0, 25.0]), np.radians([8.0, 12.0, 8.0])
    spread[4, 2, 1] = np.radians(15.0)
    return mean, spread, low, high


# Usual angles in grasps, their standard deviations, and the limits of flexion [rad], shape [5, 3, 3]: finger,
# joint, (deviation, flexion, twist). Fingers are hinges: only their first joints deviate by much. Mean and
# spread of flexion and deviation are about those of the built-in grasps and 289 of DexYCB, pooled.
ANGLE_MEAN, ANGLE_SPREAD, ANGLE_LOW, ANGLE_HIGH = _angle_priors()
# Standard deviation of the difference between flexions of neighboring fingers, by joint [rad]. In the same
# grasps, the other fingers predict each flexion to 4 to 10 degrees.
ALIKE_SPREAD = np.radians([12.0, 13.0, 9.0])


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Parameters of one hand."""

    position: np.ndarray
    """Position of the wrist [m], camera frame, shape [3]."""
    turn: np.ndarray
    """Rotation of the palm frame, shape [3, 3]."""
    size: float
    """Logarithm of the size, 0 for a mean adult."""
    bases: np.ndarray
    """Shift of the finger bases [m], palm frame, for a hand of mean size, shape [5, 3]."""
    bones: np.ndarray
    """Logarithm of the bone lengths relative to the template, shape [5, 3]."""
    angles: np.ndarray
    """Joint angles [rad], shape [5, 3, 3]: finger, joint, (deviation, flexion, twist)."""

    @classmethod
    def usual(cls, position: np.ndarray, turn: np.ndarray) -> Skeleton:
        """Create a hand of usual proportions and angles."""
        return cls(position, turn, 0.0, np.zeros((5, 3)), np.zeros((5, 3)), ANGLE_MEAN)

    def moved(self, step: np.ndarray) -> Skeleton:
        """Return the skeleton after a step, shape [``SIZE``]; the palm rotates about the camera's axes."""
        part = {name: step[where] for name, where in PARAMETERS.items()}
        return Skeleton(
            self.position + part["position"],
            Rotation.from_rotvec(part["turn"]).as_matrix() @ self.turn,
            float(np.clip(self.size + part["size"][0], -0.5, 0.5)),
            self.bases + part["bases"].reshape(5, 3),
            np.clip(self.bones + part["bones"].reshape(5, 3), -0.5, 0.5),
            self.angles + part["angles"].reshape(5, 3, 3),
        )

    def joints(self) -> np.ndarray:
        """Return joints [m], shape [21, 3], camera frame, in the order of ``HUMAN_JOINTS``."""
        return self._forward()[0]

    def joints_and_derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ``joints`` and their derivatives by the parameters, shape [21, 3, ``SIZE``]."""
        joints, axes, directions = self._forward()
        scale = np.exp(self.size)
        jacobian = np.zeros((21, 3, SIZE))
        jacobian[:, :, PARAMETERS["position"]] = np.eye(3)
        arm = joints - self.position
        jacobian[:, :, PARAMETERS["turn"]] = -_cross_matrices(arm)
        jacobian[:, :, 6] = arm
        fingers = joints[1:].reshape(5, 4, 3)
        of_fingers = jacobian[1:].reshape(5, 4, 3, SIZE)
        lengths = scale * LENGTHS * np.exp(self.bones)
        stretch = lengths[..., None] * directions
        for joint in range(JOINTS_OF_FINGER):
            reach = fingers[:, joint + 1 :] - fingers[:, joint, None]
            # a x r for each axis a (columns) and each vector r.
            turned = -_cross_matrices(reach) @ axes[:, joint, None]
            for finger in range(FINGERS):
                bone = PARAMETERS["bones"].start + 3 * finger + joint
                of_fingers[finger, joint + 1 :, :, bone] = stretch[finger, joint]
                angle = PARAMETERS["angles"].start + 9 * finger + 3 * joint
                of_fingers[finger, joint + 1 :, :, angle : angle + 3] = turned[finger]
        for finger in range(FINGERS):
            base = PARAMETERS["bases"].start + 3 * finger
            of_fingers[finger, :, :, base : base + 3] = scale * self.turn
        return joints, jacobian

    def _forward(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return joints; rotation axes as columns, shape [5, 3, 3, 3]; bone directions, shape [5, 3, 3]."""
        scale = np.exp(self.size)
        lengths = scale * LENGTHS * np.exp(self.bones)
        joints = np.empty((21, 3))
        joints[0] = self.position
        fingers = joints[1:].reshape(5, 4, 3)
        fingers[:, 0] = self.position + scale * (BASES + self.bases) @ self.turn.T
        axes, directions = finger_axes(self.turn @ BASE_FRAMES, self.angles)
        fingers[:, 1:] = fingers[:, :1] + np.cumsum(lengths[..., None] * directions, axis=1)
        return joints, axes, directions

    def finger_joints(self, finger: int, angles: np.ndarray) -> np.ndarray:
        """Return the joints of one finger in S postures [m], camera frame, shape [S, 4, 3].

        angles: [rad], shape [S, 3, 3]: joint, (deviation, flexion, twist).
        """
        scale = np.exp(self.size)
        lengths = scale * LENGTHS[finger] * np.exp(self.bones[finger])
        frames = np.broadcast_to(self.turn @ BASE_FRAMES[finger], (len(angles), 3, 3))
        _, directions = finger_axes(frames, angles)
        base = self.position + scale * self.turn @ (BASES[finger] + self.bases[finger])
        reach = np.cumsum(lengths[:, None] * directions, axis=1)
        return base + np.concatenate([np.zeros((len(angles), 1, 3)), reach], axis=1)


def finger_axes(frames: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation axes of F fingers as columns, shape [F, 3, 3, 3], and bone directions, [F, 3, 3].

    Args:
        frames: axes of extended fingers as columns, shape [F, 3, 3].
        angles: [rad], shape [F, 3, 3]: joint, (deviation, flexion, twist).
    """
    axes, directions = np.empty((len(angles), 3, 3, 3)), np.empty((len(angles), 3, 3))
    cosine, sine = np.cos(angles), np.sin(angles)
    for joint in range(JOINTS_OF_FINGER):
        c, s = cosine[:, joint], sine[:, joint]
        axes[:, joint, :, 0] = frames[:, :, 2]
        frames = frames @ _turns(2, c[:, 0], s[:, 0])
        axes[:, joint, :, 1] = frames[:, :, 1]
        frames = frames @ _turns(1, c[:, 1], s[:, 1])
        axes[:, joint, :, 2] = directions[:, joint] = frames[:, :, 0]
        frames = frames @ _turns(0, c[:, 2], s[:, 2])
    return axes, directions


def _turns(axis: int, c: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return rotations about an axis, shape [F, 3, 3]. c, s: cosine and sine of the angles, shape [F]."""
    turns = np.zeros((len(c), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turns[:, axis, axis] = 1.0
    turns[:, i, i] = turns[:, j, j] = c
    turns[:, i, j], turns[:, j, i] = -s, s
    return turns


def _cross_matrices(v: np.ndarray) -> np.ndarray:
    """Return ``M`` with ``M w = v x w``, shape [..., 3, 3]. v: shape [..., 3]."""
    matrices = np.zeros((*v.shape, 3))
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrices[..., j, i], matrices[..., i, j] = v[..., axis], -v[..., axis]
    return matrices


# Largest change of a parameter in one step [m] or [rad], within which derivatives are valid.
LONGEST_STEP = {"position": 0.05, "turn": 0.5, "angles": 0.5}


@dataclass(frozen=True, eq=False)
class HandEvidence:
    """A block of R residuals with derivatives."""

    residual: np.ndarray
    """Residuals in standard deviations, shape [R]."""
    jacobian: np.ndarray
    """Derivatives by the parameters, shape [R, n]; n may be less than the number of parameters."""
    outlier: float | np.ndarray = np.inf
    """Residual beyond which the weight falls: one limit for all, or one per group, shape [R / group]."""
    group: int = 1
    """Number of consecutive residuals that form one measurement, weighted by their norm."""


def normal_equations(evidence: Iterable[HandEvidence], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the weighted normal matrix, shape [size, size], and the gradient, shape [size].

    A residual (or group) of norm r with outlier limit c has the weight ``(c^2 / (c^2 + r^2))^2`` of the
    Geman-McClure loss.

    Args:
        evidence: blocks; those with fewer than ``size`` columns do not depend on the last parameters.
        size: number of parameters.
    """
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for block in evidence:
        columns = block.jacobian.shape[1]
        weighted = (block.jacobian * robust_weights(block)[:, None]).T
        matrix[:columns, :columns] += weighted @ block.jacobian
        gradient[:columns] += weighted @ block.residual
    return matrix, gradient


def robust_weights(block: HandEvidence) -> np.ndarray:
    """Return the weight of each residual, 0 to 1, shape [R]."""
    square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
    return np.repeat((1.0 + square / np.square(block.outlier)) ** -2.0, block.group)


def damped_step(matrix: np.ndarray, gradient: np.ndarray, damping: float = 1e-3) -> np.ndarray:
    """Return a step towards the least-squares solution, shortened to ``LONGEST_STEP``.

    Args:
        matrix, gradient: normal equations; the first parameters are those of a skeleton.
        damping: damping of each parameter, as a fraction of its curvature.
    """
    step = -np.linalg.solve(matrix + np.diag(damping * np.diag(matrix) + 1e-9), gradient)
    largest = max(float(np.abs(step[PARAMETERS[kind]]).max()) / most for kind, most in LONGEST_STEP.items())
    return step / max(1.0, largest)


def robust_cost(evidence: Iterable[HandEvidence]) -> float:
    """Return the sum of ``r^2 / (1 + r^2 / c^2)`` over residuals (or groups) of norm r, outlier limit c."""
    total = 0.0
    for block in evidence:
        square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
        total += float(np.sum(square / (1.0 + square / np.square(block.outlier))))
    return total
