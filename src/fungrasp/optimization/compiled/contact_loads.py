"""What contacts leave unresisted: the loops of ``fungrasp.optimization.firmness``."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.signed_distance import GridArrays
from fungrasp.optimization.compiled.closure_term import circle, cone_edges, largest_eigenvalue
from fungrasp.optimization.compiled.collision_terms import least_clearance
from fungrasp.optimization.compiled.compiling import compiled
from fungrasp.optimization.compiled.distances import signed_distance, unit_vector
from fungrasp.optimization.compiled.frames import Frames, place
from fungrasp.optimization.compiled.hand_arrays import HandArrays, Tree


class LoadRule(NamedTuple):
    """Constants of ``firmness``."""

    contact_distance: float
    """Links nearer to the object than this touch it [m]."""
    deepest: float
    """Hands farther in the object than this have no grip [m]."""
    no_grip: float
    """Share of the weight that these leave."""
    edges: int
    """Edges of a friction cone."""
    limit_weight: float
    """Weight of a torque at twice its limit."""
    friction: float
    """Coefficient."""
    disturbance: float
    """In weights."""
    iterations: int
    """Of the descent."""


class Loads(NamedTuple):
    """What N grasps must resist."""

    center: np.ndarray
    """Centers of mass [m], shape [N, 3]."""
    extent: np.ndarray
    """Lever arms at which a torque counts like a force [m], shape [N]."""
    weight: np.ndarray
    """[N], shape [N]."""
    up: np.ndarray
    """Unit vectors against gravity, shape [N, 3]."""
    torque_limit: np.ndarray
    """Of the independent joints [N m], shape [U]."""


class Presses(NamedTuple):
    """How each edge of each contact's friction cone acts; C contacts of E edges, K = C E."""

    wrench: np.ndarray
    """Force, and torque over the extent, of a unit along the edge, shape [K, 6]."""
    torque: np.ndarray
    """Of the joints that move the contact, over their limits, shape [K, Q]."""
    column: np.ndarray
    """Which joints those are, shape [C, Q]."""
    count: np.ndarray
    """How many, shape [C]."""


@compiled
def unresisted_shares(
    hand: HandArrays,
    frames: Frames,
    grids: GridArrays,
    grid: np.ndarray,
    loads: Loads,
    active: np.ndarray,
    rule: LoadRule,
    result: np.ndarray,
) -> None:
    """Write the shares of the weight that hands leave unresisted, as ``firmness.unresisted_share``.

    Args:
        hand: with dense spheres.
        grid: of each hand's object, shape [N].
        active: which hands to judge, shape [N] bool.
        result: shape [N].
    """
    tree, links = hand.tree, len(hand.groups.link_start) - 1
    longest = max(1, np.max(np.diff(tree.chain_start)))
    count, size = links * rule.edges, tree.coupling.shape[1]
    presses = Presses(
        np.empty((count, 6)),
        np.empty((count, longest)),
        np.empty((links, longest), np.int64),
        np.empty(links, np.int64),
    )
    work = np.empty((6 + size, count))
    for i in range(len(active)):
        if not active[i]:
            continue
        number, least = _presses(hand, frames, i, grids, grid[i], loads, rule, presses)
        if least < -rule.deepest:
            result[i] = rule.no_grip
        else:
            result[i] = _worst(presses, number, loads.up[i], size, rule, work)


@compiled
def _presses(hand, frames, i: int, grids, grid: int, loads, rule, presses):
    """Fill ``presses`` for the links in contact; how many there are, and the least clearance [m]."""
    groups = hand.groups
    edges, around = np.empty((rule.edges, 3)), circle(rule.edges)
    number, deepest = 0, math.inf
    for link in range(len(groups.link_start) - 1):
        least, nearest = rule.contact_distance, -1
        nx, ny, nz = 0.0, 0.0, 0.0
        for group in range(groups.link_start[link], groups.link_start[link + 1]):
            if least_clearance(grids, grid, hand, frames, i, group) > least:
                continue
            for k in range(groups.start[group], groups.start[group + 1]):
                ball = groups.members[k]
                point = place(frames, i, hand.spheres.body[ball], hand.spheres.offset[ball])
                distance, gx, gy, gz = signed_distance(grids, grid, point)
                if distance - hand.radius[ball] < least:
                    least, nearest, nx, ny, nz = distance - hand.radius[ball], ball, gx, gy, gz
        if nearest < 0:
            continue
        deepest = min(deepest, least)
        body, r = hand.spheres.body[nearest], hand.radius[nearest]
        normal = unit_vector(nx, ny, nz)
        x, y, z = place(frames, i, body, hand.spheres.offset[nearest])
        point = (x - r * normal[0], y - r * normal[1], z - r * normal[2])
        cone_edges(normal, rule.friction, around, edges)
        _press(hand.tree, frames, i, body, point, number, edges, loads, rule, presses)
        number += 1
    return number, deepest


@compiled
def _press(tree: Tree, frames, i: int, body: int, point, contact: int, edges, loads, rule, presses) -> None:
    """One contact, at ``point`` [m] on ``body``."""
    first, extent = contact * len(edges), loads.extent[i]
    lx, ly, lz = (
        (point[0] - loads.center[i, 0]) / extent,
        (point[1] - loads.center[i, 1]) / extent,
        (point[2] - loads.center[i, 2]) / extent,
    )
    for e in range(len(edges)):
        x, y, z = edges[e, 0], edges[e, 1], edges[e, 2]
        row = presses.wrench[first + e]
        row[0], row[1], row[2] = x, y, z
        row[3], row[4], row[5] = ly * z - lz * y, lz * x - lx * z, lx * y - ly * x
    used = 0
    for entry in range(tree.chain_start[body], tree.chain_start[body + 1]):
        joint, unknown = tree.chain_joint[entry], tree.chain_column[entry] - 6
        slot = 0
        while slot < used and presses.column[contact, slot] != unknown:
            slot += 1
        if slot == used:
            presses.column[contact, slot] = unknown
            for e in range(len(edges)):
                presses.torque[first + e, slot] = 0.0
            used += 1
        rx, ry, rz = (
            point[0] - frames.anchor[i, joint, 0],
            point[1] - frames.anchor[i, joint, 1],
            point[2] - frames.anchor[i, joint, 2],
        )
        a, b, c = frames.axis[i, joint, 0], frames.axis[i, joint, 1], frames.axis[i, joint, 2]
        mx, my, mz = b * rz - c * ry, c * rx - a * rz, a * ry - b * rx
        scale = tree.chain_factor[entry] * rule.limit_weight * loads.weight[i] / loads.torque_limit[unknown]
        for e in range(len(edges)):
            moved = edges[e, 0] * mx + edges[e, 1] * my + edges[e, 2] * mz
            presses.torque[first + e, slot] += scale * moved
    presses.count[contact] = used


@compiled
def _worst(presses, number: int, up, size: int, rule, work) -> float:
    """Largest of what the six loads leave, in weights."""
    count = number * rule.edges
    work[:, :count] = 0.0
    for c in range(number):
        for k in range(c * rule.edges, (c + 1) * rule.edges):
            for d in range(6):
                work[d, k] = presses.wrench[k, d]
            for q in range(presses.count[c]):
                work[6 + presses.column[c, q], k] = presses.torque[k, q]
    step = 1.0 / (largest_eigenvalue(work, 6 + size, count) + 1e-3) if number else 1.0
    if abs(up[0]) < 0.9:
        first = unit_vector(0.0, up[2], -up[1])
    else:
        first = unit_vector(-up[2], 0.0, up[0])
    second = (
        up[1] * first[2] - up[2] * first[1],
        up[2] * first[0] - up[0] * first[2],
        up[0] * first[1] - up[1] * first[0],
    )
    largest = 0.0
    for axis in range(3):
        pull = (up[0], up[1], up[2]) if axis == 0 else first if axis == 1 else second
        for sign in (-rule.disturbance, rule.disturbance):
            load = (up[0] + sign * pull[0], up[1] + sign * pull[1], up[2] + sign * pull[2])
            largest = max(largest, _left(presses, number, load, size, step, rule))
    return largest


@compiled
def _left(presses, number: int, load, size: int, step: float, rule) -> float:
    """What the best contact forces leave of a load, both in weights."""
    count, edges, limit = number * rule.edges, rule.edges, rule.limit_weight
    wrench, torque, column = presses.wrench, presses.torque, presses.column
    weights, ahead, excess = np.zeros(count), np.zeros(count), np.zeros(size)
    momentum = 1.0
    for _ in range(rule.iterations):
        # One accumulator each: sums that do not wait for each other.
        a, b, c, d, e, f = -load[0], -load[1], -load[2], 0.0, 0.0, 0.0
        excess[:] = 0.0
        for k in range(count):
            w = ahead[k]
            if w != 0.0:
                a += wrench[k, 0] * w
                b += wrench[k, 1] * w
                c += wrench[k, 2] * w
                d += wrench[k, 3] * w
                e += wrench[k, 4] * w
                f += wrench[k, 5] * w
                contact = k // edges
                for q in range(presses.count[contact]):
                    excess[column[contact, q]] += torque[k, q] * w
        for u in range(size):
            excess[u] -= min(max(excess[u], -limit), limit)
        following = 0.5 * (1 + math.sqrt(1 + 4 * momentum * momentum))
        carry = (momentum - 1) / following
        momentum = following
        for k in range(count):
            contact = k // edges
            change = 1e-3 * ahead[k]
            change += (
                wrench[k, 0] * a + wrench[k, 1] * b + wrench[k, 2] * c
                + wrench[k, 3] * d + wrench[k, 4] * e + wrench[k, 5] * f
            )  # fmt: skip
            for q in range(presses.count[contact]):
                change += torque[k, q] * excess[column[contact, q]]
            moved = max(ahead[k] - step * change, 0.0)
            ahead[k] = moved + carry * (moved - weights[k])
            weights[k] = moved
    total = 0.0
    for part in range(6):
        left = -load[part] if part < 3 else 0.0
        for k in range(count):
            left += wrench[k, part] * weights[k]
        total += left * left
    return math.sqrt(total)
