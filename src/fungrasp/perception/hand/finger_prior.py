"""How people bend a finger around an object, given its surface and the known fingers: a distribution.

For each finger a small network gives a mixture of Gaussians of the finger's angles. It sees how far from the
surface the fingers of this hand would be in a set of fixed postures, and the angles of the known fingers.
It is learned from synthesized grasps (``fungrasp.training.finger_prior``); its card is beside the weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.numpy_files import read_npz
from fungrasp.grasps.hand_thickness import FINGER_RADII
from fungrasp.perception.hand.skeleton import (
    ANGLE_MEAN,
    ANGLE_SPREAD,
    BASE_FRAMES,
    BASES,
    LENGTHS,
    Skeleton,
    joint_turns,
)

WEIGHTS = Path(__file__).with_name("weights") / "finger_prior.npz"
"""The weights that come with the package."""

FREE_ANGLES = (*[((0, 0), (0, 1), (1, 1), (2, 1))] * 4, ((0, 0), (0, 1), (0, 2), (1, 1), (2, 1)))
"""For each finger the angles that are modelled: joint, and 0 deviation, 1 flexion, 2 twist."""

SURFACE_RANGE = (-0.015, 0.035)
"""Distances from the surface beyond these [m] are told no further apart."""

DISTANCE_UNIT = 0.02
"""Distance [m] that is 1 to the network."""

Distance = Callable[[np.ndarray], np.ndarray]
"""Signed distance from the object [m], shape [P], of points [m], shape [P, 3], the hand's frame."""


def _probes() -> tuple[np.ndarray, np.ndarray]:
    """Fixed postures [rad] of a finger, shape [20, 3, 3], and of the thumb, [18, 3, 3]."""
    fingers = np.zeros((20, 3, 3))
    for row, (first, second) in enumerate(product((-0.1, 0.3, 0.7, 1.1, 1.5), (0.15, 0.6, 1.05, 1.5))):
        fingers[row, :, 1] = first, second, 0.35 * second
    thumb = np.zeros((18, 3, 3))
    for row, (side, first, second) in enumerate(product((-0.6, 0.0, 0.6), (-0.1, 0.3, 0.7), (-0.1, 0.8))):
        thumb[row, 0, :2] = side, first
        thumb[row, 1:, 1] = 0.4 * second, second
    return fingers, thumb


PROBES = _probes()
"""Fixed postures in which fingers are compared with the surface, and those of the thumb."""


@dataclass(frozen=True, eq=False)
class PostureMixture:
    """Gaussians of M components of the D modelled angles of one finger, in units of their usual spread."""

    finger: int
    """Which finger."""
    log_weight: np.ndarray
    """Logarithm of the probability of each component, shape [M]."""
    mean: np.ndarray
    """Shape [M, D]."""
    factor: np.ndarray
    """Lower triangular ``L`` of each, ``L L^T`` the inverse covariance, shape [M, D, D]."""

    def log_density(self, angles: np.ndarray) -> np.ndarray:
        """Logarithm of the density of postures in those units, shape [S]. angles: [rad], shape [S, 3, 3]."""
        return _log_sum(self._log_parts(to_free(self.finger, angles)))

    def _log_parts(self, free: np.ndarray) -> np.ndarray:
        """Of each component, shape [S, M]. free: shape [S, D]."""
        off = np.einsum("mij,smi->smj", self.factor, free[:, None] - self.mean)
        scale = np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(axis=1)
        constant = -0.5 * free.shape[1] * np.log(2 * np.pi)
        return constant + self.log_weight + scale - 0.5 * np.sum(off**2, axis=-1)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Postures [rad], shape [count, 3, 3]; angles that are not modelled are as usual."""
        which = rng.choice(len(self.log_weight), size=count, p=np.exp(self.log_weight))
        noise = rng.normal(size=(count, self.mean.shape[1], 1))
        off = np.linalg.solve(self.factor[which].transpose(0, 2, 1), noise)[..., 0]
        return from_free(self.finger, self.mean[which] + off)

    def component(self, angles: np.ndarray) -> int:
        """The component that a posture most probably belongs to. angles: [rad], shape [3, 3]."""
        return int(self._log_parts(to_free(self.finger, angles[None]))[0].argmax())


def with_usual(mixture: PostureMixture, part: float) -> PostureMixture:
    """The mixture with one more component, the last: what is usual in grasps, of weight ``1 - part``."""
    size = mixture.mean.shape[1]
    return PostureMixture(
        mixture.finger,
        np.append(mixture.log_weight + np.log(part), np.log(1.0 - part)),
        np.concatenate([mixture.mean, np.zeros((1, size))]),
        np.concatenate([mixture.factor, np.eye(size)[None]]),
    )


def to_free(finger: int, angles: np.ndarray) -> np.ndarray:
    """The modelled angles in units of their usual spread, shape [S, D]. angles: [rad], shape [S, 3, 3]."""
    joint, axis = np.transpose(FREE_ANGLES[finger])
    usual = (angles - ANGLE_MEAN[finger]) / ANGLE_SPREAD[finger]
    return usual[..., joint, axis]


def from_free(finger: int, free: np.ndarray) -> np.ndarray:
    """The reverse: angles [rad], shape [S, 3, 3]; those that are not modelled are as usual."""
    joint, axis = np.transpose(FREE_ANGLES[finger])
    angles = np.tile(ANGLE_MEAN[finger], (len(free), 1, 1))
    angles[:, joint, axis] += free * ANGLE_SPREAD[finger][joint, axis]
    return angles


def surface_features(hand: Skeleton, distance: Distance) -> np.ndarray:
    """How far from the surface this hand's fingers are in the fixed postures, shape [294].

    hand: of which position, turn, size and lengths count.
    """
    points, radii = [], []
    scale = np.exp(hand.size)
    for finger in range(5):
        probes = PROBES[finger == 4]
        joints = finger_joints(hand, finger, probes)
        points += [0.5 * (joints[:, 1] + joints[:, 2]), joints[:, 2], joints[:, 3]]
        radius = scale * FINGER_RADII[finger]
        radii += [np.full(len(probes), r) for r in (0.5 * (radius[1] + radius[2]), radius[2], radius[3])]
    gap = distance(np.concatenate(points)) - np.concatenate(radii)
    return np.clip(gap / scale, *SURFACE_RANGE) / DISTANCE_UNIT


def posture_features(finger: int, angles: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The other fingers' angles where they are known, and which are, shape [N, 26].

    Args:
        finger: the one that is asked for; its own angles are not among them.
        angles: of all fingers [rad], shape [N, 5, 3, 3].
        known: which fingers are known, shape [N, 5].
    """
    known = known & (np.arange(5) != finger)
    rows = [known[:, other, None] * to_free(other, angles[:, other]) for other in range(5)]
    return np.concatenate([*rows, known], axis=1)


def finger_joints(hand: Skeleton, finger: int, angles: np.ndarray) -> np.ndarray:
    """Joints of one finger in several postures [m], shape [S, 4, 3].

    angles: [rad], shape [S, 3, 3]: joint, (deviation, flexion, twist).
    """
    scale = np.exp(hand.size)
    lengths = scale * LENGTHS[finger] * np.exp(hand.bones[finger])
    joints = np.empty((len(angles), 4, 3))
    joints[:, 0] = hand.position + scale * hand.turn @ (BASES[finger] + hand.bases[finger])
    frame = np.broadcast_to(hand.turn @ BASE_FRAMES[finger], (len(angles), 3, 3))
    cosine, sine = np.cos(angles), np.sin(angles)
    for joint in range(3):
        frame = frame @ joint_turns(cosine[:, joint], sine[:, joint])
        joints[:, joint + 1] = joints[:, joint] + lengths[joint] * frame[:, :, 0]
    return joints


class FingerPrior:
    """Networks of all five fingers."""

    def __init__(self, layers: list[list[tuple[np.ndarray, np.ndarray]]]):
        """layers: for each finger the weights, shape [in, out], and biases, [out], of its layers."""
        self._layers = layers

    @classmethod
    def load(cls, path: str | Path) -> FingerPrior:
        """Read a file of weights.

        Raises:
            FungraspError: it is something else.
        """
        data = read_npz(path, "weights of the finger prior")
        try:
            return cls(
                [
                    [(data[f"weight_{f}_{k}"], data[f"bias_{f}_{k}"]) for k in range(int(data["layers"]))]
                    for f in range(5)
                ]
            )
        except KeyError as error:
            raise FungraspError(f"{path} holds no weights of a finger prior: {error} is missing") from error

    def mixture(
        self, finger: int, surface: np.ndarray, angles: np.ndarray, known: np.ndarray
    ) -> PostureMixture:
        """What is probable for one finger.

        Args:
            finger: which.
            surface: ``surface_features`` of the hand.
            angles: of all fingers [rad], shape [5, 3, 3].
            known: which fingers' angles count, bool, shape [5].
        """
        values = np.concatenate([surface, posture_features(finger, angles[None], known[None])[0]])
        *hidden, (last, bias) = self._layers[finger]
        for weight, shift in hidden:
            values = values @ weight + shift
            values = np.where(values > 0, values, np.expm1(np.minimum(values, 0.0)))
        return _mixture(finger, values @ last + bias)


def _mixture(finger: int, out: np.ndarray) -> PostureMixture:
    """From a network's outputs: logits, means, logarithms of the factor's diagonal, the rest of its rows."""
    size = len(FREE_ANGLES[finger])
    count = len(out) // (1 + size + size * (size + 1) // 2)
    logits, mean, diagonal, below = np.split(out, np.cumsum([count, count * size, count * size]))
    factor = np.zeros((count, size, size))
    rows, columns = np.tril_indices(size, -1)
    factor[:, rows, columns] = below.reshape(count, -1)
    factor[:, np.arange(size), np.arange(size)] = np.exp(diagonal.reshape(count, size))
    return PostureMixture(finger, logits - _log_sum(logits[None]), mean.reshape(count, size), factor)


def _log_sum(values: np.ndarray) -> np.ndarray:
    """Logarithm of the sum of exponentials over the last axis."""
    most = values.max(axis=-1, keepdims=True)
    return most[..., 0] + np.log(np.exp(values - most).sum(axis=-1))


@lru_cache(maxsize=1)
def shipped_prior() -> FingerPrior:
    """The one that comes with the package."""
    return FingerPrior.load(WEIGHTS)
