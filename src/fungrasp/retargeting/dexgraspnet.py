"""Baseline "dexgraspnet": the grasp energy of DexGraspNet, initialized from the human contacts.

Wang et al., "DexGraspNet: a large-scale robotic dexterous grasp dataset for general objects based on
simulation", 2023, with their weights:

    E = E_fc + w_dis E_dis + w_pen E_pen + w_spen E_spen + w_joints E_joints

It ignores the table and the human posture. Differences from the original:

- Contacts are on the robot links whose human counterparts touch, instead of at random points of the hand.
E_fc
  is scaled to four contacts, the number for which the weights were chosen.
- The start is the human's wrist pose instead of a random pose around the object. As this leaves nothing to
  explore, the energy is minimized by Levenberg-Marquardt, which reaches the same energy as annealed random
  steps.
- Penetrations are those of the spheres that cover our hands; absolute values are smoothed within
  ``SMOOTHING_LENGTH``.
- Joints are kept within their limits, so that E_joints is zero.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from fungrasp.geometry.poses import cross
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import RetargetingProblem, gradient_derivative
from fungrasp.optimization.terms import Residual, Term
from fungrasp.retargeting.contact_optimization import initial_pose
from fungrasp.retargeting.settings import RetargetSettings

DISTANCE_WEIGHT = 100.0
"""w_dis [1/m]."""
PENETRATION_WEIGHT = 100.0
"""w_pen [1/m]."""
SELF_PENETRATION_WEIGHT = 10.0
"""w_spen [1/m]."""
SMOOTHING_LENGTH = 5e-4
"""Length below which |x| is treated as a parabola [m]."""
ORIGINAL_CONTACTS = 4
"""Number of contacts of the original."""
REACH = 0.006
"""Half width of the finite difference for the derivative of the normals [m]."""
ENERGY_ITERATIONS = 80
"""Solver iterations."""


object_penetration_energy: Term = partial(
    terms.object_penetration, unit=1 / PENETRATION_WEIGHT, count=48, smoothing=SMOOTHING_LENGTH
)
"""w_pen E_pen = w_pen sum max(0, depth) over the spheres that cover the hand."""

self_penetration_energy: Term = partial(
    terms.self_penetration,
    unit=1 / SELF_PENETRATION_WEIGHT,
    margin=0.0,
    count=16,
    smoothing=SMOOTHING_LENGTH,
)
"""w_spen E_spen = w_spen sum max(0, depth) over pairs of spheres of different fingers."""


def retarget_by_dexgraspnet(
    points: HandPoints, problem: RetargetingProblem, settings: RetargetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return wrist poses in the object's frame, shape [N, 7], and independent joints, shape [N, U].

    ``settings`` is not used; the weights are the original ones.
    """
    wrist_pose, independent = initial_pose(points, problem)
    energy: list[Term] = [
        object_penetration_energy,
        self_penetration_energy,
        terms.residual_terms([force_closure_energy, contact_distance_energy]),
    ]
    wrist_pose, independent, _ = minimize(points, problem, energy, wrist_pose, independent, ENERGY_ITERATIONS)
    return wrist_pose, independent


def force_closure_energy(state: HandState[RetargetingProblem]) -> Residual:
    """Return E_fc = |sum_i c_i|^2 + |sum_i x_i x c_i|^2, without friction (Liu et al. 2021).

    x_i [m] are the contact points of the n target links (``contact_spheres``), object frame; c_i are the
    object's inward unit normals there, times ``ORIGINAL_CONTACTS`` / n.
    """
    spheres, wanted = contact_spheres(state)
    bank, grid = state.problem.bank, state.problem.grid
    gradient = np.take_along_axis(state.normals, spheres[..., None], axis=1)
    size = np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-9)
    normal = gradient / size
    center = np.take_along_axis(state.spheres, spheres[..., None], axis=1)
    curvature = gradient_derivative(bank, grid, center, REACH)
    # Derivative of the normalized gradient: the part along the normal drops out.
    along = np.einsum("nqi,nqij->nqj", normal, curvature)
    curvature = (curvature - normal[..., None] * along[..., None, :]) / size[..., None]
    radius = state.points.spheres.radius[spheres][..., None]
    center_d = state.sphere_jacobian(spheres)
    normal_d = np.einsum("nqij,nqjd->nqid", curvature, center_d)
    place, place_d = center - radius * normal, center_d - radius[..., None] * normal_d
    torque = cross(place, -normal)
    torque_d = cross(np.swapaxes(place_d, 2, 3), -normal[:, :, None]) - cross(
        place[:, :, None], np.swapaxes(normal_d, 2, 3)
    )
    # E_fc is a square, and the objective is half of one: hence the factor sqrt(2) below.
    share = wanted * ORIGINAL_CONTACTS / np.maximum(wanted.sum(axis=1, keepdims=True), 1)
    wrench = np.sum(share[..., None] * np.concatenate([-normal, torque], axis=-1), axis=1)
    wrench_d = np.sum(
        share[..., None, None] * np.concatenate([-normal_d, np.swapaxes(torque_d, 2, 3)], axis=2), axis=1
    )
    return np.sqrt(2.0) * wrench, np.sqrt(2.0) * wrench_d


def contact_distance_energy(state: HandState[RetargetingProblem]) -> Residual:
    """Return w_dis E_dis = w_dis sum_i |d(x_i)|, d the signed distance of contact points from the object."""
    spheres, wanted = contact_spheres(state)
    distance = np.take_along_axis(state.clearance, spheres, axis=1)
    normal = np.take_along_axis(state.normals, spheres[..., None], axis=1)
    jacobian = np.einsum("nqi,nqid->nqd", normal, state.sphere_jacobian(spheres))
    return smooth_absolute((wanted * distance, wanted[..., None] * jacobian), DISTANCE_WEIGHT)


def contact_spheres(state: HandState[RetargetingProblem]) -> tuple[np.ndarray, np.ndarray]:
    """Return the sphere of each link nearest to the object.

    Returns:
        Sphere indices and whether the link should touch, shape [N, Q] each, for the Q links with spheres.
    """
    members = state.points.link_members
    links = [link for link in range(len(members)) if len(members[link])]
    nearest = [members[link][np.argmin(state.clearance[:, members[link]], axis=1)] for link in links]
    return np.stack(nearest, axis=1), state.problem.contacts[:, links]


def smooth_absolute(lengths: Residual, weight: float) -> Residual:
    """Return residuals whose halved squares are weight (sqrt(r^2 + SMOOTHING_LENGTH^2) - SMOOTHING_LENGTH),
    about weight |r|.

    Args:
        lengths: r [m] and its Jacobian.
        weight: [1/m].
    """
    r, jacobian = lengths
    hypotenuse = np.sqrt(r**2 + SMOOTHING_LENGTH**2)
    root = np.sqrt(2 * weight / (hypotenuse + SMOOTHING_LENGTH))
    slope = weight / (hypotenuse * root)
    return root * r, slope[..., None] * jacobian
