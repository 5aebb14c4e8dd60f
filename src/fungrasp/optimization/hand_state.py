"""N robot hands at one iterate of the solver: key points, collision spheres, distances, Jacobians."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Generic, Self, TypeVar

import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.collisions import CollisionSpheres, collision_spheres
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.hand_arrays import HandArrays, SelfPairs, hand_arrays

DENSE_SPACING = 0.006
"""Distance of the collision spheres with which solutions are judged [m]."""


class HandPoints:
    """The points of a hand that the terms use: key points, collision spheres, and how human links map to
    them."""

    def __init__(self, kinematics: HandKinematics, spacing: float = 0.018):
        hand = kinematics.hand
        self.kinematics = kinematics
        self.match = correspond(hand)
        self.keypoints: BodyPoints = kinematics.body_points(hand.keypoint_names)
        self.spheres: CollisionSpheres = collision_spheres(hand, spacing)
        self.far_radius = self._thickness()
        self.link_members = [np.flatnonzero(self.spheres.link == link) for link in range(len(hand.links))]
        self.self_pairs = _self_pairs(hand, self.spheres)

    def for_hands(self, count: int) -> Self:
        """The same points of ``count`` hands, for another thread: what does not move is shared, ``dense``
        where it is there already."""
        other = copy(self)
        other.__dict__["arrays"] = self.arrays
        other.kinematics = HandKinematics(self.kinematics.hand, count)
        if "dense" in self.__dict__:
            other.__dict__["dense"] = dense = copy(self.dense)
            dense.kinematics = other.kinematics
        return other

    @cached_property
    def dense(self) -> HandPoints:
        """With more spheres, to judge solutions: what lies between the solver's must not go into the object
        unseen."""
        dense = HandPoints(self.kinematics, DENSE_SPACING)
        _ = dense.arrays
        return dense

    @cached_property
    def arrays(self) -> HandArrays:
        """The same for compiled loops."""
        return hand_arrays(self.kinematics, self.keypoints, self.spheres, self.self_pairs)

    def _thickness(self) -> np.ndarray:
        """Radius of the hand around the far key point of each finger link [m], shape [S]: of its nearest
        sphere."""
        radii = []
        for link, (near, far) in enumerate(zip(self.match.near, self.match.far, strict=True), start=1):
            members = np.flatnonzero(self.spheres.link == link)
            same = self.keypoints.bodies[far] == self.keypoints.bodies[near]
            if not len(members):
                radii.append(0.0)
            elif same:
                gaps = np.linalg.norm(
                    self.spheres.points.offsets[members] - self.keypoints.offsets[far], axis=1
                )
                radii.append(self.spheres.radius[members[np.argmin(gaps)]])
            else:
                radii.append(float(np.median(self.spheres.radius[members])))
        return np.array(radii)


def _self_pairs(hand: Hand, spheres: CollisionSpheres) -> SelfPairs:
    """Rounded links of different fingers."""
    finger = np.array([-1, *(i for i, f in enumerate(hand.fingers.values()) for _ in f.links)])
    round_spheres = np.flatnonzero((spheres.radius > 0) & (finger[spheres.link] >= 0))
    owner = finger[spheres.link[round_spheres]]
    return SelfPairs(round_spheres, round_spheres, owner[:, None] < owner)


ProblemT = TypeVar("ProblemT", bound=CollisionScene)


class HandState(Generic[ProblemT]):
    """N hands at one iterate of the solver, object frame: positions, distances, and Jacobians on demand.

    Jacobians are with respect to the D = 6 + U tangent coordinates of ``HandKinematics``: wrist translation
    [m], wrist rotation [rad], independent joints [rad].
    """

    def __init__(
        self, points: HandPoints, problem: ProblemT, wrist_pose: np.ndarray, independent: np.ndarray
    ):
        self.points, self.problem = points, problem
        self.wrist_pose, self.independent = wrist_pose, independent
        points.kinematics.update(wrist_pose, independent)
        self.keypoints = points.kinematics.points(points.keypoints)
        """Key points [m], shape [N, K, 3]."""
        self.spheres = points.kinematics.points(points.spheres.points)
        """Centers of the collision spheres [m], shape [N, P, 3]."""
        distance, gradient = problem.bank.query(problem.grid, self.spheres)
        self.clearance = distance - points.spheres.radius
        """Distance of each sphere's surface from the object [m], shape [N, P]; negative where it
        penetrates."""
        self.normals = gradient
        """Gradient of the distance at the centers, shape [N, P, 3]: about a unit vector out of the object."""
        # [N, P, 3] . [N, T, 3] + [N, 1, T]: height of each center above each of the T planes.
        heights = np.einsum("npi,nti->npt", self.spheres, problem.up) + problem.height[:, None]
        self.heights = heights.min(axis=2) - points.spheres.radius
        """Distance of each sphere's surface from the nearest plane [m], shape [N, P]."""

    def sphere_jacobian(self, which: np.ndarray) -> np.ndarray:
        """Jacobian of some centers. which: sphere indices, shape [N, Q]; returns shape [N, Q, 3, D]."""
        positions = np.take_along_axis(self.spheres, which[..., None], axis=1)
        return self.points.kinematics.jacobian(self.points.spheres.points.bodies[which], positions)
