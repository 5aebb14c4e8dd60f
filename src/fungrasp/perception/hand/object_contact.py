"""What a known object and table say about the hand: fingers near a surface touch it, flesh is not inside."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points, rotate
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.perception.hand.evidence import Evidence
from fungrasp.perception.hand.skeleton import Skeleton
from fungrasp.perception.hand.surface_samples import FINGERTIP_PROBES, PROBES


@dataclass(frozen=True)
class ContactSettings:
    """What contact is worth against the image."""

    spread: float = 0.004
    """Standard deviation of the gap between a touching finger's skin and the surface [m]."""
    reach: float = 0.008
    """A gap beyond this [m] is likelier no contact."""
    pad: float = 0.6
    """Part of the flesh's thickness that is between bone and surface when a finger presses."""
    bone: float = 0.4
    """Part of the flesh's thickness that nothing goes into."""
    penetration_spread: float = 0.003
    """Standard deviation of how deep that part is in the object or the table [m]."""


class Surroundings:
    """Distances to a known object and the table, of points in the camera frame or its mirror image."""

    def __init__(
        self, surface: SignedDistanceGrid, pose_camera_object: np.ndarray, table: np.ndarray | None = None
    ):
        """
        Args:
            surface: of the object, object's frame.
            pose_camera_object: shape [7].
            table: plane ``n x + d = 0`` of the table top, camera frame, shape [4]: unit normal away from the
                table, offset [m].
        """
        self._bank = SignedDistanceBank([surface])
        self._pose, self._table = np.asarray(pose_camera_object, dtype=float), table
        self._flip = np.ones(3)

    def mirrored(self) -> Surroundings:
        """The same for points whose x is reversed."""
        other = copy.copy(self)
        other._flip = self._flip * np.array([-1.0, 1.0, 1.0])
        return other

    def object_distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance [m], shape [P], and its gradient, [P, 3]. points: [m], shape [P, 3]."""
        local = inverse_transform_points(self._pose, points * self._flip)
        distance, gradient = self._bank.query(np.zeros(1, dtype=int), local[None])
        return distance[0], rotate(self._pose[None, 3:], gradient[0]) * self._flip

    def table_distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Height above the table [m], shape [P], and its gradient, [P, 3]; None without a table."""
        if self._table is None:
            return None
        normal = self._table[:3] * self._flip
        return points @ normal + self._table[3], np.broadcast_to(normal, points.shape)


def contact_evidence(
    hand: Skeleton,
    joints: np.ndarray,
    jacobian: np.ndarray,
    around: Surroundings,
    settings: ContactSettings,
) -> list[Evidence]:
    """Each finger's last link touches the object where it is nearest, if it is near; no part is inside.

    Args:
        hand, joints, jacobian: the skeleton, its joints and their derivatives.
        around: object and table.
        settings: what that is worth.
    """
    points, slopes = PROBES.place(joints, jacobian)
    radius = PROBES.radius * np.exp(hand.size)
    distance, gradient = around.object_distance(points)
    by_step = np.einsum("pi,pin->pn", gradient, slopes)
    gap = distance - settings.pad * radius
    touching = np.array([probes[gap[probes].argmin()] for probes in FINGERTIP_PROBES])
    touching = touching[gap[touching] > 0]
    found = [
        Evidence(
            gap[touching] / settings.spread,
            by_step[touching] / settings.spread,
            settings.reach / settings.spread,
        ),
        _not_inside(distance - settings.bone * radius, by_step, settings.penetration_spread),
    ]
    table = around.table_distance(points)
    if table is not None:
        height, normal = table
        by_step = np.einsum("pi,pin->pn", normal, slopes)
        found.append(_not_inside(height - settings.bone * radius, by_step, settings.penetration_spread))
    return found


def _not_inside(gap: np.ndarray, by_step: np.ndarray, spread: float) -> Evidence:
    inside = gap < 0
    return Evidence(gap[inside] / spread, by_step[inside] / spread)
