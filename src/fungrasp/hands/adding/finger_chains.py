"""Find the kinematic chains of fingers and their tips; reject grippers."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.model_repairs import branch_ends
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.shape_fitting import mesh_points, primitive_mesh
from fungrasp.hands.findings import listed
from fungrasp.hands.kinematic_tree import ancestors, body_name, joint_name, subtree

SAME_PLACE = 0.13
"""Joints nearer than this share of the finger's length form one joint, with several axes or rolling."""

FLEXING = 0.8
"""Smallest cosine between the axes of a flexing joint and of the finger's last joint."""


@dataclass(frozen=True)
class Chain:
    """Body ids of one finger, base to tip."""

    bodies: tuple[int, ...]
    """All moving bodies."""
    links: tuple[int, ...]
    """Up to three bodies whose joints are apart."""


def find_chains(
    model: mujoco.MjModel,
    poses: Poses,
    palm: int,
    tips: Mapping[int, np.ndarray],
    ties: Sequence[tuple[int, int]] = (),
) -> list[Chain]:
    """Return the fingers on a palm.

    Args:
        tips: far end of each moving body, by body id, body frame [m], shape [3].
        ties: pairs of bodies that close loops. The shorter of two tied branches is a rod of the other.

    Raises:
        FungraspError: there are fewer than two fingers.
    """
    below = [b for b in subtree(model, palm) if b != palm and model.body_jntnum[b] > 0]
    ends = branch_ends(model, set(below))
    chains = [[b for b in reversed(ancestors(model, end)) if b in below] for end in ends]
    # Joints of bodies without shape and mass only drive other joints.
    solid = [chain for chain in chains if any(not _is_bare(model, body) for body in chain)]
    chains = solid or chains
    # A side branch of one body on a longer finger is a part of the finger's mechanism.
    kept = []
    for chain in chains:
        rivals = [other for other in chains if other is not chain and other[0] == chain[0]]
        shared = max((sum(a == b for a, b in zip(chain, o, strict=False)) for o in rivals), default=0)
        own = len(chain) - shared
        longest = max((len(o) - shared for o in rivals), default=0)
        if shared == 0 or own >= 2 or longest < 2:
            kept.append(chain)

    def reach(chain: list[int]) -> float:
        return float(np.linalg.norm(poses.of_body(chain[-1], tips[chain[-1]]) - poses.anchor(chain[0])))

    rods = []
    for pair in ties:
        ends = [
            [c for c in kept if set(ancestors(model, body)) & set(c) and c[0] in ancestors(model, body)]
            for body in pair
        ]
        rods += [min(one, other, key=reach) for one in ends[0] for other in ends[1] if one[0] != other[0]]
    kept = [chain for chain in kept if chain not in rods]
    result = [Chain(tuple(chain), _links(model, poses, chain, tips)) for chain in kept]
    if len(result) < 2:
        raise FungraspError(
            f"{'only one' if result else 'no'} finger was found on '{body_name(model, palm)}'; a hand needs "
            "a thumb and one more: name the palm with --palm BODY"
        )
    return result


def _is_bare(model: mujoco.MjModel, body: int) -> bool:
    """Return whether a body and the bodies fixed to it have neither shapes nor mass."""
    group = np.array(members(model, body))
    return not model.body_geomnum[group].any() and bool((model.body_mass[group] < 1e-6).all())


def _links(
    model: mujoco.MjModel, poses: Poses, chain: list[int], tips: Mapping[int, np.ndarray]
) -> tuple[int, ...]:
    """Return the last three bodies whose joints are apart: flexing ones only, if there are three of them."""
    bend = poses.axis(int(model.body_jntadr[chain[-1]] + model.body_jntnum[chain[-1]] - 1))

    def joint(body: int) -> tuple[bool, int]:
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        flexing = [j for j in joints if abs(poses.axis(j) @ bend) > FLEXING]
        return bool(flexing), flexing[0] if flexing else joints[0]

    def gaps(bodies: list[int]) -> list[float]:
        spots = [poses.points(poses.data.xanchor[joint(b)[1]]) for b in bodies]
        spots.append(poses.of_body(chain[-1], tips[chain[-1]]))
        return [float(np.linalg.norm(far - near)) for near, far in pairwise(spots)]

    length = sum(gaps(chain))

    def apart(bodies: list[int]) -> list[int]:
        far = [gap > SAME_PLACE * length for gap in gaps(bodies)[:-1]]
        return [body for body, kept in zip(bodies, [*far, True], strict=True) if kept]

    flexing = apart([body for body in chain if joint(body)[0]])
    return tuple((flexing if len(flexing) >= 3 else apart(chain))[-3:])


FOLDED = 0.8
"""A finger whose joints turn by more on average until it is straight is also folded at its base [rad]."""


def straight_fingers(poses: Poses, chains: list[Chain], tips: Mapping[int, np.ndarray]) -> np.ndarray:
    """Return independent joints at which every finger is longest [rad], shape [U]. Joints that do not
    lengthen a finger stay, but unfold with the others if the file's pose is a fist."""
    start, best = poses.start, poses.start.copy()
    for chain in chains:
        poses.set(start)
        moved = np.flatnonzero(np.abs(poses.matrix[flexing_joints(poses, chain)]).sum(axis=0))
        for _ in range(3):
            for u in moved[::-1]:
                options = np.unique(np.append(np.linspace(poses.low[u], poses.high[u], 13), start[u]))
                reaches = []
                for value in options:
                    trial = best.copy()
                    trial[u] = value
                    poses.set(trial)
                    tip = poses.of_body(chain.bodies[-1], tips[chain.bodies[-1]])
                    # Small bends hardly change the length: the file's pose is preferred to them.
                    reaches.append(
                        np.linalg.norm(tip - poses.anchor(chain.links[0])) - 2e-3 * abs(value - start[u])
                    )
                best[u] = options[int(np.argmax(reaches))]
        flexing = flexing_joints(poses, chain)
        last = poses.axis(flexing[-1])
        signs = np.sign([[poses.axis(j) @ last] for j in flexing] * poses.matrix[flexing]).sum(axis=0)
        turns = ((best - start) * np.sign(signs))[moved]
        unfolded = float(turns[turns != 0].mean()) if turns.any() else 0.0
        if abs(unfolded) > FOLDED:
            still = moved[turns == 0]
            best[still] += unfolded * np.sign(signs[still])
    return np.clip(best, poses.low, poses.high)


def chain_joints(model: mujoco.MjModel, chain: Chain) -> list[int]:
    """Return the joints of a finger, base to tip."""
    return [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in chain.bodies]


def flexing_joints(poses: Poses, chain: Chain) -> list[int]:
    """Return the joints nearly parallel to the finger's last joint."""
    joints = chain_joints(poses.model, chain)
    return [j for j in joints if abs(poses.axis(j) @ poses.axis(joints[-1])) > FLEXING]


NEARLY_NOTHING = 0.006
"""Links shorter than this get no default shape [m]."""

RIM = 1e-3
"""Points whose distance differs by less from the farthest belong to the same end [m]."""


def far_ends(foreign: ForeignModel) -> dict[int, np.ndarray]:
    """Return the far end of each moving body, by body id, body frame [m], shape [3]: the point farthest from
    its joint. It is taken from its shapes; else from its sites and fixed bodies, which may be sensors beside
    the finger; else it lies ahead by the length of the link before."""
    model = foreign.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = {}
    for body in np.flatnonzero(model.body_jntnum > 0).tolist():
        group = members(model, body)
        anchor, turn = data.xanchor[model.body_jntadr[body]], data.xmat[body].reshape(3, 3)
        surface = [
            data.xpos[member] + surface_points(foreign, member) @ data.xmat[member].reshape(3, 3).T
            for member in group
        ]
        frames = [data.xpos[c][None] for c in group[1:]]
        frames += [data.site_xpos[np.isin(model.site_bodyid, group)]]
        cloud = np.concatenate([p.reshape(-1, 3) for p in surface])
        if not len(cloud) or np.linalg.norm(cloud - anchor, axis=1).max() < NEARLY_NOTHING:
            cloud = np.concatenate([p.reshape(-1, 3) for p in frames])
        before = _anchor_before(model, data, body)
        if not len(cloud) or np.linalg.norm(cloud - anchor, axis=1).max() < NEARLY_NOTHING:
            cloud = (2 * anchor - before)[None]
        # Of two ends equally far from the joint, the tip is the one farther from the link before.
        reach = np.linalg.norm(cloud - anchor, axis=1) + np.linalg.norm(cloud - before, axis=1)
        # The mean gives the middle of a flat end, not a point on its rim.
        far = cloud[reach > reach.max() - RIM].mean(axis=0)
        ends[body] = turn.T @ (far - data.xpos[body])
    return ends


def members(model: mujoco.MjModel, body: int, palm: int = -1) -> tuple[int, ...]:
    """Return the body and those fixed to it: below it, and for the palm also elsewhere."""
    weld = model.body_weldid
    if body == palm:
        group = np.flatnonzero((weld == weld[body]) & (model.body_jntnum == 0))
        return (body, *(int(c) for c in group if c not in (0, body)))
    return (body, *(c for c in subtree(model, body) if c != body and weld[c] == weld[body]))


def first_anchor(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the anchor of a moving body's first joint, body frame [m], shape [3]."""
    return model.jnt_pos[model.body_jntadr[body]]


def _anchor_before(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> np.ndarray:
    here = data.xanchor[model.body_jntadr[body]]
    above = int(model.body_parentid[body])
    while above:
        place = data.xanchor[model.body_jntadr[above]] if model.body_jntnum[above] else data.xpos[above]
        if np.linalg.norm(place - here) > 2 * NEARLY_NOTHING:
            return place
        above = int(model.body_parentid[above])
    return here - np.array([0.0, 0.0, 0.03])


def surface_points(foreign: ForeignModel, body: int) -> np.ndarray:
    """Return points on a body's collision shapes, on visual meshes if there are none, body frame [m], shape
    [P, 3]."""
    model = foreign.model
    meshes = foreign.meshes.get(body, [])
    clouds = [mesh_points(m.vertices, m.faces) for m in meshes if m.collides]
    clouds += [mesh_points(*primitive_mesh(model, geom)) for geom in primitives(model, body)]
    if not clouds:
        clouds = [mesh_points(m.vertices, m.faces) for m in meshes]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))


def primitives(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of a body's primitive collision geoms."""
    return [
        g
        for g in np.flatnonzero(model.geom_bodyid == body).tolist()
        if model.geom_contype[g] or model.geom_conaffinity[g]
    ]


def midline(poses: Poses, chain: Chain, body: int, tip: np.ndarray) -> np.ndarray:
    """Return the point on the axis of a body's flexing joint nearest to the finger's tip, palm frame [m],
    shape [3]; the anchor if no joint flexes. tip: frame of the last body [m], shape [3]."""
    model = poses.model
    last = int(model.body_jntadr[chain.bodies[-1]])
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    bending = [j for j in joints if abs(poses.axis(j) @ poses.axis(last)) > FLEXING]
    joint = bending[0] if bending else joints[0]
    anchor, axis = poses.points(poses.data.xanchor[joint]), poses.axis(joint)
    if not bending:
        return anchor
    goal = poses.of_body(chain.bodies[-1], tip)
    return anchor + ((goal - anchor) @ axis) * axis


PARALLEL = 0.95
"""Smallest cosine between parallel axes."""


def refuse_sliding_or_one_motor(model: mujoco.MjModel, palm: int, couplings: Container[int]) -> None:
    """Reject grippers with slides or a single motor.

    Raises:
        FungraspError: a joint below the palm slides, or there is one motor or one independent joint.
    """
    below = set(subtree(model, palm)) - {palm}
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in below]
    slides = [joint_name(model, j) for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE]
    if slides:
        raise FungraspError(
            f"the joint {listed(slides)} slides, as in a gripper; fingers of a hand need hinges"
        )
    motors = {a for a in range(model.nu) if set(driven_joints(model, a)) & set(joints)}
    free = [joint for joint in joints if joint not in couplings]
    if len(motors) == 1 or len(free) == 1:
        raise FungraspError(
            f"'{body_name(model, palm)}' carries a gripper: one motor moves its {len(joints)} joints; a hand "
            "needs a thumb and fingers that move by themselves"
        )


def refuse_jaws(poses: Poses, chains: list[Chain]) -> None:
    """Reject grippers with parallel joints.

    Raises:
        FungraspError: all joints are parallel, and there are two fingers or at most two independent joints.
    """
    joints = [j for chain in chains for j in chain_joints(poses.model, chain)]
    motors = int(np.any(poses.matrix[joints], axis=0).sum())
    axes = np.array([poses.axis(j) for j in joints])
    if np.abs(axes @ axes[0]).min() > PARALLEL and (len(chains) == 2 or motors <= 2):
        raise FungraspError(
            f"'{body_name(poses.model, poses.palm)}' carries a gripper: its {len(joints)} joints are all "
            "parallel; a hand needs a thumb that moves across the fingers"
        )


def driven_joints(model: mujoco.MjModel, actuator: int) -> list[int]:
    """Return the joints that an actuator moves, directly or by a tendon. A spatial tendon moves all joints
    between the bodies of its sites."""
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_TENDON:
        return [target]
    span = slice(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
    kinds, objects = model.wrap_type[span], model.wrap_objid[span]
    sites = objects[kinds == mujoco.mjtWrap.mjWRAP_SITE]
    if not len(sites):
        return objects[kinds == mujoco.mjtWrap.mjWRAP_JOINT].tolist()
    paths = [set(ancestors(model, int(model.site_bodyid[site]))) for site in sites]
    between = set.union(*paths) - set.intersection(*paths)
    return [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in between]
