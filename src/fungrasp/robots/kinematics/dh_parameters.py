"""An arm's kinematics as Denavit-Hartenberg parameters, which controllers tell, and our models after them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
)
from fungrasp.hands.arm import FLANGE_SITE


@dataclass(frozen=True, eq=False)
class DHParameters:
    """Of an arm with M joints: joint i turns about the z axis of frame i, and the next frame is
    Rz(theta_i + angle) Tz(d_i) Tx(a_i) Rx(alpha_i) from it. The last one is the flange's."""

    theta: np.ndarray
    """Angle of each joint at its zero [rad], shape [M]."""
    a: np.ndarray
    """Distances along x [m], shape [M]."""
    d: np.ndarray
    """Distances along z [m], shape [M]."""
    alpha: np.ndarray
    """Twists about x [rad], shape [M]."""

    def frames(self, joints: np.ndarray) -> np.ndarray:
        """Poses of the joints' frames and of the flange in the frame of the first joint, shape [M + 1, 7].

        Args:
            joints: [rad], shape [M].
        """
        zero = np.zeros_like(self.a)
        turns = quaternion_from_rotation_vector(np.stack([zero, zero, self.theta + joints], axis=-1))
        twists = quaternion_from_rotation_vector(np.stack([self.alpha, zero, zero], axis=-1))
        along = rotate(turns, np.stack([self.a, zero, self.d], axis=-1))
        steps = np.concatenate([along, quaternion_multiply(turns, twists)], axis=-1)
        found = [np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])]
        for step in steps:
            found.append(compose(found[-1], step))
        return np.array(found)


def moved_to_parameters(spec: mujoco.MjSpec, parameters: DHParameters, base: np.ndarray) -> None:
    """Put the joints of an arm's model where the parameters of one arm say.

    What matters of a joint is the line it turns about. So each frame goes to the nearest point of its line,
    turned by the least that makes their z axes one: where two joints are parallel but for a calibration,
    frames of the parameters lie meters away along their lines.

    Args:
        spec: of the arm: bodies one in the other, joints that turn about z, the site ``FLANGE_SITE`` last.
        parameters: of the arm, as many joints as the model's.
        base: pose of the parameters' first frame in the model's, shape [7].
    """
    lines = np.array([compose(base, frame) for frame in parameters.frames(np.zeros_like(parameters.a))])
    chain, body = [], spec.site(FLANGE_SITE).parent
    while body.name != spec.worldbody.name:
        chain.append(body)
        body = body.parent
    nominal, actual = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.array([0.0] * 3 + [1.0] + [0.0] * 3)
    joint = 0
    for body in reversed(chain):
        nominal = compose(nominal, np.concatenate([body.pos, body.quat]))
        if body.joints:
            moved = _onto_line(nominal, lines[joint])
            local = compose(invert(actual), moved)
            body.pos, body.quat = local[:3], local[3:]
            actual, joint = moved, joint + 1
        else:
            actual = compose(actual, np.concatenate([body.pos, body.quat]))
    site = spec.site(FLANGE_SITE)
    flange = compose(invert(actual), lines[-1])
    site.pos, site.quat = flange[:3], flange[3:]


def _onto_line(frame: np.ndarray, line: np.ndarray) -> np.ndarray:
    """A frame moved so that its z axis lies on that of another one, poses of shape [7]."""
    up = np.array([0.0, 0.0, 1.0])
    z, wanted = rotate(frame[3:], up), rotate(line[3:], up)
    axis = np.cross(z, wanted)
    size = np.linalg.norm(axis)
    turn = axis * (np.arctan2(size, z @ wanted) / size) if size > 0 else axis
    along = (frame[:3] - line[:3]) @ wanted
    return np.concatenate(
        [line[:3] + along * wanted, quaternion_multiply(quaternion_from_rotation_vector(turn), frame[3:])]
    )
