"""The reference controller: opens, approaches, closes, squeezes, lifts; it does not look at the object again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import compose, invert
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.retarget.correspondence import correspond
from fungrasp.retarget.problem import nearest_surface
from fungrasp.task import Action, LiftTask


@dataclass(frozen=True)
class ReferenceSettings:
    squeeze_force: float = 4.0
    squeeze_limit: float = 0.4
    opening: float = 0.5
    pre_distance: float = 0.05
    close_time: float = 0.6
    squeeze_time: float = 0.5


class ReferenceController:
    def __init__(self, task: LiftTask, objects: dict[str, ObjectModel], settings: ReferenceSettings | None = None):
        self.task, self.settings = task, settings or ReferenceSettings()
        self.grasp = task.independent(task.grasps.joint_positions)
        self.squeeze = squeeze_direction(task, objects, self.grasp, self.settings)
        self.open = self.settings.opening * self.grasp
        self.arrived = np.full(len(self.grasp), np.inf)

    def act(self) -> Action:
        task, s = self.task, self.settings
        now = task.time
        near = np.linalg.norm(task.set_point.pose[:, :3] - task.target_pose[:, :3], axis=1) < 2e-3
        self.arrived = np.where(near & ~np.isfinite(self.arrived), now, self.arrived)
        since = np.where(np.isfinite(self.arrived), now - self.arrived, -1.0)[:, None]
        closing = np.clip((since + 0.1) / s.close_time, 0, 1)
        squeezing = np.clip((since + 0.1 - s.close_time) / s.squeeze_time, 0, 1)
        fingers = self.open + closing * (self.grasp - self.open) + squeezing * self.squeeze
        lift = since[:, 0] >= s.close_time + s.squeeze_time + 0.2
        return Action(task.target_pose, fingers, lift)


def squeeze_direction(task: LiftTask, objects, grasp: np.ndarray, settings: ReferenceSettings) -> np.ndarray:
    hand = task.scene.hand
    kinematics = HandKinematics(hand, len(grasp))
    match = correspond(hand)
    kinematics.update(task.wrist_in_object, grasp)
    which = kinematics.body_points(hand.keypoint_names)
    points = kinematics.points(which)[:, match.far]
    names = sorted(objects)
    bank = SignedDistanceBank([objects[n].signed_distance for n in names])
    grid = np.array([names.index(n) for n in task.grasps.object_name.tolist()])
    _, normals = nearest_surface(bank, grid, points)
    bodies = which.bodies[match.near]
    jacobian = kinematics.jacobian(bodies, points)[..., 6:]
    wanted = task.grasps.link_contacts[:, 1:]
    torque = -settings.squeeze_force * np.einsum("ns,nsi,nsiu->nu", wanted, normals, jacobian)
    kp = np.array([a.kp for a in hand.actuators.values()])
    return np.clip(torque / kp, -settings.squeeze_limit, settings.squeeze_limit)
