"""Pairs of links that may pass through each other."""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np

from fungrasp.hands.adding.couplings import Coupling
from fungrasp.hands.adding.link_shapes import HandShapes
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.checking.finding import Finding, listed, note
from fungrasp.hands.checking.kinematic_tree import body_name, joint_name

POSES = 200
"""Random poses in which shapes that always touch are looked for."""

ALWAYS = 0.6
"""Share of the poses in which shapes that touch are said to touch always."""


def exclude_neighbors(
    spec: mujoco.MjSpec,
    foreign: ForeignModel,
    structure: HandStructure,
    shapes: HandShapes,
    couplings: list[Coupling],
    findings: list[Finding],
) -> None:
    """Let neighbors, links of one finger, and shapes that always touch pass through each other."""

    def name(body: int) -> str:
        return body_name(foreign.model, body)

    palm = name(structure.palm)
    pairs: set[tuple[str, str]] = set()
    for chain in structure.fingers.values():
        members = [name(b) for b in chain.bodies]
        pairs |= {_pair(*pair) for pair in combinations(members, 2)}
    for body in shapes.links:
        if body != structure.palm:
            parent = shapes.owner(int(foreign.model.body_parentid[body]))
            pairs.add(_pair(name(body), name(parent)))
    for chain in structure.fingers.values():
        # Joints in one place make the first shape of a finger a neighbor of the palm.
        for body in chain.bodies:
            pairs.add(_pair(palm, name(body)))
            if body == chain.links[0]:
                break
    touching = _touching(spec, couplings, foreign.model)
    extra = sorted(set(touching) - pairs)
    for first, second in sorted(pairs) + extra:
        spec.add_exclude(bodyname1=first, bodyname2=second)
    if extra:
        shown = [f"{first} and {second}" for first, second in extra]
        findings.append(
            note(f"these touch always or at zero, and may pass through each other: {listed(shown)}")
        )


def _pair(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first < second else (second, first)


def _touching(spec: mujoco.MjSpec, couplings: list[Coupling], old: mujoco.MjModel) -> list[tuple[str, str]]:
    """Pairs of bodies whose shapes overlap at zero or in most of the random poses."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    kept = {joint_name(model, j) for j in range(model.njnt)}
    slopes = {
        joint_name(old, c.joint): (joint_name(old, c.driver), c.constant, c.slope)
        for c in couplings
        if joint_name(old, c.driver) in kept
    }

    def overlaps(positions: np.ndarray) -> set[tuple[str, str]]:
        for _ in range(len(slopes)):
            for j in range(model.njnt):
                if model.joint(j).name in slopes:
                    driver, constant, slope = slopes[model.joint(j).name]
                    positions[j] = constant + slope * positions[model.joint(driver).id]
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        found = set()
        for contact in data.contact:
            if contact.dist < -5e-4:
                found.add(_pair(*(model.body(int(model.geom_bodyid[g])).name for g in contact.geom)))
        return found

    zero = overlaps(np.clip(np.zeros(model.njnt), *model.jnt_range.T))
    counts: dict[tuple[str, str], int] = {}
    for _ in range(POSES):
        for pair in overlaps(rng.uniform(*model.jnt_range.T)):
            counts[pair] = counts.get(pair, 0) + 1
    return sorted(zero | {pair for pair, count in counts.items() if count > ALWAYS * POSES})
