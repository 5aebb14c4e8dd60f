"""Points that follow from a foreign model's shapes and frames: surfaces, far ends, joints."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands.adding.finger_chains import FLEXING, Chain
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.poses import Poses
from fungrasp.hands.adding.shape_fitting import mesh_points, primitive_mesh
from fungrasp.hands.checking.kinematic_tree import subtree

NEARLY_NOTHING = 0.006
"""Links shorter than this get no made-up shape [m]."""


def far_ends(foreign: ForeignModel) -> dict[int, np.ndarray]:
    """By moving body: the end farthest from its joint of the shapes and frames that move with it, its own
    frame [m]; for a bare last link, a point as far ahead as the link before it is long."""
    model = foreign.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ends = {}
    for body in np.flatnonzero(model.body_jntnum > 0).tolist():
        group = members(model, body)
        anchor, turn = data.xanchor[model.body_jntadr[body]], data.xmat[body].reshape(3, 3)
        points = [data.xpos[c][None] for c in group[1:]]
        points += [data.site_xpos[np.isin(model.site_bodyid, group)]]
        for member in group:
            local = surface_points(foreign, member)
            points.append(data.xpos[member] + local @ data.xmat[member].reshape(3, 3).T)
        cloud = np.concatenate([p.reshape(-1, 3) for p in points])
        before = _anchor_before(model, data, body)
        if not len(cloud) or np.linalg.norm(cloud - anchor, axis=1).max() < NEARLY_NOTHING:
            cloud = (2 * anchor - before)[None]
        # Of two ends equally far from the joint, the one away from the link before is the tip.
        reach = np.linalg.norm(cloud - anchor, axis=1) + np.linalg.norm(cloud - before, axis=1)
        far = cloud[np.argmax(reach)]
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
