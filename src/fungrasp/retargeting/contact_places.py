"""Other places for fingertips than the person's, where those cannot hold: a robot's fingertip may be too thick
to reach below an edge, or lie on top of what a person takes by its sides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fungrasp.optimization.firmness import DISTURBANCE, unresisted_wrenches
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import LinkContacts, contacts_of_links
from fungrasp.optimization.pose_terms import contact_targets
from fungrasp.optimization.retargeting_problem import RetargetingProblem

PLACES = 24
"""Places of each fingertip that are compared, the person's among them."""
SPREAD = 0.03
"""Standard deviation of where they are drawn around the person's, along each axis [m]."""
PROJECTIONS = 4
"""Newton steps that bring them to the surface."""
TOUCHING = 0.0015
"""A fingertip that cannot come nearer to the object, because of the table, does not touch [m]."""
ABOVE_TABLE = 0.0005
"""Distance from the table [m]."""
OVERLAP_UNIT = 0.01
"""Overlap of two fingertips that counts like a whole unresisted weight [m]."""
SWEEPS = 2
"""How often each fingertip's place is chosen anew, the others where they are."""
LOAD_ITERATIONS = 30
"""Of the descent to contact forces: places are told apart by less than what solutions are judged by."""
LEAST_RADIUS = 0.004
"""Of a fingertip whose shape has no radius there [m]."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Candidates for F fingertips of N grasps, object frame."""

    center: np.ndarray
    """Of the fingertips [m], shape [N, F, M, 3]."""
    normal: np.ndarray
    """Outward unit normals of the object there, shape [N, F, M, 3]."""
    apart: np.ndarray
    """Distance from the person's [m], shape [N, F, M]."""
    touches: np.ndarray
    """Whether the fingertip touches the object there, shape [N, F, M] bool."""


def with_firm_places(
    points: HandPoints,
    problem: RetargetingProblem,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    unit: float,
) -> RetargetingProblem:
    """The grasps with targets on the object for the fingertips that should touch, from which these could hold
    it best: the share of one and a half times the weight that they cannot take within friction and torque
    limits, and how far the places are from the person's, are smallest together, found by choosing one fingertip's
    place after the other.

    Args:
        points: kinematics made for N hands; they are moved.
        problem: N grasps.
        wrist_pose, independent: about where the hands will be, for their torques, shape [N, 7] and [N, U].
        unit: mean distance from the person's places that counts like a whole unresisted weight [m].
    """
    match = points.match
    tips = np.flatnonzero(match.is_last)
    wanted = problem.contacts[:, 1:][:, tips]
    radius = np.maximum(points.far_radius[tips], LEAST_RADIUS)
    places = _candidates(problem, contact_targets(points, problem)[:, tips], radius)
    jacobian = contacts_of_links(points, problem, wrist_pose, independent).jacobian[:, 1 + tips]
    limits = np.array([servo.force_limit for servo in points.kinematics.hand.actuators.values()])
    load = np.zeros((len(problem), 1, 6))
    load[:, 0, :3] = -(1 + DISTURBANCE) * problem.weight[:, None] * problem.up[:, -1]
    between = radius[:, None] + radius

    def costs(rows: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Of places, by their numbers: shape [R, F] for grasps ``rows`` [R]."""
        which = rows[:, None], np.arange(len(tips)), chosen
        center, normal, touch = places.center[which], places.normal[which], wanted[rows]
        contacts = LinkContacts(
            center - radius[:, None] * normal, -normal, np.zeros(touch.shape), jacobian[rows]
        )
        left = unresisted_wrenches(
            contacts,
            touch & places.touches[which],
            problem.center[rows],
            problem.extent[rows],
            load[rows],
            problem.weight[rows],
            limits,
            iterations=LOAD_ITERATIONS,
        )
        overlap = between - np.linalg.norm(center[:, :, None] - center[:, None], axis=-1)
        both = np.triu(touch[:, :, None] & touch[:, None], 1)
        return (
            np.linalg.norm(left[:, 0], axis=1) / problem.weight[rows]
            + (touch * places.apart[which]).sum(axis=1) / np.maximum(touch.sum(axis=1), 1) / unit
            + np.where(both, np.maximum(overlap, 0.0), 0.0).sum(axis=(1, 2)) / OVERLAP_UNIT
        )

    chosen = np.zeros(wanted.shape, dtype=int)
    least = costs(np.arange(len(problem)), chosen)
    for tip in [*range(len(tips))] * SWEEPS:
        some = np.flatnonzero(wanted[:, tip])
        rows = np.repeat(some, PLACES)
        tried = chosen[rows]
        tried[:, tip] = np.tile(np.arange(PLACES), len(some))
        cost = costs(rows, tried).reshape(len(some), PLACES)
        cost[~places.touches[some, tip]] = np.inf
        best = cost.argmin(axis=1)
        better = cost[np.arange(len(some)), best] < least[some]
        chosen[some[better], tip] = best[better]
        least[some[better]] = cost[better, best[better]]
    which = np.arange(len(problem))[:, None], np.arange(len(tips)), chosen
    human = match.human_far[tips]
    surface, normals = problem.surface.copy(), problem.normals.copy()
    # Their targets are a radius off the surface, as ``contact_targets`` has it.
    on_surface = places.center[which] - points.far_radius[tips][:, None] * places.normal[which]
    surface[:, human] = np.where(wanted[..., None], on_surface, surface[:, human])
    normals[:, human] = np.where(wanted[..., None], places.normal[which], normals[:, human])
    return replace(problem, surface=surface, normals=normals)


def _candidates(problem: RetargetingProblem, target: np.ndarray, radius: np.ndarray) -> _Places:
    """Places around targets, the first at them.

    Args:
        problem: N grasps.
        target: centers of fingertips that touch where the person's did [m], shape [N, F, 3].
        radius: of the fingertips [m], shape [F].
    """
    count, tips, _ = target.shape
    # The same offsets for all grasps, so that what is found of one does not depend on the others.
    offsets = np.random.default_rng(0).normal(scale=SPREAD, size=(tips, PLACES, 3))
    offsets[:, 0] = 0.0
    center = target[:, :, None] + offsets
    away = np.broadcast_to(radius[:, None], (count, tips, PLACES))

    def distance() -> tuple[np.ndarray, np.ndarray]:
        found, gradient = problem.bank.query(problem.grid, center.reshape(count, -1, 3))
        gradient = gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)
        return found.reshape(away.shape), gradient.reshape(center.shape)

    for _ in range(PROJECTIONS):
        found, normal = distance()
        center = center + (away - found)[..., None] * normal
        for plane in range(problem.up.shape[1]):
            up = problem.up[:, plane, None, None]
            height = (center * up).sum(axis=-1) + problem.height[:, plane, None, None]
            center = center + np.maximum(away + ABOVE_TABLE - height, 0.0)[..., None] * up
    found, normal = distance()
    apart = np.linalg.norm(center - target[:, :, None], axis=-1)
    return _Places(center, normal, apart, np.abs(found - away) < TOUCHING)
