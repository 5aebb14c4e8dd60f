"""Human grasps as targets of the optimization, in the object's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from fungrasp.geometry.poses import invert, transform_points
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands.correspondence import Correspondence
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene, project_to_surface

GRAVITY = 9.81
"""[m/s^2]."""


@dataclass(frozen=True)
class RetargetingProblem(CollisionScene):
    """N human grasps to imitate, in their objects' frames, and what the hands may collide with."""

    joints: np.ndarray
    """Human joints [m], shape [N, 21, 3]."""
    contacts: np.ndarray
    """Which robot links should touch, palm first, shape [N, L] bool."""
    surface: np.ndarray
    """Surface point nearest to each human joint [m], shape [N, 21, 3]."""
    normals: np.ndarray
    """Outward surface normal there, shape [N, 21, 3]."""
    center: np.ndarray
    """Center of mass of each object [m], shape [N, 3]."""
    extent: np.ndarray
    """Half of each object's diagonal [m], shape [N]: the unit of lever arms in force closure."""
    weight: np.ndarray
    """Weight of each object [N], shape [N]."""

    @classmethod
    def from_grasps(
        cls, grasps: HumanGraspSet, objects: Mapping[str, ObjectModel], match: Correspondence
    ) -> RetargetingProblem:
        """Bring grasps into their objects' frames.

        Args:
            grasps: N human grasps.
            objects: by name, each object of the grasps.
            match: which robot link stands for which human one.
        """
        names = grasps.object_name.tolist()
        scene = CollisionScene.measured_and_settled(names, grasps.object_rest_pose, objects)
        joints = transform_points(invert(grasps.object_pose), grasps.hand_joints)
        surface, normals = project_to_surface(scene.bank, scene.grid, joints)
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
