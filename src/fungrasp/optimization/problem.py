"""Retargeting problems in the object's frame: collision geometry and human grasps to imitate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from fungrasp.geometry.compiling import plain
from fungrasp.geometry.distance_queries import gradient_derivatives
from fungrasp.geometry.poses import invert, rotate, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.grasps import HumanGraspSet
from fungrasp.grasps.as_shown import shown_places
from fungrasp.hands.correspondence import Correspondence
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import GRAVITY, settled_up


@dataclass(frozen=True)
class CollisionScene:
    """Collision geometry of N hands: one object each and the table, in the object's frame."""

    bank: SignedDistanceBank
    """Signed-distance grids of the objects."""
    grid: np.ndarray
    """Index of each hand's object in the bank, shape [N]."""
    up: np.ndarray
    """Normals of the table planes, shape [N, T, 3]."""
    height: np.ndarray
    """Height of the object's origin above each plane [m], shape [N, T]; a point p is at up . p + height."""

    @classmethod
    def settled(
        cls, names: Sequence[str], pose: np.ndarray, objects: Mapping[str, ObjectModel]
    ) -> CollisionScene:
        """Return a scene with one plane per hand: the table under a settled object.

        Args:
            names: name of each hand's object, length N.
            pose: object poses, world frame, shape [N, 7].
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
    def measured_and_settled(
        cls, names: Sequence[str], pose: np.ndarray, objects: Mapping[str, ObjectModel]
    ) -> CollisionScene:
        """Return a scene with two planes per hand: the table at the object's measured, noisy rest pose and at
        the pose in which the object settles.

        Args: as for ``settled``.
        """
        measured = cls.settled(names, pose, objects)
        up, height = np.empty((len(measured), 3)), np.empty(len(measured))
        for number, name in enumerate(sorted(set(names))):
            rows = measured.grid == number
            up[rows] = settled_up(objects[name], measured.up[rows, 0])
            height[rows] = -np.min(up[rows] @ objects[name].vertices.T, axis=1)
        return replace(
            measured,
            up=np.stack([measured.up[:, 0], up], axis=1),
            height=np.stack([measured.height[:, 0], height], axis=1),
        )

    def rows(self, which: slice | np.ndarray) -> Self:
        """Return the scene of the hands selected by a slice or indices."""
        parts = {f.name: getattr(self, f.name)[which] for f in fields(self) if f.name != "bank"}
        return replace(self, **parts)

    def __len__(self) -> int:
        return len(self.grid)


@dataclass(frozen=True)
class RetargetingProblem(CollisionScene):
    """N human grasps to imitate and their collision geometry, in the objects' frames."""

    joints: np.ndarray
    """Human joints [m], shape [N, 21, 3]."""
    contacts: np.ndarray
    """Robot links that should touch, palm first, shape [N, L] bool."""
    surface: np.ndarray
    """Surface point nearest to the human joint that corresponds to each finger link's far end [m], shape
    [N, S, 3]."""
    normals: np.ndarray
    """Outward surface normals at these points, shape [N, S, 3]."""
    center: np.ndarray
    """Center of mass of each object [m], shape [N, 3]."""
    extent: np.ndarray
    """Half the diagonal of each object [m], shape [N]: the unit of lever arms in force closure."""
    weight: np.ndarray
    """Weight of each object [N], shape [N]."""

    @classmethod
    def from_grasps(
        cls, grasps: HumanGraspSet, objects: Mapping[str, ObjectModel], match: Correspondence
    ) -> RetargetingProblem:
        """Transform grasps to their objects' frames.

        Args:
            grasps: N human grasps.
            objects: the grasps' objects by name.
            match: correspondence of robot links and human links.
        """
        names = grasps.object_name.tolist()
        scene = CollisionScene.measured_and_settled(names, grasps.object_rest_pose, objects)
        joints = transform_points(invert(grasps.object_pose), grasps.hand_joints)
        surface, normals = shown_places(grasps, objects, match)
        return cls(
            **{f.name: getattr(scene, f.name) for f in fields(scene)},
            joints=joints,
            contacts=match.link_contacts(grasps.link_contacts),
            surface=surface,
            normals=normals,
            center=np.array([objects[name].center_of_mass for name in names]),
            extent=np.array([0.5 * np.linalg.norm(objects[name].size) for name in names]),
            weight=GRAVITY * grasps.object_mass,
        )


def gradient_derivative(
    bank: SignedDistanceBank, grid: np.ndarray, points: np.ndarray, reach: float
) -> np.ndarray:
    """Return the derivative of the signed distance gradient by central differences, which also smooth edges.

    Args:
        bank, grid: as for ``project_to_surface``.
        points: [m], shape [N, P, 3], object frame.
        reach: half width of the differences [m].

    Returns:
        [1/m], shape [N, P, 3, 3]; the last axis is the coordinate of the point.
    """
    derivative = np.empty((*points.shape, 3))
    gradient_derivatives(bank.arrays, plain(grid, np.int64), plain(points), reach, derivative)
    return derivative
