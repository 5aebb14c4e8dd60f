"""Static quality of retargeted grasps from hand model, mesh and human grasp, without physics
(docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.text_table import table
from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, nearest_on_mesh, project_to_surface
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.grasps.as_shown import ShownContacts, ShownJudge, shown_places
from fungrasp.grasps.grasp_arguments import AnyGrasps, HumanGrasps, Objects, as_human_grasps
from fungrasp.hands import Hand
from fungrasp.hands.collisions import CollisionSpheres, collision_spheres, self_collision_depth
from fungrasp.hands.correspondence import Correspondence, correspond
from fungrasp.hands.kinematics import BodyPoints, HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_surface_points
from fungrasp.optimization.force_closure import closure_epsilon, closure_residual, primitive_wrenches
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.simulation.scene import NOMINAL_FRICTION

UNITS = ("mm", "deg", "rad")
"""Unit suffixes of the names of quality measures."""

PART = 128
"""Grasps that are measured together."""

EXACT_WITHIN = 0.02
"""Distance from the object's surface, outside or inside, within which spheres are measured exactly [m]."""

GRID_ERROR = 0.001
"""Grid distance above which a point is certainly outside the object [m]."""


@dataclass(frozen=True)
class StaticQuality:
    """Quality measures, shape [N] each; NaN for grasps without contacts, or if not measured."""

    held_as_shown: np.ndarray
    """1 if the hand holds the object as the person does (``grasps.as_shown``), else 0."""
    shown_share: np.ndarray
    """Share of the target finger links that touch as shown."""
    place_error_mm: np.ndarray
    """Mean distance of these links' contacts from the person's."""
    other_side: np.ndarray
    """Share of these links that touch another side of the object."""
    strays: np.ndarray
    """Number of links that touch far from every contact of the person."""
    contact_error_mm: np.ndarray
    """Mean over human joints in contact of the distance between the surface points nearest to the joint and
    to the corresponding point of the robot."""
    contact_gap_mm: np.ndarray
    """Mean distance of the target links' collision surfaces from the object."""
    link_direction_error_deg: np.ndarray
    """Mean angle between corresponding finger links."""
    object_penetration_mm: np.ndarray
    """Deepest point of the hand's collision geometry inside the object."""
    table_penetration_mm: np.ndarray
    """Depth of the deepest point below the table, with the object at its rest pose."""
    self_penetration_mm: np.ndarray
    """Deepest overlap of two collision geoms of the hand that may collide."""
    limit_violation_rad: np.ndarray
    """Largest violation of a joint limit."""
    force_closure_residual: np.ndarray
    """Smallest unbalanced part of contact forces that sum to one, at the links within ``CONTACT_DISTANCE`` of
    the object; torques are divided by half the object's largest extent."""
    force_closure_epsilon: np.ndarray
    """Largest wrench that these contacts resist in every direction (Ferrari and Canny's Q1); zero without
    force closure."""

    def table(self) -> str:
        """Return ``summary`` as text."""
        return static_quality_table(self.summary())

    def summary(self) -> dict[str, dict[str, float]]:
        """Return mean, 90th and 95th percentile and maximum of each measure over the grasps."""
        result = {}
        for field in fields(self):
            values = getattr(self, field.name)
            values = values[np.isfinite(values)]
            if len(values):
                result[field.name] = {
                    "mean": float(values.mean()),
                    "p90": float(np.percentile(values, 90)),
                    "p95": float(np.percentile(values, 95)),
                    "max": float(values.max()),
                }
        return result


def static_quality_table(summary: Mapping[str, Mapping[str, float]]) -> str:
    """Return ``StaticQuality.summary`` as text."""
    rows: list[tuple[str, ...]] = [("quality", "mean", "p90", "p95", "max", "unit")]
    for name, numbers in summary.items():
        what, _, unit = name.rpartition("_")
        if unit not in UNITS:
            what, unit = name, ""
        rows.append(
            (what.replace("_", " "), *(f"{numbers[k]:.2f}" for k in ("mean", "p90", "p95", "max")), unit)
        )
    return table(rows)


def with_quality(robot: RobotGraspSet, quality: StaticQuality) -> RobotGraspSet:
    """Add the quality to ``extra`` of the grasps, except measures without any finite value."""
    numbers = {field.name: getattr(quality, field.name) for field in fields(quality)}
    numbers = {name: values for name, values in numbers.items() if np.isfinite(values).any()}
    return replace(robot, extra={**robot.extra, **numbers})


def static_quality(
    robot: AnyGrasps,
    human: HumanGrasps | None = None,
    objects: Objects = None,
    hand: Hand | str | Path | None = None,
    spacing: float = 0.004,
    exact: bool = True,
) -> StaticQuality:
    """Measure the quality of robot grasps relative to their human grasps.

    Args:
        robot: N robot grasps, or human grasps, which are retargeted first.
        human: the human grasps of the robot grasps. None: the human contacts come from the robot grasps, and
            ``link_direction_error_deg`` is NaN.
        objects: objects of the grasps, as for ``retarget``.
        hand: robot hand, its name or file; the hand of the grasps if None.
        spacing: spacing of the points that cover the hand's collision geometry [m].
        exact: use exact mesh distances and compute ``force_closure_epsilon``, which is slow. Otherwise
            distances come from the solver's grid (up to 1 mm off), and ``force_closure_epsilon`` is NaN.

    Raises:
        FungraspError: robot and human grasps do not match, the robot grasps are of another hand, an object is
            missing, or there are neither human grasps nor human contacts.
    """
    robot, known, hand, made_of = as_robot_grasps(robot, objects, hand)
    shown = made_of if human is None else as_human_grasps(human)
    if shown is None and robot.shown_places is None:
        raise FungraspError("the robot grasps have no human contacts: give human=, their human grasps")
    if shown is not None and not np.array_equal(robot.object_name, shown.object_name):
        raise FungraspError(
            "the robot grasps and the human grasps are not of the same objects in the same order"
        )
    match = correspond(hand)
    spheres = collision_spheres(hand, spacing)
    # Process grasps in parts, sorted by object, to limit memory.
    order = np.argsort(robot.object_name, kind="stable")
    parts = [
        _quality(robot.select(rows), shown and shown.select(rows), known, hand, match, spheres, exact)
        for rows in np.split(order, np.arange(PART, len(order), PART))
        if len(rows)
    ]
    back = np.argsort(order)
    names = [field.name for field in fields(StaticQuality)]
    return StaticQuality(
        **{name: np.concatenate([getattr(part, name) for part in parts])[back] for name in names}
    )


def _quality(
    robot: RobotGraspSet,
    human: HumanGraspSet | None,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    match: Correspondence,
    spheres: CollisionSpheres,
    exact: bool,
) -> StaticQuality:
    kinematics = HandKinematics(hand, len(robot))
    wrist = robot.wrist_pose_object
    kinematics.update(wrist, hand.independent(robot.joint_positions))
    keypoints = kinematics.points(kinematics.body_points(hand.keypoint_names))
    names = sorted(set(robot.object_name.tolist()))
    bank = SignedDistanceBank([objects[name].signed_distance for name in names])
    grid = np.array([names.index(name) for name in robot.object_name.tolist()])
    models = [objects[name] for name in names]
    wanted, places, normals = robot.link_contacts[:, 1:], robot.shown_places, robot.shown_normals
    direction_error = np.full(len(robot), np.nan)
    if human is not None:
        wanted = match.link_contacts(human.link_contacts)[:, 1:]
        joints = inverse_transform_points(human.object_pose, human.hand_joints)
        direction_error = np.rad2deg(_direction_error(keypoints, joints, match).mean(axis=1))
        if exact or places is None:
            places, normals = shown_places(human, objects, match)
    assert places is not None and normals is not None
    ours = nearest_surface_points(models, grid, keypoints[:, match.far], wanted)
    contact_error = _mean_where(np.linalg.norm(places - ours, axis=-1), wanted)

    centers, clearance, heights = _clearances(kinematics, spheres, bank, grid, robot)
    if exact:
        clearance = exact_clearance(models, grid, centers, clearance, spheres.radius)
    nearest, by_link = spheres.nearest(clearance, len(hand.links))
    contacts = np.take_along_axis(centers, nearest[..., None], axis=1)
    theirs = ShownContacts(robot.object_name, wanted, places, normals)
    shown = ShownJudge(hand, objects)(wrist, robot.joint_positions, theirs)
    residual, epsilon = _force_closure(contacts, by_link, bank, grid, models, exact)
    return StaticQuality(
        held_as_shown=np.where(wanted.any(axis=1), shown.holds.astype(float), np.nan),
        shown_share=shown.share,
        place_error_mm=1e3 * shown.place_error,
        other_side=shown.other_side,
        strays=shown.strays.astype(float),
        contact_error_mm=1e3 * contact_error,
        contact_gap_mm=1e3 * _mean_where(np.maximum(by_link[:, 1:], 0.0), wanted),
        link_direction_error_deg=direction_error,
        object_penetration_mm=1e3
        * penetration_depth(models, bank, grid, centers, clearance, spheres.radius, spheres.link, exact),
        table_penetration_mm=1e3 * np.maximum(-heights.min(axis=1), 0.0),
        self_penetration_mm=1e3 * self_collision_depth(hand.model, robot.joint_positions),
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


def _clearances(
    kinematics: HandKinematics,
    spheres: CollisionSpheres,
    bank: SignedDistanceBank,
    grid: np.ndarray,
    robot: RobotGraspSet,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sphere centers, object frame [m], shape [N, P, 3], and distances of the spheres' surfaces from
    object and table [m], shape [N, P] each."""
    # In parts of 256 spheres, whose arrays fit in the processor's cache.
    centers, clearance, heights = [], [], []
    for start in range(0, len(spheres.radius), 256):
        part = slice(start, start + 256)
        centers.append(
            kinematics.points(BodyPoints(spheres.points.bodies[part], spheres.points.offsets[part]))
        )
        clearance.append(bank.query(grid, centers[-1])[0] - spheres.radius[part])
        heights.append(transform_points(robot.object_rest_pose, centers[-1])[..., 2] - spheres.radius[part])
    return np.concatenate(centers, axis=1), np.concatenate(clearance, axis=1), np.concatenate(heights, axis=1)


def _force_closure(
    centers: np.ndarray,
    clearance: np.ndarray,
    bank: SignedDistanceBank,
    grid: np.ndarray,
    objects: list[ObjectModel],
    exact: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Return residual and epsilon of the links in contact, shape [N] each; epsilon is NaN unless ``exact``.

    Args:
        centers: center of each link's sphere nearest to the object, object frame [m], shape [N, L, 3].
        clearance: [m], shape [N, L].
        grid: index of each grasp's object, shape [N].
        objects: object models in the order of the bank.
    """
    surface, outward = project_to_surface(bank, grid, centers)
    values = np.zeros((2, len(grid)))
    for row, number in enumerate(grid):
        touching = clearance[row] < CONTACT_DISTANCE
        levers = surface[row, touching] - objects[number].center_of_mass
        length = 0.5 * float(objects[number].size.max())
        wrenches = primitive_wrenches(levers, -outward[row, touching], length, NOMINAL_FRICTION)
        values[:, row] = closure_residual(wrenches), closure_epsilon(wrenches) if exact else np.nan
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


def exact_clearance(
    objects: list[ObjectModel],
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
) -> np.ndarray:
    """Return the clearance of the spheres, shape [N, P]: exact (by triangles) near the object, elsewhere from
    the grid, which is up to 1 mm off.

    Args:
        objects: O object models.
        grid: index of each grasp's object, shape [N].
        centers: sphere centers, object frame [m], shape [N, P, 3].
        clearance: from the grid [m], shape [N, P].
        radius: sphere radii [m], shape [P].
    """
    near = np.abs(clearance) < EXACT_WITHIN
    nearest = nearest_surface_points(objects, grid, centers, near)
    inside = clearance + radius < 0
    distance = np.where(inside, -1.0, 1.0) * np.linalg.norm(centers - nearest, axis=-1)
    return np.where(near, distance - radius, clearance)


def penetration_depth(
    objects: list[ObjectModel],
    bank: SignedDistanceBank,
    grid: np.ndarray,
    centers: np.ndarray,
    clearance: np.ndarray,
    radius: np.ndarray,
    link: np.ndarray,
    exact: bool = True,
) -> np.ndarray:
    """Return the depth of the hand's deepest point in the object [m], shape [N]. In a thin wall or at an
    edge, it is less than the depth of a sphere below the surface.

    The two deepest spheres of each link are sampled in three rounds around the deepest sample so far.

    Args:
        link: link of each sphere, shape [P].
        others: see ``exact_clearance``.
    """
    rows, spheres = _deepest_spheres(clearance, link)
    best = np.zeros((len(rows), 1, 3))
    distance = np.zeros((len(rows), 1))
    pick = np.arange(len(rows))
    for around in (_BALL, 0.25 * _BALL, 0.06 * _BALL):
        samples = best + around
        samples /= np.maximum(1.0, np.linalg.norm(samples, axis=-1, keepdims=True))
        places = centers[rows, spheres][:, None] + radius[spheres][:, None, None] * samples
        distance = bank.query(grid[rows], places)[0]
        if exact:
            distance = _signed_distance(objects, distance, grid[rows], places)
        best = samples[pick, distance.argmin(axis=1)][:, None]
    depth = np.zeros(len(grid))
    np.maximum.at(depth, rows, -distance.min(axis=1, initial=0.0))
    return depth


def _deepest_spheres(clearance: np.ndarray, link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and indices of penetrating spheres, at most the two deepest of each link."""
    rows, spheres = [], []
    for number in np.unique(link):
        members = np.flatnonzero(link == number)
        order = members[np.argsort(clearance[:, members], axis=1)[:, :2]]
        row, place = np.nonzero(np.take_along_axis(clearance, order, axis=1) < 0)
        rows.append(row)
        spheres.append(order[row, place])
    return np.concatenate(rows), np.concatenate(spheres)


def _signed_distance(
    objects: list[ObjectModel], rough: np.ndarray, grid: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Return exact signed distances of points that may be inside, with the sign from the nearest triangle's
    normal; grid distances (``rough``, shape [M, S]) for the others. points: shape [M, S, 3]."""
    near = rough < GRID_ERROR
    result = rough.copy()
    for number, model in enumerate(objects):
        chosen = near & (grid == number)[:, None]
        if chosen.any():
            nearest, face = nearest_on_mesh(model.mesh, points[chosen])
            away = points[chosen] - nearest
            outside = np.sum(away * model.mesh.face_normals[face], axis=1) > 0
            result[chosen] = np.where(outside, 1.0, -1.0) * np.linalg.norm(away, axis=1)
    return result


def _unit_ball() -> np.ndarray:
    """Return points spread evenly on the unit sphere (Fibonacci spiral) and on one of half the size, and the
    center, shape [P, 3]."""
    shells = [np.zeros((1, 3))]
    for count, size in ((20, 0.5), (100, 1.0)):
        height = 1 - (2 * np.arange(count) + 1) / count
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        shells.append(size * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1))
    return np.concatenate(shells)


_BALL = _unit_ball()
