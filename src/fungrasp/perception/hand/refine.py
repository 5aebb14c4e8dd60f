"""A hand's estimate, whoever made it, brought to agree with the object it holds and the table.

The joints estimated before are evidence as good as their covariances say. Where the image itself is at hand,
``fit_hand`` with the same surroundings uses it too and does better.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.hand.evidence import Evidence, anatomy_evidence
from fungrasp.perception.hand.gauss_newton import damped_step, normal_equations
from fungrasp.perception.hand.initial_skeleton import (
    joint_confidence,
    joint_covariance,
    mirror_estimate,
    skeleton_through,
)
from fungrasp.perception.hand.object_contact import ContactSettings, Surroundings, contact_evidence
from fungrasp.perception.hand.skeleton import SIZE, Skeleton

ITERATIONS = 10


def refine_hand(
    hand: HandEstimate,
    surface: SignedDistanceGrid,
    pose_camera_object: np.ndarray,
    table: np.ndarray | None = None,
    settings: ContactSettings | None = None,
) -> HandEstimate:
    """The hand that touches what it nearly touches and is inside of nothing.

    Args:
        hand: as the image tells it.
        surface: of the object, object's frame.
        pose_camera_object: shape [7].
        table: plane ``n x + d = 0`` of the table top, camera frame, shape [4]: unit normal away from the
            table, offset [m].
        settings: what contact is worth against the estimate.

    Returns:
        The same hand with other joints, covariances and confidences.
    """
    settings = settings or ContactSettings()
    around = Surroundings(surface, pose_camera_object, table)
    if hand.side == "left":
        refined = _refine(mirror_estimate(hand, hand.pixels), around.mirrored(), settings)
        return mirror_estimate(refined, hand.pixels)
    return _refine(hand, around, settings)


def _refine(hand: HandEstimate, around: Surroundings, settings: ContactSettings) -> HandEstimate:
    # W with W^T W the inverse covariance.
    whiten = np.linalg.cholesky(np.linalg.inv(hand.covariance)).transpose(0, 2, 1)

    def evidence(skeleton: Skeleton) -> list[Evidence]:
        joints, jacobian = skeleton.joints_and_derivatives()
        off = np.einsum("jab,jb->ja", whiten, joints - hand.joints_camera)
        return [
            Evidence(off.ravel(), (whiten @ jacobian).reshape(63, SIZE), outlier=6.0, group=3),
            *anatomy_evidence(skeleton),
            *contact_evidence(skeleton, joints, jacobian, around, settings),
        ]

    skeleton = skeleton_through(hand.joints_camera, 0.004)
    for _ in range(ITERATIONS):
        skeleton = skeleton.moved(damped_step(*normal_equations(evidence(skeleton), SIZE)))
    joints, jacobian = skeleton.joints_and_derivatives()
    matrix, _ = normal_equations(evidence(skeleton), SIZE)
    covariance = joint_covariance(matrix, jacobian)
    return dataclasses.replace(
        hand, joints_camera=joints, covariance=covariance, confidence=joint_confidence(covariance)
    )
