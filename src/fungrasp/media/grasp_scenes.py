"""Models of a grasp to be rendered: a human or a robot hand and an object, links in contact colored."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.grasps import HumanGrasp, RobotGrasp
from fungrasp.hands import Hand
from fungrasp.media.hand_mesh import human_hand_mesh
from fungrasp.media.materials import painted_parts
from fungrasp.media.surfaces import model_materials
from fungrasp.media.visual_meshes import dressed_spec
from fungrasp.objects import ObjectModel

SKIN = (0.86, 0.68, 0.57)
"""Color of a human hand, sRGB."""

CONTACT = (0.95, 0.49, 0.16)
"""Color of links in contact, sRGB."""

OBJECT_BODY = "object"
"""Name of the object's body in the scenes made here."""

HAND_BODY = "hand"
"""Name of the body that carries the hand in the scenes made here."""

PALM_TINT = 0.75
"""How much of ``CONTACT`` goes into the color of a robot's palm in contact: it is large."""

_PALETTE = 64
_PREFIX = "robot/"


def human_grasp_scene(
    joints: np.ndarray, thing: ObjectModel, object_pose: np.ndarray, link_contacts: np.ndarray
) -> mujoco.MjModel:
    """A human hand, its links in contact colored, holding an object. The model has no joints.

    Args:
        joints: [m], world frame, shape [21, 3].
        thing: the object.
        object_pose: world frame, shape [7].
        link_contacts: shape [16] bool.

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    contacts = _flags(link_contacts, 16)
    pose = _finite("object_pose", object_pose, (7,))
    hand = human_hand_mesh(joints)
    spec = mujoco.MjSpec()
    ramp = np.linspace(0.0, 1.0, _PALETTE)[:, None]
    palette = np.asarray(SKIN) + ramp * (np.asarray(CONTACT) - np.asarray(SKIN))
    texture = spec.add_texture(
        name="skin", type=mujoco.mjtTexture.mjTEXTURE_2D, width=_PALETTE, height=1, nchannel=3
    )
    texture.data = np.round(255 * palette).astype(np.uint8).tobytes()
    material = spec.add_material(name="skin", rgba=[1, 1, 1, 1], specular=0.25, shininess=0.15)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "skin"
    local = inverse_transform_points(pose, hand.vertices)
    apart = SignedDistanceBank([thing.signed_distance]).query(np.zeros(1, dtype=int), local[None])[0][0]
    near = np.clip((0.030 - np.abs(apart)) / 0.020, 0.0, 1.0)
    touching = hand.links @ contacts.astype(float)
    touching -= hand.links[:, 0] * contacts[0] * (1.0 - near)
    place = (0.5 + touching * (_PALETTE - 1)) / _PALETTE
    mesh = _add_mesh(spec, HAND_BODY, hand.vertices, hand.faces)
    mesh.usertexcoord = np.stack([place, np.full_like(place, 0.5)], axis=-1).ravel()
    body = spec.worldbody.add_body(name=HAND_BODY)
    _add_mesh_geom(body, HAND_BODY, [1, 1, 1, 1]).material = "skin"
    held = add_object(spec, thing)
    held.pos, held.quat = pose[:3], pose[3:]
    return _compiled(spec)


def robot_grasp_scene(
    hand: Hand,
    wrist_pose: np.ndarray,
    joint_positions: np.ndarray,
    thing: ObjectModel,
    object_pose: np.ndarray,
    link_contacts: np.ndarray | None = None,
) -> tuple[mujoco.MjModel, np.ndarray]:
    """A robot hand, its links in contact colored, holding an object. Hand and object can move freely.

    Args:
        wrist_pose: of the palm body, world frame, shape [7].
        joint_positions: in the order of ``hand.joint_names`` [rad], shape [M].
        thing: the object.
        object_pose: world frame, shape [7].
        link_contacts: in the order of ``hand.links``, shape [L] bool; None for none.

    Returns:
        the model, and its qpos, shape [nq].

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=HAND_BODY, mass=0.1, inertia=[1e-4, 1e-4, 1e-4])
    body.explicitinertial = True
    body.add_freejoint(name=HAND_BODY)
    spec.attach(dressed_spec(hand), prefix=_PREFIX, frame=body.add_frame())
    add_object(spec, thing).add_freejoint(name=OBJECT_BODY)
    model = _compiled(spec)
    if link_contacts is not None:
        colors = robot_scene_colors(model, hand, np.asarray(link_contacts)[None])[0]
        tinted = np.any(colors != model_materials(model).colors, axis=1)
        model.geom_rgba[tinted], model.geom_matid[tinted] = colors[tinted], -1
    pose, positions = np.asarray(wrist_pose, dtype=float), np.asarray(joint_positions, dtype=float)
    states = robot_scene_states(
        model, hand, pose[None], positions[None], np.asarray(object_pose, float)[None]
    )
    return model, states[0]


def grasp_scene(
    grasp: HumanGrasp | RobotGrasp, thing: ObjectModel, hand: Hand | None = None
) -> tuple[mujoco.MjModel, np.ndarray]:
    """The scene of a grasp as it is, and its qpos, shape [nq].

    Args:
        grasp: of a person or a robot.
        thing: its object.
        hand: that of a robot's grasp.
    """
    if isinstance(grasp, HumanGrasp):
        model = human_grasp_scene(grasp.hand_joints, thing, grasp.object_pose, grasp.link_contacts)
        return model, model.qpos0
    assert hand is not None
    return robot_grasp_scene(
        hand, grasp.wrist_pose, grasp.joint_positions, thing, grasp.object_pose, grasp.link_contacts
    )


def robot_scene_states(
    model: mujoco.MjModel,
    hand: Hand,
    wrist_poses: np.ndarray,
    joint_positions: np.ndarray,
    object_poses: np.ndarray,
) -> np.ndarray:
    """The qpos of a ``robot_grasp_scene`` along a motion, for a film.

    Args:
        model: made by ``robot_grasp_scene`` for the same hand.
        wrist_poses: of the palm body, world frame, shape [T, 7].
        joint_positions: in the order of ``hand.joint_names`` [rad], shape [T, M].
        object_poses: world frame, shape [T, 7].

    Returns:
        shape [T, nq].

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    count = len(wrist_poses)
    wrist = _finite("wrist_pose", wrist_poses, (count, 7))
    joints = _finite("joint_positions", joint_positions, (count, len(hand.joint_names)))
    things = _finite("object_pose", object_poses, (count, 7))
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.palm)
    states = np.tile(model.qpos0, (count, 1))

    def put(joint: str, values: np.ndarray) -> None:
        start = int(model.joint(joint).qposadr[0])
        states[:, start : start + values.shape[1]] = values

    put(HAND_BODY, compose(wrist, invert(np.concatenate([palm.xpos, palm.xquat]))))
    put(OBJECT_BODY, things)
    for i, name in enumerate(hand.joint_names):
        put(_PREFIX + name, joints[:, i : i + 1])
    return states


def robot_scene_colors(model: mujoco.MjModel, hand: Hand, link_contacts: np.ndarray) -> np.ndarray:
    """Colors of a ``robot_grasp_scene`` whose links light up while they touch, for a film.

    Args:
        model: made by ``robot_grasp_scene`` for the same hand, without contacts.
        link_contacts: in the order of ``hand.links``, shape [T, L] bool.

    Returns:
        sRGB and opacity, shape [T, ngeom, 4].

    Raises:
        FungraspError: ``link_contacts`` has the wrong shape.
    """
    contacts = np.asarray(link_contacts)
    if contacts.ndim != 2 or contacts.shape[1] != len(hand.links):
        raise FungraspError(f"link_contacts must have shape [T, {len(hand.links)}], not {contacts.shape}")
    colors = np.tile(model_materials(model).colors, (len(contacts), 1, 1))
    owner = {_PREFIX + body: k for k, bodies in enumerate(hand.links) for body in bodies}
    for geom in range(model.ngeom):
        link = owner.get(model.body(int(model.geom_bodyid[geom])).name)
        if link is not None:
            tint = contacts[:, link, None] * (PALM_TINT if link == 0 else 1.0)
            colors[:, geom, :3] += tint * (np.asarray(CONTACT) - colors[:, geom, :3])
    return colors


def add_object(spec: mujoco.MjSpec, thing: ObjectModel) -> mujoco.MjsBody:
    """Add a body ``OBJECT_BODY`` that looks like an object; for the eye alone."""
    body = spec.worldbody.add_body(name=OBJECT_BODY)
    for number, (look, mask) in enumerate(painted_parts(thing)):
        name = f"{OBJECT_BODY}{number or ''}"
        material = spec.add_material(name=name, rgba=[*look.color, 1.0])
        material.specular, material.shininess = look.specular, look.shininess
        used, faces = np.unique(thing.faces[mask], return_inverse=True)
        _add_mesh(spec, name, thing.vertices[used], faces.reshape(-1, 3))
        _add_mesh_geom(body, name, [0.5, 0.5, 0.5, 1.0]).material = name
    return body


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise FungraspError(f"the scene can't be drawn: {' '.join(str(error).split())}") from error


def _add_mesh(spec: mujoco.MjSpec, name: str, vertices: np.ndarray, faces: np.ndarray) -> mujoco.MjsMesh:
    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.ascontiguousarray(vertices, dtype=float).ravel()
    mesh.userface = np.ascontiguousarray(faces, dtype=np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return mesh


def _add_mesh_geom(body: mujoco.MjsBody, mesh: str, rgba: Sequence[float]) -> mujoco.MjsGeom:
    return body.add_geom(
        name=mesh, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, rgba=rgba, contype=0, conaffinity=0
    )


def _flags(values: np.ndarray, count: int) -> np.ndarray:
    flags = np.asarray(values)
    if flags.shape != (count,):
        raise FungraspError(f"link_contacts must have shape ({count},), not {flags.shape}")
    return flags.astype(bool)


def _finite(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(values, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise FungraspError(f"{name} must be finite and of shape {shape}, not of shape {array.shape}")
    return array
