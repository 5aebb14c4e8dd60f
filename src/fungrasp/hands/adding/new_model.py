"""Build the model of an added hand, with its contact exclusions."""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np

from fungrasp.hands.adding.couplings import from_reference
from fungrasp.hands.adding.link_shapes import HandShapes, LinkShapes
from fungrasp.hands.adding.model_file import DENSITY, ForeignModel
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.servos import JointPhysics
from fungrasp.hands.adding.shape_fitting import Box, Capsule, coarse
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.collisions import self_contacts, zero_and_random_poses
from fungrasp.hands.findings import listed, note, warning
from fungrasp.hands.kinematic_tree import Drive, body_name, joint_name
from fungrasp.hands.plausibility import FAR_MASS

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""Geom groups of visual meshes and collision shapes, by MuJoCo's convention."""

STILL = 1e-3
"""Half range of a joint that closed loops fix [rad]: ranges must not be empty."""


def new_model(
    foreign: ForeignModel,
    structure: HandStructure,
    poses: Poses,
    shapes: HandShapes,
    couplings: dict[int, Drive],
    physics: JointPhysics,
) -> mujoco.MjSpec:
    """Build the model, its palm fixed at the origin, with sites at joints ("index_joint_1") and tips
    ("index_tip")."""
    model = foreign.model
    # In the new model, the file's pose is at zero.
    poses.data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, poses.data)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies: dict[int, mujoco.MjsBody] = {}
    guessed, moved = [], []
    ranges = _ranges(poses)
    for body, link in shapes.links.items():
        if body == structure.palm:
            new = spec.worldbody.add_body(name=body_name(model, body))
        else:
            parent = shapes.owner(int(model.body_parentid[body]))
            pos, quat = _relative(poses, body, parent)
            new = bodies[parent].add_body(name=body_name(model, body), pos=pos, quat=quat)
            _add_joints(new, model, body, physics, ranges)
        bodies[body] = new
        _add_shapes(spec, new, foreign, poses, link)
        if not _add_mass(new, foreign, poses, link, moved):
            guessed.append(body_name(model, body))
    for finger, chain in structure.fingers.items():
        for i, link in enumerate(chain.links):
            bodies[link].add_site(
                name=f"{finger}_joint_{i + 1}", pos=shapes.joints[link], size=[0.002, 0, 0], group=4
            )
        bodies[chain.bodies[-1]].add_site(
            name=f"{finger}_tip", pos=shapes.tips[finger], size=[0.002, 0, 0], group=4
        )
    for joint, drive in couplings.items():
        ends = [int(model.jnt_bodyid[j]) for j in (joint, drive.driver)]
        if not set(ends) <= set(shapes.links) - {structure.palm}:
            continue
        equality = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=joint_name(model, joint),
            name2=joint_name(model, drive.driver),
        )
        equality.data[:5] = [from_reference(model, joint, drive), drive.slope, 0.0, 0.0, 0.0]
        equality.solref[:2] = [0.01, 1.0]
        equality.solimp[:3] = [0.99, 0.999, 0.001]
    if guessed:
        foreign.findings.append(
            warning(
                f"the mass of {listed(guessed)} is unknown: computed from its shapes at {DENSITY:g} kg/m3"
            )
        )
    if moved:
        foreign.findings.append(
            warning(
                f"the center of mass lies far outside the shapes of {listed(moved)}: put into their middle"
            )
        )
    exclude_neighbors(spec, foreign, structure, shapes)
    return spec


def _relative(poses: Poses, body: int, parent: int) -> tuple[np.ndarray, np.ndarray]:
    data, inverse, quat, pos = poses.data, np.zeros(4), np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_mulQuat(quat, inverse, data.xquat[body])
    mujoco.mju_rotVecQuat(pos, data.xpos[body] - data.xpos[parent], inverse)
    return _clean(pos), _clean(quat)


def _clean(values: np.ndarray) -> np.ndarray:
    """Round off numerical noise, so that files do not differ."""
    return np.round(values, 9) + 0.0


def _ranges(poses: Poses) -> np.ndarray:
    """Return limits of all joints that agree with the couplings [rad], shape [M, 2]."""
    ends = poses.matrix @ np.stack([poses.low, poses.high], axis=1) + poses.offset[:, None]
    still = np.ptp(ends, axis=1, keepdims=True) < STILL
    return np.sort(ends, axis=1) + still * [-STILL, STILL]


def _add_joints(
    new: mujoco.MjsBody, model: mujoco.MjModel, body: int, physics: JointPhysics, ranges: np.ndarray
) -> None:
    for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        joint = new.add_joint(
            name=joint_name(model, j),
            type=mujoco.mjtJoint(model.jnt_type[j]),
            pos=_clean(model.jnt_pos[j]),
            axis=_clean(model.jnt_axis[j]),
            armature=float(physics.armature[j]),
            frictionloss=float(physics.frictionloss[j]),
        )
        # In the new model, the file's pose is at zero: limits shift by the reference.
        reference = float(model.qpos0[model.jnt_qposadr[j]])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = _clean(ranges[j] - reference)
        joint.damping = _like(joint.damping, float(physics.damping[j]))
        joint.stiffness = _like(joint.stiffness, float(model.jnt_stiffness[j]))
        if model.jnt_stiffness[j] > 0:
            joint.springref = float(model.qpos_spring[model.jnt_qposadr[j]]) - reference


def _like(old, value: float):
    """Return a number or the coefficients of a polynomial, whichever this version of MuJoCo uses."""
    return value if np.ndim(old) == 0 else [value, *([0.0] * (len(old) - 1))]


def _add_shapes(
    spec: mujoco.MjSpec, new: mujoco.MjsBody, foreign: ForeignModel, poses: Poses, link: LinkShapes
) -> None:
    meshes = [(member, mesh) for member in link.members for mesh in foreign.meshes.get(member, [])]
    shown = [pair for pair in meshes if not pair[1].collides] or meshes
    for i, (member, mesh) in enumerate(shown):
        vertices, faces = coarse(poses.moved(mesh.vertices, member, link.body), mesh.faces)
        if len(faces) < 4:
            continue
        asset = spec.add_mesh(name=f"{new.name}_{i}")
        asset.uservert, asset.userface = np.round(vertices, 6).ravel(), faces.ravel()
        # Thin or open surfaces have no volume.
        asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = new.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=asset.name, mass=0.0, group=VISUAL_GROUP
        )
        geom.contype, geom.conaffinity, geom.rgba = 0, 0, mesh.rgba
    group = COLLISION_GROUP if shown else 0
    for shape in link.shapes:
        if isinstance(shape, Capsule):
            geom = new.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[round(shape.radius, 5), 0, 0])
            ends = np.stack([shape.start, shape.end])
            if np.linalg.norm(ends[1] - ends[0]) < 1e-3:
                geom.type, geom.pos = mujoco.mjtGeom.mjGEOM_SPHERE, np.round(ends.mean(axis=0), 6)
            else:
                geom.fromto = np.round(ends, 6).ravel()
        elif isinstance(shape, Box):
            quat = np.zeros(4)
            rotation = shape.rotation.copy()
            rotation[:, 2] *= np.sign(np.linalg.det(rotation))
            mujoco.mju_mat2Quat(quat, rotation.ravel())
            geom = new.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=np.round(shape.half, 6),
                pos=np.round(shape.center, 6),
                quat=_clean(quat),
            )
        else:
            geom = _kept(new, foreign.model, poses, link.body, shape)
        geom.group, geom.density = group, DENSITY


def _kept(new: mujoco.MjsBody, model: mujoco.MjModel, poses: Poses, body: int, geom: int) -> mujoco.MjsGeom:
    member = int(model.geom_bodyid[geom])
    pos, quat = _relative(poses, member, body)
    turned, place = np.zeros(4), np.zeros(3)
    mujoco.mju_mulQuat(turned, quat, model.geom_quat[geom])
    mujoco.mju_rotVecQuat(place, model.geom_pos[geom], quat)
    size = model.geom_size[geom].astype(float)
    return new.add_geom(
        type=mujoco.mjtGeom(model.geom_type[geom]),
        size=size,
        pos=_clean(place + pos),
        quat=_clean(turned),
        rgba=model.geom_rgba[geom].astype(float),
    )


def _add_mass(
    new: mujoco.MjsBody, foreign: ForeignModel, poses: Poses, link: LinkShapes, moved: list[str]
) -> bool:
    """Set the common mass and inertia of all members. Return False if they must follow from the shapes.

    moved: bodies whose center of mass is far outside their shapes, and therefore moved, are added.
    """
    model, data = foreign.model, poses.data
    known = [m for m in link.members if m not in foreign.massless and model.body_mass[m] > 1e-6]
    if not known:
        if any(geom.contype for geom in new.geoms):
            return False
        # The axes of one joint are connected by bodies without size.
        new.mass, new.ipos, new.inertia, new.explicitinertial = 1e-3, np.zeros(3), [1e-7] * 3, True
        return True
    masses = model.body_mass[known]
    to_body = data.xmat[link.body].reshape(3, 3)
    centers = (data.xipos[known] - data.xpos[link.body]) @ to_body
    center = masses @ centers / masses.sum()
    total = np.zeros((3, 3))
    for member, mass, place in zip(known, masses, centers, strict=True):
        axes = to_body.T @ data.ximat[member].reshape(3, 3)
        arm = place - center
        total += axes @ np.diag(model.body_inertia[member]) @ axes.T
        total += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    middle = _middle_if_outside(center, foreign, poses, link)
    if middle is not None:
        moved.append(f"{new.name} ({1e3 * np.linalg.norm(center - middle):.0f} mm)")
        center = middle
    new.mass, new.ipos, new.explicitinertial = float(masses.sum()), _clean(center), True
    new.fullinertia = [total[0, 0], total[1, 1], total[2, 2], total[0, 1], total[0, 2], total[1, 2]]
    return True


def _middle_if_outside(
    center: np.ndarray, foreign: ForeignModel, poses: Poses, link: LinkShapes
) -> np.ndarray | None:
    """Return the mean of the shapes' centers if the center of mass is far outside, else None; body frame [m],
    shape [3]."""
    model, middles, gaps = foreign.model, [], []
    for shape in link.shapes:
        if isinstance(shape, int):
            place = model.geom_pos[shape][None]
            middles.append(poses.moved(place, int(model.geom_bodyid[shape]), link.body)[0])
            gaps.append(float(np.linalg.norm(center - middles[-1]) - model.geom_rbound[shape]))
        else:
            middles.append(shape.center if isinstance(shape, Box) else 0.5 * (shape.start + shape.end))
            gaps.append(float(shape.distance(center[None])[0]))
    return np.mean(middles, axis=0) if gaps and min(gaps) > FAR_MASS else None


ALWAYS = 0.6
"""Links that touch in a larger share of poses are excluded from collisions."""

OFTEN = 0.03
"""The palm and a link other than the last of a finger are excluded from collisions if they touch in a larger
share of poses: the limits of joints keep the real ones apart."""

TOUCH = 5e-4
"""Largest overlap of shapes that is not a contact [m]."""


def exclude_neighbors(
    spec: mujoco.MjSpec,
    foreign: ForeignModel,
    structure: HandStructure,
    shapes: HandShapes,
) -> None:
    """Exclude collisions between neighbors, links of one finger, and links that usually touch."""

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
        # Up to its first link, a finger's bodies are at one place and all neighbors of the palm.
        for body in chain.bodies:
            pairs.add(_pair(palm, name(body)))
            if body == chain.links[0]:
                break
    always, inner = [], []
    last = {name(chain.bodies[-1]) for chain in structure.fingers.values()}
    model = spec.copy().compile()
    poses = zero_and_random_poses(model)
    for contact in self_contacts(model, poses[:1], TOUCH):
        always.append(_pair(contact.first, contact.second))
    for contact in self_contacts(model, poses[1:], TOUCH):
        pair = _pair(contact.first, contact.second)
        if contact.share > ALWAYS:
            always.append(pair)
        elif palm in pair and contact.share > OFTEN and not last & set(pair):
            inner.append(pair)
    for text, found in (
        ("always touch, or touch at zero", always),
        ("touch in many poses because the shapes are coarser than the links", inner),
    ):
        extra = sorted(set(found) - pairs)
        pairs |= set(extra)
        if extra:
            shown = [f"{first} and {second}" for first, second in extra]
            foreign.findings.append(note(f"no collisions between links that {text}: {listed(shown)}"))
    for first, second in sorted(pairs):
        spec.add_exclude(bodyname1=first, bodyname2=second)


def _pair(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first < second else (second, first)
