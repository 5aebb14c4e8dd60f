"""Static quality of retargeted grasps (docs/evaluation.md): no physics; from the hand's model, the mesh and
the human grasp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.evaluation.closure import closure_epsilon, closure_residual, primitive_wrenches
from fungrasp.evaluation.depth import deepest, exact_clearance, nearest_points
from fungrasp.geometry import SignedDistanceBank
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, transform_points
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.hands.shape import HandBalls, hand_balls
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_problem import nearest_surface

TOUCHING = 0.003
"""A link nearer to the object than this counts as a contact of the force closure [m]."""


@dataclass(frozen=True)
class StaticQuality:
    """One number per grasp, shape [N] each; NaN where a grasp asks for no contact."""

    contact_error_mm: np.ndarray
    """Mean over human joints in contact of the distance between the surface point nearest to the joint and
    the one nearest to the robot's corresponding point."""
    contact_gap_mm: np.ndarray
    """Mean over robot links that should touch of the distance of their collision surface from the object."""
    link_direction_error_deg: np.ndarray
    """Mean angle between corresponding finger links."""
    object_penetration_mm: np.ndarray
    """Deepest point of the hand's collision geometry inside the object."""
    table_penetration_mm: np.ndarray
    """Deepest point below the table, object at its rest pose."""
    self_penetration_mm: np.ndarray
    """Deepest overlap of two of the hand's collision geoms that may collide."""
    limit_violation_rad: np.ndarray
    """Largest excess of a joint over its limits."""
    force_closure_residual: np.ndarray
    """Unbalanced part of the best contact forces that sum to one, at the links within ``TOUCHING`` of the
    object; torques over half the object's largest extent."""
    force_closure_epsilon: np.ndarray
    """Weakest wrench that those contacts resist (Ferrari and Canny's Q1); zero if they don't resist all."""

    def summary(self) -> dict[str, dict[str, float]]:
        """Mean, 95th percentile and maximum of each number over the grasps."""
        result = {}
        for field in fields(self):
            values = getattr(self, field.name)
            values = values[np.isfinite(values)]
            if len(values):
                result[field.name] = {
                    "mean": float(values.mean()),
                    "p95": float(np.percentile(values, 95)),
                    "max": float(values.max()),
                }
        return result


def static_quality(
    robot: RobotGraspSet,
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    spacing: float = 0.004,
) -> StaticQuality:
    """Judge robot grasps against the human ones they imitate.

    Args:
        robot: N grasps of ``hand``.
        human: the same N grasps, as the human did them.
        objects: by name.
        spacing: of the points that cover the hand's collision geometry [m].

    Raises:
        FungraspError: the sets don't belong together.
    """
    if len(robot) != len(human) or np.any(robot.object_name != human.object_name):
        raise FungraspError(
            "the robot grasps and the human grasps are not of the same objects in the same order"
        )
    if tuple(robot.joint_names) != hand.joint_names:
        raise FungraspError(f"the robot grasps have other joints than hand '{hand.name}'")
    match = correspond(hand)
    kinematics = HandKinematics(hand, len(robot))
    wrist = compose(invert(robot.object_pose), robot.wrist_pose)
    independent = (robot.joint_positions - kinematics.offset) @ np.linalg.pinv(kinematics.matrix).T
    kinematics.update(wrist, independent)
    keypoints = kinematics.points(kinematics.body_points(hand.keypoint_names))
    joints = inverse_transform_points(human.object_pose, human.hand_joints)

    names = sorted(set(robot.object_name.tolist()))
    bank = SignedDistanceBank([objects[name].signed_distance for name in names])
    grid = np.array([names.index(name) for name in robot.object_name.tolist()])
    things = [objects[name] for name in names]
    wanted = match.link_contacts(human.link_contacts)[:, 1:]
    theirs = nearest_points(things, grid, joints[:, match.human_far], wanted)
    ours = nearest_points(things, grid, keypoints[:, match.far], wanted)
    contact_error = _mean_where(np.linalg.norm(theirs - ours, axis=-1), wanted)

    balls = hand_balls(hand, spacing)
    centers, clearance, heights = _clearances(kinematics, balls, bank, grid, robot)
    clearance = exact_clearance(things, grid, centers, clearance, balls.radius)
    nearest = [_nearest(clearance, balls.link == link) for link in range(len(hand.links))]
    by_link = np.stack([distance for _, distance in nearest], axis=1)
    contacts = np.stack([centers[np.arange(len(robot)), ball] for ball, _ in nearest], axis=1)
    residual, epsilon = _force_closure(contacts, by_link, bank, grid, things)
    return StaticQuality(
        contact_error_mm=1e3 * contact_error,
        contact_gap_mm=1e3 * _mean_where(np.maximum(by_link[:, 1:], 0.0), wanted),
        link_direction_error_deg=np.rad2deg(_direction_error(keypoints, joints, match).mean(axis=1)),
        object_penetration_mm=1e3 * deepest(things, bank, grid, centers, clearance, balls.radius, balls.link),
        table_penetration_mm=1e3 * np.maximum(-heights.min(axis=1), 0.0),
        self_penetration_mm=1e3 * self_penetration(hand, robot.joint_positions),
        limit_violation_rad=np.maximum(
            np.maximum(
                hand.joint_limits[:, 0] - robot.joint_positions,
                robot.joint_positions - hand.joint_limits[:, 1],
            ),
            0.0,
        ).max(axis=1),
        force_closure_residual=residual,
        force_closure_epsilon=epsilon,
    )


def self_penetration(hand: Hand, joint_positions: np.ndarray) -> np.ndarray:
    """Deepest contact of the hand with itself, by MuJoCo's own collision detection.

    Args:
        joint_positions: [rad], shape [N, M].

    Returns:
        [m], shape [N].
    """
    import mujoco

    model = hand.model
    data = mujoco.MjData(model)
    depths = np.zeros(len(joint_positions))
    for row, qpos in enumerate(joint_positions):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        depths[row] = max(0.0, *(-contact.dist for contact in data.contact), 0.0)
    return depths


def _clearances(
    kinematics: HandKinematics,
    balls: HandBalls,
    bank: SignedDistanceBank,
    grid: np.ndarray,
    robot: RobotGraspSet,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of each ball, object frame [m], shape [N, P, 3]; its distance from the object and from the table
    [m], shape [N, P] each."""
    centers, clearance, heights = [], [], []
    for start in range(0, len(balls.radius), 256):
        part = slice(start, start + 256)
        centers.append(kinematics.points(BodyPoints(balls.points.bodies[part], balls.points.offsets[part])))
        clearance.append(bank.query(grid, centers[-1])[0] - balls.radius[part])
        heights.append(transform_points(robot.object_rest_pose, centers[-1])[..., 2] - balls.radius[part])
    return np.concatenate(centers, axis=1), np.concatenate(clearance, axis=1), np.concatenate(heights, axis=1)


def _nearest(clearance: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index and clearance of the nearest of some balls, shape [N] each; infinite where there are none."""
    masked = np.where(which, clearance, np.inf)
    ball = masked.argmin(axis=1)
    return ball, masked[np.arange(len(ball)), ball]


def _force_closure(
    centers: np.ndarray,
    clearance: np.ndarray,
    bank: SignedDistanceBank,
    grid: np.ndarray,
    objects: list[ObjectModel],
) -> tuple[np.ndarray, np.ndarray]:
    """Residual and epsilon, shape [N] each.

    Args:
        centers: of the ball of each link that is nearest to the object, object frame [m], shape [N, L, 3].
        clearance: of those balls [m], shape [N, L].
        bank: of the objects.
        grid: which object each grasp is of, shape [N].
        objects: in the order of the bank.
    """
    surface, outward = nearest_surface(bank, grid, centers)
    values = np.zeros((2, len(grid)))
    for row, number in enumerate(grid):
        touching = clearance[row] < TOUCHING
        levers = surface[row, touching] - objects[number].center_of_mass
        wrenches = primitive_wrenches(
            levers, -outward[row, touching], 0.5 * float(objects[number].size.max())
        )
        values[:, row] = closure_residual(wrenches), closure_epsilon(wrenches)
    return values[0], values[1]


def _direction_error(keypoints: np.ndarray, joints: np.ndarray, match) -> np.ndarray:
    robot = keypoints[:, match.far] - keypoints[:, match.near]
    human = joints[:, match.human_far] - joints[:, match.human_near]
    cosine = np.sum(robot * human, axis=-1) / (
        np.linalg.norm(robot, axis=-1) * np.linalg.norm(human, axis=-1)
    )
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _mean_where(values: np.ndarray, which: np.ndarray) -> np.ndarray:
    count = which.sum(axis=1)
    return np.where(count > 0, np.sum(values * which, axis=1) / np.maximum(count, 1), np.nan)
