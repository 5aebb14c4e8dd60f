"""Chains of bodies that are fingers, where their links end, and grippers, which have none."""

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
"""Joints nearer to each other than this make one joint, of several axes or rolling; share of the finger."""

FLEXING = 0.8
"""Cosine of the angle to a finger's last axis within which a joint bends the finger."""


@dataclass(frozen=True)
class Chain:
    """One finger: bodies in order from the palm."""

    bodies: tuple[int, ...]
    """Every moving body of the finger, base to tip."""
    links: tuple[int, ...]
    """At most three, whose joints lie apart."""


def find_chains(
    model: mujoco.MjModel,
    poses: Poses,
    palm: int,
    tips: Mapping[int, np.ndarray],
    ties: Sequence[tuple[int, int]] = (),
) -> list[Chain]:
    """The fingers on a palm.

    Args:
        tips: by moving body: its far end, its own frame [m].
        ties: pairs of bodies that close loops; of two branches that one ties, the shorter is a part of the
            other's mechanism.

    Raises:
        FungraspError: there are fewer than two.
    """
    below = [b for b in subtree(model, palm) if b != palm and model.body_jntnum[b] > 0]
    ends = branch_ends(model, set(below))
    chains = [[b for b in reversed(ancestors(model, end)) if b in below] for end in ends]
    # Bodies without shape or mass carry joints that only drive others.
    solid = [chain for chain in chains if any(not _is_bare(model, body) for body in chain)]
    chains = solid or chains
    # A side branch shorter than half of the finger it hangs on is a part of its mechanism.
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
            f"only {len(result)} finger is found on '{body_name(model, palm)}'; a hand needs a thumb and one "
            "more: name the palm with --palm BODY"
        )
    return result


def _is_bare(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body and what is fixed to it have neither shapes nor mass."""
    group = np.array(members(model, body))
    return not model.body_geomnum[group].any() and bool((model.body_mass[group] < 1e-6).all())


def _links(
    model: mujoco.MjModel, poses: Poses, chain: list[int], tips: Mapping[int, np.ndarray]
) -> tuple[int, ...]:
    """The last three bodies whose joints lie apart; those that bend the finger come before those that spread
    or turn it."""
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
"""A finger whose joints turn by more on average until it is straight was folded at its base too [rad]."""


def straight_fingers(poses: Poses, chains: list[Chain], tips: Mapping[int, np.ndarray]) -> np.ndarray:
    """Independent joints with every finger as long as it gets; those that don't lengthen it stay, but unfold
    with the others where the file's pose is a fist."""
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
                    # Small bends hardly shorten a finger: the pose at zero is preferred to those.
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
    """Joints of a finger, base to tip."""
    return [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in chain.bodies]


def flexing_joints(poses: Poses, chain: Chain) -> list[int]:
    """Joints parallel to the finger's last one."""
    joints = chain_joints(poses.model, chain)
    return [j for j in joints if abs(poses.axis(j) @ poses.axis(joints[-1])) > FLEXING]


NEARLY_NOTHING = 0.006
"""Links shorter than this get no made-up shape [m]."""


RIM = 1e-3
"""Points that are hardly less far than the farthest belong to the same end [m]."""


def far_ends(foreign: ForeignModel) -> dict[int, np.ndarray]:
    """By moving body: the end farthest from its joint of the shapes that move with it, of its frames where it
    has no shapes, its own frame [m]; for a bare last link, a point as far ahead as the link before is long.

    Frames of sensors and cameras stand beside or ahead of a finger; those called tip count too."""
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
        # Of two ends equally far from the joint, the one away from the link before is the tip.
        reach = np.linalg.norm(cloud - anchor, axis=1) + np.linalg.norm(cloud - before, axis=1)
        # The middle of a flat end, and not a place on its rim.
        far = cloud[reach > reach.max() - RIM].mean(axis=0)
        ends[body] = turn.T @ (far - data.xpos[body])
    return ends


def members(model: mujoco.MjModel, body: int, palm: int = -1) -> tuple[int, ...]:
    """The body and all that are fixed to it; for the palm also what it is fixed to, but no moving link."""
    weld = model.body_weldid
    if body == palm:
        group = np.flatnonzero((weld == weld[body]) & (model.body_jntnum == 0))
        return (body, *(int(c) for c in group if c not in (0, body)))
    return (body, *(c for c in subtree(model, body) if c != body and weld[c] == weld[body]))


def first_anchor(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Where the first joint of a moving body lies, its own frame [m], shape [3]."""
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


def surface_points(foreign: ForeignModel, body: int, visual: bool = True) -> np.ndarray:
    """Points of a body's shapes [m], shape [P, 3], its own frame: those that collide if there are any."""
    model = foreign.model
    meshes = foreign.meshes.get(body, [])
    clouds = [mesh_points(m.vertices, m.faces) for m in meshes if m.collides]
    clouds += [mesh_points(*primitive_mesh(model, geom)) for geom in primitives(model, body)]
    if not clouds and visual:
        clouds = [mesh_points(m.vertices, m.faces) for m in meshes]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))


def primitives(model: mujoco.MjModel, body: int) -> list[int]:
    """Ids of the geoms of a body that collide and are no meshes."""
    return [
        g
        for g in np.flatnonzero(model.geom_bodyid == body).tolist()
        if model.geom_contype[g] or model.geom_conaffinity[g]
    ]


def midline(poses: Poses, chain: Chain, body: int, tip: np.ndarray) -> np.ndarray:
    """The point on the axis of a body's joint that lies in the middle of the finger, palm frame [m]."""
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
"""Cosine of the angle between axes that are parallel."""


def refuse_sliding_or_one_motor(model: mujoco.MjModel, palm: int, couplings: Container[int]) -> None:
    """Refuse what slides or moves as one.

    Raises:
        FungraspError: a joint below the palm slides, or one motor moves them all.
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
    """Refuse two fingers that move in one plane, and several that one or two motors move in planes that are
    parallel.

    Raises:
        FungraspError: they do.
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
    """Joints that an actuator moves, by itself or over a tendon; of a tendon in space, those between the
    bodies that it touches."""
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
