"""Examples from which the prior of hidden fingers is learned, made of synthesized grasps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.grasps.hand_thickness import FINGER_RADII
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.anatomy_evidence import ALIKE_ROWS
from fungrasp.perception.hand.finger_prior import (
    FREE_ANGLES,
    Distance,
    finger_joints,
    from_free,
    surface_features,
    to_free,
)
from fungrasp.perception.hand.fit import skeleton_through
from fungrasp.perception.hand.skeleton import ANGLE_SPREAD, Skeleton

TRIED = 250
"""Postures that are tried where a finger is put elsewhere."""

NEAR = 0.45
"""Standard deviation of those postures about the one that is aimed at, in units of the usual spread."""

TOUCH, TOUCH_WORST, INSIDE = 0.004, 2.5, 0.003
"""Standard deviation of the gap between a fingertip and the object [m], number of those beyond which the cost
does not grow, and standard deviation of how deep a finger is in the object [m]: tighter than people are, as
the palm's errors are added."""


@dataclass(frozen=True)
class FingerPriorSettings:
    """Settings of the examples and of the learning."""

    copies: int = 4
    """Examples made of each grasp, with different errors of the palm."""
    other_postures: float = 0.6
    """Part of the examples whose fingers are put elsewhere on the object: synthesized grasps of one kind
    close alike, people don't."""
    proportions: float = 0.07
    """Standard deviation of the logarithm of a finger's length."""
    palm_shift: float = 0.005
    """Standard deviation of the palm's place, each axis [m]: an image does not tell it better."""
    palm_turn: float = 0.08
    """Standard deviation of the palm's turn about each axis [rad]."""
    angle_noise: float = 0.3
    """Standard deviation of the known fingers' angles, in units of their usual spread."""
    known: float = 0.5
    """Probability that another finger is known."""
    components: int = 5
    """Gaussians of a mixture."""
    hidden: tuple[int, int] = (128, 96)
    """Units of a network's hidden layers."""
    dropout: float = 0.2
    """Probability that a hidden unit is left out in training."""
    weight_decay: float = 0.03
    """Weight decay of the optimizer (AdamW)."""
    learning_rate: float = 2e-3
    """Learning rate at the beginning; it falls to zero."""
    epochs: int = 25
    """Passes over the examples."""
    minibatch: int = 256
    """Examples in a minibatch."""
    narrowest: float = 0.25
    """Standard deviation of a component, in units of the usual spread, below which a narrower one gains
    nothing: synthesized grasps don't tell people's to that."""


@dataclass(frozen=True, eq=False)
class FingerExamples:
    """N grasps as a finger prior sees them."""

    surface: np.ndarray
    """``surface_features``, shape [N, 294] float32."""
    angles: np.ndarray
    """Angles of all fingers [rad], shape [N, 5, 3, 3] float32."""
    object_name: np.ndarray
    """Of the object, shape [N] str."""

    def select(self, rows: np.ndarray) -> FingerExamples:
        """Some of them."""
        return FingerExamples(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def join(cls, parts: list[FingerExamples]) -> FingerExamples:
        """One after the other."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})


def finger_examples(
    grasps: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    rng: np.random.Generator,
    settings: FingerPriorSettings | None = None,
) -> FingerExamples:
    """Examples of grasps.

    Args:
        grasps: N of them.
        objects: by name.
        rng: random numbers.
        settings: the defaults if None.
    """
    s = settings or FingerPriorSettings()
    surface, angles, names = [], [], []
    for row in range(len(grasps)):
        grasp = grasps[row]
        bank = SignedDistanceBank([objects[grasp.object_name].signed_distance])
        hand = skeleton_through(_other_proportions(grasp, s.proportions, rng), 0.002, iterations=5)
        hand = _in_object_frame(hand, grasp.object_pose)

        def distance(points: np.ndarray, bank: SignedDistanceBank = bank) -> np.ndarray:
            return bank.query(np.zeros(1, dtype=int), points[None])[0][0]

        for _ in range(s.copies):
            held = other_posture(hand, distance, rng) if rng.random() < s.other_postures else hand
            turn = Rotation.from_rotvec(s.palm_turn * rng.normal(size=3)).as_matrix()
            shift = s.palm_shift * rng.normal(size=3)
            seen = replace(held, position=hand.position + shift, turn=turn @ hand.turn)
            surface.append(surface_features(seen, distance))
            angles.append(seen.angles)
            names.append(grasp.object_name)
    return FingerExamples(np.array(surface, np.float32), np.array(angles, np.float32), np.array(names))


def other_posture(hand: Skeleton, distance: Distance, rng: np.random.Generator) -> Skeleton:
    """The hand with its fingers elsewhere on the object: between where they are and a usual posture, drawn at
    random, each in the posture nearby that touches best."""
    now = np.concatenate([to_free(finger, hand.angles[finger][None])[0] for finger in range(5)])
    part = rng.random()
    aim = (1.0 - part) * now + part * rng.multivariate_normal(np.zeros(len(now)), _USUAL)
    angles = hand.angles.copy()
    for finger, own in enumerate(_OWN):
        near = aim[own] + NEAR * rng.normal(size=(TRIED, len(FREE_ANGLES[finger])))
        tried = from_free(finger, near)
        chance = -0.5 * _contact_cost(hand, finger, tried, distance) + rng.gumbel(size=TRIED)
        angles[finger] = tried[chance.argmax()]
    return replace(hand, angles=angles)


def _own() -> list[slice]:
    ends = np.cumsum([len(free) for free in FREE_ANGLES]).tolist()
    return [slice(end - len(free), end) for end, free in zip(ends, FREE_ANGLES, strict=True)]


_OWN = _own()
"""Where each finger's modelled angles stand among those of all fingers."""


def _usual_covariance() -> np.ndarray:
    """Covariance of all modelled angles in units of their usual spread: neighbouring fingers are alike."""
    rows = []
    for row in (ALIKE_ROWS.reshape(-1, 5, 3, 3) * ANGLE_SPREAD).reshape(-1, 5, 3, 3):
        rows.append(np.concatenate([row[f][tuple(np.transpose(FREE_ANGLES[f]))] for f in range(5)]))
    alike = np.array(rows)
    return np.linalg.inv(np.eye(alike.shape[1]) + alike.T @ alike)


_USUAL = _usual_covariance()


def _contact_cost(hand: Skeleton, finger: int, angles: np.ndarray, distance: Distance) -> np.ndarray:
    """Square of how far a finger is from touching with its last link, and inside, shape [S]. angles: [rad],
    shape [S, 3, 3]."""
    joints = finger_joints(hand, finger, angles)
    # The last link's capsule ends before the tip joint, which is on the skin.
    along = np.where(np.arange(3) == 2, 0.8, 1.0)[:, None] * np.array([0.15, 0.5, 0.85])
    samples = joints[:, :-1, None] + along[..., None] * np.diff(joints, axis=1)[:, :, None]
    radius = FINGER_RADII[finger, :-1, None] + along * np.diff(FINGER_RADII[finger])[:, None]
    radius = np.exp(hand.size) * radius.ravel()
    gap = distance(samples.reshape(-1, 3)).reshape(len(angles), -1)
    touch = np.maximum((gap - 0.8 * radius)[:, -3:].min(axis=1), 0.0) / TOUCH
    inside = np.square(np.minimum(gap - 0.5 * radius, 0.0) / INSIDE).sum(axis=1)
    return inside + TOUCH_WORST**2 * touch**2 / (TOUCH_WORST**2 + touch**2)


def _other_proportions(grasp: HumanGrasp, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Joints [m], shape [21, 3], of a hand with other lengths of fingers, whose tips stay where they are."""
    joints = grasp.hand_joints.copy()
    for finger in range(5):
        chain = slice(1 + 4 * finger, 5 + 4 * finger)
        knuckle, tip = joints[1 + 4 * finger], joints[4 + 4 * finger].copy()
        longer = knuckle + np.exp(spread * rng.normal()) * (joints[chain] - knuckle)
        joints[chain] = longer + np.linspace(0, 1, 4)[:, None] * (tip - longer[3])
    return joints


def _in_object_frame(hand: Skeleton, pose: np.ndarray) -> Skeleton:
    """A hand of the world frame in the frame of an object at a pose, shape [7]."""
    turn = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
    return replace(
        hand, position=inverse_transform_points(pose, hand.position[None])[0], turn=turn.T @ hand.turn
    )
