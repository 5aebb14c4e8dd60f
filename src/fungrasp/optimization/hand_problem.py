"""What the optimiser is given and what it looks at in each iteration, everything in the object's frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Generic, NamedTuple, Self, TypeVar

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import invert, rotate, transform_points
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.correspondence import Correspondence, correspond
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.hands.shape import HandBalls, hand_balls
from fungrasp.objects import ObjectModel
from fungrasp.objects.resting_pose import settled_up


@dataclass(frozen=True)
class Surroundings:
    """What N hands may collide with: an object each, and the table, in the object's frame."""

    bank: SignedDistanceBank
    grid: np.ndarray
    """Which grid of the bank, shape [N]."""
    up: np.ndarray
    """Normals of the planes to stay above, shape [N, T, 3]."""
    height: np.ndarray
    """Height of the object's origin above each plane [m], shape [N, T]: a point p is at up . p + height."""

    @classmethod
    def settled(
        cls, names: Sequence[str], pose: np.ndarray, objects: Mapping[str, ObjectModel]
    ) -> Surroundings:
        """One plane: the table under objects that have settled.

        Args:
            names: of the object of each hand, length N.
            pose: of the objects, world frame, shape [N, 7].
            objects: by name.
        """
        known = sorted(set(names))
        up = rotate(invert(pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
        grid = np.array([known.index(name) for name in names])
        return cls(
            SignedDistanceBank([objects[name].signed_distance for name in known]),
            grid,
            up[:, None],
            pose[:, 2:3],
        )

    @classmethod
    def resting(
        cls, names: Sequence[str], pose: np.ndarray, objects: Mapping[str, ObjectModel]
    ) -> Surroundings:
        """Two planes: the table at measured, noisy rest poses, and where it will be once the objects have
        settled.

        Args: as for ``settled``.
        """
        measured = cls.settled(names, pose, objects)
        up = np.array(
            [settled_up(objects[name], u) for name, u in zip(names, measured.up[:, 0], strict=True)]
        )
        height = -np.array([np.min(objects[name].vertices @ u) for name, u in zip(names, up, strict=True)])
        return replace(
            measured,
            up=np.stack([measured.up[:, 0], up], axis=1),
            height=np.stack([measured.height[:, 0], height], axis=1),
        )

    def rows(self, which: slice | np.ndarray) -> Self:
        """Some of the hands."""
        parts = {f.name: getattr(self, f.name)[which] for f in fields(self) if f.name != "bank"}
        return replace(self, **parts)

    def __len__(self) -> int:
        return len(self.grid)


@dataclass(frozen=True)
class Problem(Surroundings):
    """N human grasps to imitate, object frame."""

    joints: np.ndarray
    """Human joints [m], shape [N, 21, 3]."""
    contacts: np.ndarray
    """Which robot links should touch, palm first, shape [N, L] bool."""
    surface: np.ndarray
    """Surface point nearest to each human joint [m], shape [N, 21, 3]."""
    normals: np.ndarray
    """Outward surface normal there, shape [N, 21, 3]."""
    center: np.ndarray
    """Object's center of mass [m], shape [N, 3]."""
    extent: np.ndarray
    """Half of the object's diagonal [m], shape [N]."""

    @classmethod
    def from_grasps(
        cls, grasps: HumanGraspSet, objects: Mapping[str, ObjectModel], match: Correspondence
    ) -> Problem:
        """Bring grasps into their objects' frames.

        Args:
            grasps: N human grasps.
            objects: by name, each object of the grasps.
            match: which robot link stands for which human one.
        """
        names = grasps.object_name.tolist()
        around = Surroundings.resting(names, grasps.object_rest_pose, objects)
        joints = transform_points(invert(grasps.object_pose), grasps.hand_joints)
        surface, normals = nearest_surface(around.bank, around.grid, joints)
        return cls(
            **{f.name: getattr(around, f.name) for f in fields(around)},
            joints=joints,
            contacts=match.link_contacts(grasps.link_contacts),
            surface=surface,
            normals=normals,
            center=np.array([objects[name].center_of_mass for name in names]),
            extent=np.array([0.5 * np.linalg.norm(objects[name].size) for name in names]),
        )


def nearest_surface(
    bank: SignedDistanceBank, grid: np.ndarray, points: np.ndarray, iterations: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Walk down the distance field to the surface.

    Args:
        points: [m], shape [N, P, 3], object frame.

    Returns:
        surface points [m] and outward unit normals, each shape [N, P, 3].
    """
    for _ in range(iterations):
        distance, gradient = bank.query(grid, points)
        gradient = gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)
        points = points - distance[..., None] * gradient
    _, gradient = bank.query(grid, points)
    return points, gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)


class HandPoints:
    """A robot hand's key points and balls, as the terms need them."""

    def __init__(self, kinematics: HandKinematics, spacing: float = 0.018):
        hand = kinematics.hand
        self.kinematics = kinematics
        self.match = correspond(hand)
        self.keypoints: BodyPoints = kinematics.body_points(hand.keypoint_names)
        self.balls: HandBalls = hand_balls(hand, spacing)
        self.far_radius = self._thickness()
        self.link_members = [np.flatnonzero(self.balls.link == link) for link in range(len(hand.links))]
        self.self_pairs = _self_pairs(hand, self.balls)

    def _thickness(self) -> np.ndarray:
        """Radius of the hand around the far key point of each finger link [m], shape [S]: of its nearest
        ball."""
        radii = []
        for link, (near, far) in enumerate(zip(self.match.near, self.match.far, strict=True), start=1):
            members = np.flatnonzero(self.balls.link == link)
            same = self.keypoints.bodies[far] == self.keypoints.bodies[near]
            if not len(members):
                radii.append(0.0)
            elif same:
                gaps = np.linalg.norm(
                    self.balls.points.offsets[members] - self.keypoints.offsets[far], axis=1
                )
                radii.append(self.balls.radius[members[np.argmin(gaps)]])
            else:
                radii.append(float(np.median(self.balls.radius[members])))
        return np.array(radii)


class SelfPairs(NamedTuple):
    """Which balls of a hand may meet: rounded links of different fingers, each pair once."""

    first: np.ndarray
    """Ball indices, shape [A]."""
    second: np.ndarray
    """Ball indices, shape [B]."""
    apart: np.ndarray
    """Whether a pair counts, shape [A, B]."""


def _self_pairs(hand: Hand, balls: HandBalls) -> SelfPairs:
    finger = np.array([-1, *(i for i, f in enumerate(hand.fingers.values()) for _ in f.links)])
    round_balls = np.flatnonzero((balls.radius > 0) & (finger[balls.link] >= 0))
    owner = finger[balls.link[round_balls]]
    return SelfPairs(round_balls, round_balls, owner[:, None] < owner)


Around = TypeVar("Around", bound=Surroundings)


class State(Generic[Around]):
    """The hands at one iterate: positions, distances, and Jacobians on demand."""

    def __init__(self, points: HandPoints, problem: Around, wrist_pose: np.ndarray, independent: np.ndarray):
        self.points, self.problem = points, problem
        self.wrist_pose, self.independent = wrist_pose, independent
        points.kinematics.update(wrist_pose, independent)
        self.keypoints = points.kinematics.points(points.keypoints)
        self.balls = points.kinematics.points(points.balls.points)
        distance, gradient = problem.bank.query(problem.grid, self.balls)
        self.clearance = distance - points.balls.radius
        """From each ball to the object [m], shape [N, P]; negative where it penetrates."""
        self.normals = gradient
        heights = np.einsum("npi,nti->npt", self.balls, problem.up) + problem.height[:, None]
        self.heights = heights.min(axis=2) - points.balls.radius
        """From each ball to the nearest plane [m], shape [N, P]."""
        self.plane = heights.argmin(axis=2)
        """Which plane that is, shape [N, P]."""

    def keypoint_jacobian(self, which: np.ndarray) -> np.ndarray:
        """Shape [N, len(which), 3, D]."""
        return self.points.kinematics.jacobian(self.points.keypoints.bodies[which], self.keypoints[:, which])

    def ball_jacobian(self, which: np.ndarray) -> np.ndarray:
        """which: ball indices, shape [N, Q]; returns shape [N, Q, 3, D]."""
        positions = np.take_along_axis(self.balls, which[..., None], axis=1)
        return self.points.kinematics.jacobian(self.points.balls.points.bodies[which], positions)
