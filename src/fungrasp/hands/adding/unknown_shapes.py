"""Shapes for links of which nothing is known: capsules from joint to joint, a box for the palm."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands.adding.finger_chains import Chain
from fungrasp.hands.adding.link_points import NEARLY_NOTHING, members, primitives
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.shape_fitting import Box, Capsule
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.checking.finding import Finding, warning
from fungrasp.hands.checking.kinematic_tree import body_name

FINGER_RADIUS = 0.09
"""Radius of a finger of which nothing is known, as a share of its length from the knuckle: an adult index
finger is 95 mm long and 16 to 20 mm wide."""

THUMB_WIDER = 1.15
"""Factor for a thumb."""

RADIUS_RANGE = (0.004, 0.014)
"""Within which made-up radii stay [m]."""

PALM_THICKNESS = 0.026
"""Of a made-up palm [m]."""

PALM_LENGTH = 0.06
"""Least length of a made-up palm [m]."""


def finger_radii(
    foreign: ForeignModel, structure: HandStructure, poses: Poses, ends: dict[int, np.ndarray]
) -> dict[str, float]:
    """Radius for made-up links by finger [m]: of round shapes of the hand, else of a human finger of that
    length; so that neighbors don't touch."""
    model = foreign.model
    bases = {name: poses.anchor(chain.links[0]) for name, chain in structure.fingers.items()}
    sizes = {}
    long = [name for name in structure.fingers if name != "thumb"]
    across = np.cross(structure.along, structure.normal)
    for name, chain in structure.fingers.items():
        tip = poses.of_body(chain.bodies[-1], ends[chain.bodies[-1]])
        length = float(np.linalg.norm(tip - bases[name]))
        size = FINGER_RADIUS * length * (THUMB_WIDER if name == "thumb" else 1.0)
        group = {m for body in chain.links for m in members(model, body)}
        near = [
            float(model.geom_size[g, 0])
            for b in sorted(group)
            for g in primitives(model, b)
            if int(model.geom_type[g]) in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)
        ]
        if near:
            size = float(np.median(near))
        gaps = [abs(float((bases[name] - bases[other]) @ across)) for other in long if other != name]
        if name != "thumb" and gaps:
            size = min(size, 0.5 * min(gaps) - 0.0005)
        sizes[name] = float(np.clip(size, *RADIUS_RANGE))
    return sizes


def made_up_capsule(
    poses: Poses, chain: Chain, body: int, joints: dict[int, np.ndarray], tip: np.ndarray, radius: float
) -> Capsule | None:
    """A capsule from a finger link's joint to the next, or to the tip, where no shape is known; None for a
    link without length."""
    i = chain.bodies.index(body)
    start = joints[body]
    if i + 1 < len(chain.bodies):
        after = chain.bodies[i + 1]
        end = poses.moved(joints[after][None], after, body)[0]
    else:
        end = tip
    if i + 1 < len(chain.bodies) and np.linalg.norm(end - start) < NEARLY_NOTHING:
        return None
    return Capsule(start, end, radius)


def made_up_palm(
    structure: HandStructure,
    poses: Poses,
    joints: dict[int, np.ndarray],
    sizes: dict[str, float],
    findings: list[Finding],
) -> Box:
    """A box below the fingers, as wide as they are.

    Args:
        structure: of the hand.
        poses: with straight fingers.
        joints: by body of a finger: the point at its joint, its own frame [m].
        sizes: radius of each finger [m].
        findings: what was made up is added.
    """
    model = poses.model
    axes = np.stack([structure.along, structure.normal, np.cross(structure.along, structure.normal)], axis=1)
    bases = np.array(
        [poses.of_body(c.links[0], joints[c.links[0]]) for n, c in structure.fingers.items() if n != "thumb"]
    )
    thumb = poses.anchor(structure.fingers["thumb"].bodies[0])
    local = bases @ axes
    top = float(local[:, 0].min()) - max(sizes.values())
    bottom = min(top - PALM_LENGTH, float(thumb @ axes[:, 0]) - 0.01, max(0.0, top - 0.11))
    side = max(sizes.values())
    low = np.array([bottom, local[:, 1].mean() - 0.5 * PALM_THICKNESS, local[:, 2].min() - side])
    high = np.array([top, local[:, 1].mean() + 0.5 * PALM_THICKNESS, local[:, 2].max() + side])
    findings.append(
        warning(
            f"no shape of the palm '{body_name(model, structure.palm)}' is known: a box of "
            f"{' x '.join(f'{1e3 * edge:.0f}' for edge in high - low)} mm below the fingers was made up"
        )
    )
    return Box(axes @ (0.5 * (low + high)), 0.5 * (high - low), axes)
