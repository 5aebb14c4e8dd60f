"""Collision shapes of a hand's links: primitives of the file, fits to its meshes, or default shapes."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from fungrasp.hands.adding.finger_chains import (
    NEARLY_NOTHING,
    Chain,
    first_anchor,
    members,
    midline,
    primitives,
    surface_points,
)
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.shape_fitting import (
    Box,
    Capsule,
    fit_boxes,
    fit_capsule,
    mesh_points,
)
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.findings import Finding, listed, note, warning
from fungrasp.hands.kinematic_tree import body_name, subtree

Shape = Capsule | Box | int
"""A fitted shape, or the id of a primitive geom of the foreign model."""


@dataclass
class LinkShapes:
    """Collision shapes of one body of the new model."""

    body: int
    """Id of the body in the foreign model."""
    members: tuple[int, ...]
    """Bodies of the foreign model that are merged into this one, itself first."""
    shapes: list[Shape] = field(default_factory=list)
    """Capsules and boxes, body frame, and ids of primitive geoms."""


@dataclass
class HandShapes:
    """Collision shapes of all bodies of the new model, and key points that depend on them."""

    links: dict[int, LinkShapes]
    """Shapes by body id of the foreign model, parents first."""
    joints: dict[int, np.ndarray]
    """Point at the joint in the middle of the finger, by body id, body frame [m], shape [3]."""
    tips: dict[str, np.ndarray]
    """Center of the rounded tip by finger, frame of the last link [m], shape [3]."""

    def owner(self, body: int) -> int:
        """Return the new body that contains a body of the foreign model."""
        return next(new for new, link in self.links.items() if body in link.members)


def hand_shapes(
    foreign: ForeignModel,
    structure: HandStructure,
    poses: Poses,
    ends: dict[int, np.ndarray],
    radius: float | None,
    findings: list[Finding],
) -> HandShapes:
    """Return collision shapes, joints and tips. ``poses`` is set to straight fingers.

    Args:
        ends: far end of each moving body, by body id, body frame [m], shape [3].
        radius: radius of fingers without shapes [m]. None: by ``finger_radii``.
        findings: fitted and default shapes are added.
    """
    model = foreign.model
    independent = np.linalg.pinv(poses.matrix) @ (structure.straight - poses.offset)
    poses.set(independent)
    chain_of = {b: (name, chain) for name, chain in structure.fingers.items() for b in chain.bodies}
    order = [
        structure.palm,
        *(b for b in subtree(model, structure.palm) if model.body_jntnum[b] > 0 and b != structure.palm),
    ]
    links = {b: LinkShapes(b, members(model, b, structure.palm)) for b in order}
    links[structure.palm] = _palm_link(foreign, structure, poses, links[structure.palm], findings)
    result = HandShapes(links, {}, {})
    sizes = finger_radii(foreign, structure, poses, ends)
    if radius is not None:
        sizes = dict.fromkeys(sizes, radius)
    for name, chain in structure.fingers.items():
        _tip(foreign, poses, name, chain, ends, sizes[name], result)
        for body in chain.bodies:
            result.joints[body] = poses.moved(
                midline(poses, chain, body, result.tips[name]), poses.palm, body
            )
    errors, made = [], []
    finger_links = {b for chain in structure.fingers.values() for b in chain.links}
    for body, link in links.items():
        if body == structure.palm:
            continue
        kept, points = _known(foreign, poses, link, body in finger_links)
        if kept:
            link.shapes = list(kept)
        elif points is not None:
            ahead = ends[body] - first_anchor(model, body)
            capsule = fit_capsule(points, ahead if np.linalg.norm(ahead) > 1e-6 else np.array([0, 0, 1.0]))
            if _inside_the_next(model, body, chain_of, capsule):
                continue
            errors.append((body_name(model, body), np.abs(capsule.distance(points))))
            link.shapes = [capsule]
        elif body in chain_of:
            name, chain = chain_of[body]
            capsule = made_up_capsule(poses, chain, body, result.joints, result.tips[name], sizes[name])
            if capsule is not None:
                made.append(body_name(model, body))
                link.shapes = [capsule]
    _palm_shapes(foreign, structure, poses, result, sizes, errors, findings)
    for name, chain in structure.fingers.items():
        _tip_of_shape(result, foreign, name, chain)
    if errors:
        cloud = np.concatenate([distances for _, distances in errors])
        worst, distances = max(errors, key=lambda error: error[1].max())
        findings.append(
            note(
                f"capsules and boxes replace the shapes of {len(errors)} links; their surfaces differ by "
                f"{1e3 * cloud.mean():.1f} mm on average, and by up to {1e3 * distances.max():.1f} mm at "
                f"'{worst}'"
            )
        )
    if made:
        radii = ", ".join(f"{name} {1e3 * size:.1f} mm" for name, size in sizes.items())
        findings.append(
            warning(
                f"no geometry for the link {listed(made)}: capsules from joint to joint are used, radius "
                f"{radii}; give the mesh files, or --radius"
            )
        )
    return result


PALM_REACH = 0.25
"""Largest distance of a palm's shapes from the bases of the fingers [m]: a hand is 0.2 m long."""


def _palm_link(
    foreign: ForeignModel, structure: HandStructure, poses: Poses, palm: LinkShapes, findings: list[Finding]
) -> LinkShapes:
    """Return the palm without stands, flanges and other hands that are fixed to it: a body that is not below
    the palm belongs to it only within ``PALM_REACH`` of the fingers. Findings name both kinds."""
    model = foreign.model
    toward = {palm.body, *subtree(model, palm.body)}
    bases = np.array([poses.anchor(chain.links[0]) for chain in structure.fingers.values()])
    kept, taken, left = [palm.body], [], []
    for body in palm.members[1:]:
        points = poses.moved(surface_points(foreign, body), body, palm.body)
        far = np.linalg.norm(points[:, None] - bases, axis=-1).min(axis=1).max(initial=0.0)
        if body not in toward and far > PALM_REACH:
            left.append(f"{body_name(model, body)} ({far:.2f} m)")
            continue
        kept.append(body)
        if body not in toward and len(points):
            taken.append(body_name(model, body))
    if left:
        findings.append(
            warning(
                f"{listed(left)} is fixed to the palm, but too far from the fingers: not part of the hand"
            )
        )
    if taken:
        findings.append(note(f"{listed(taken)} is fixed to the palm: taken as part of it"))
    return LinkShapes(palm.body, tuple(kept))


def _inside_the_next(
    model: mujoco.MjModel, body: int, chain_of: dict[int, tuple[str, Chain]], capsule: Capsule
) -> bool:
    """Return whether a body only connects the axes of one joint: it is shorter than thick, and the next joint
    is at the same place."""
    if body not in chain_of or body == chain_of[body][1].bodies[-1]:
        return False
    bodies = chain_of[body][1].bodies
    after = bodies[bodies.index(body) + 1]
    gap = model.body_pos[after] + first_anchor(model, after) - first_anchor(model, body)
    short = np.linalg.norm(capsule.end - capsule.start) < capsule.radius
    return bool(short and np.linalg.norm(gap) < NEARLY_NOTHING)


def _known(
    foreign: ForeignModel, poses: Poses, link: LinkShapes, in_finger: bool
) -> tuple[list[int], np.ndarray | None]:
    """Return primitives to keep, which must be round if ``in_finger``, or else surface points to fit, body
    frame [m], shape [P, 3]. Both are empty if the shape is unknown."""
    model, kinds = foreign.model, mujoco.mjtGeom
    stripped = any(member in foreign.stripped for member in link.members)
    simple = [geom for member in link.members for geom in primitives(model, member)]
    meshes = [mesh for member in link.members for mesh in foreign.meshes.get(member, [])]
    solid = any(mesh.collides for mesh in meshes)
    is_round = [int(model.geom_type[geom]) in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE) for geom in simple]
    if simple and (all(is_round) or not in_finger) and not solid and not stripped:
        return simple, None
    if stripped and not meshes:
        return [], None
    clouds = [poses.moved(surface_points(foreign, member), member, link.body) for member in link.members]
    points = np.concatenate(clouds)
    return [], points if len(points) >= 10 else None


def _tip(
    foreign: ForeignModel,
    poses: Poses,
    name: str,
    chain: Chain,
    ends: dict[int, np.ndarray],
    radius: float,
    result: HandShapes,
) -> None:
    """Set the tip one radius before the far end, the center of a rounded end."""
    body = chain.bodies[-1]
    end, anchor = ends[body], first_anchor(foreign.model, body)
    length = float(np.linalg.norm(end - anchor))
    inset = min(radius, max(0.0, length - 1.5 * radius))
    result.tips[name] = end - inset * (end - anchor) / max(length, 1e-9)


def _palm_shapes(
    foreign: ForeignModel,
    structure: HandStructure,
    poses: Poses,
    result: HandShapes,
    sizes: dict[str, float],
    errors: list[tuple[str, np.ndarray]],
    findings: list[Finding],
) -> None:
    link, model = result.links[structure.palm], foreign.model
    axes = np.stack([structure.along, structure.normal, np.cross(structure.along, structure.normal)], axis=1)
    link.shapes = [geom for member in link.members for geom in primitives(model, member)]
    meshes = [(member, mesh) for member in link.members for mesh in foreign.meshes.get(member, [])]
    solid = [(member, mesh) for member, mesh in meshes if mesh.collides]
    for member, mesh in solid or ([] if link.shapes else meshes):
        vertices = poses.moved(mesh.vertices, member, structure.palm)
        boxes = fit_boxes(vertices, mesh.faces, axes)
        points = mesh_points(vertices, mesh.faces)
        distance = np.min([box.distance(points) for box in boxes], axis=0)
        errors.append((body_name(model, structure.palm), np.abs(distance)))
        link.shapes += boxes
    if link.shapes:
        return
    link.shapes = [made_up_palm(structure, poses, result.joints, sizes, findings)]


def _tip_of_shape(result: HandShapes, foreign: ForeignModel, name: str, chain: Chain) -> None:
    """Set the tip to the center of the rounded end of the last link's shape, if it has one."""
    model, body = foreign.model, chain.bodies[-1]
    anchor = first_anchor(model, body)
    centers = []
    for shape in result.links[body].shapes:
        if isinstance(shape, Capsule):
            centers += [shape.start, shape.end]
        elif isinstance(shape, int) and model.geom_bodyid[shape] == body:
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, model.geom_quat[shape])
            half = (
                model.geom_size[shape, 1] if model.geom_type[shape] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
            )
            z = rotation.reshape(3, 3)[:, 2]
            centers += [model.geom_pos[shape] + sign * half * z for sign in (-1, 1)]
    if centers:
        result.tips[name] = max(centers, key=lambda c: float(np.linalg.norm(c - anchor)))


FINGER_RADIUS = 0.09
"""Default ratio of a finger's radius to its length from the knuckle: an adult index finger is 95 mm long and
16 to 20 mm wide."""

THUMB_WIDER = 1.15
"""Factor by which a thumb is wider than an equally long finger."""

RADIUS_RANGE = (0.004, 0.014)
"""Range of default radii [m]."""

PALM_THICKNESS = 0.026
"""Thickness of the default palm [m]."""

PALM_LENGTH = 0.06
"""Smallest length of the default palm [m]."""


def finger_radii(
    foreign: ForeignModel, structure: HandStructure, poses: Poses, ends: dict[int, np.ndarray]
) -> dict[str, float]:
    """Return default radii by finger [m]: that of the finger's round shapes, else that of a human finger of
    its length. Radii are limited so that neighbors do not touch."""
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
    """Return the default capsule of a link, from its joint to the next or to the tip; None for a link without
    length."""
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
    """Return the default palm: a box below the fingers, as wide as they are.

    Args:
        poses: kinematics, set to straight fingers.
        joints: point at the joint of each body, by body id, body frame [m], shape [3].
        sizes: radius of each finger [m].
        findings: the size of the box is added.
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
            f"no geometry for the palm '{body_name(model, structure.palm)}': a box of "
            f"{' x '.join(f'{1e3 * edge:.0f}' for edge in high - low)} mm below the fingers is used"
        )
    )
    return Box(axes @ (0.5 * (low + high)), 0.5 * (high - low), axes)
