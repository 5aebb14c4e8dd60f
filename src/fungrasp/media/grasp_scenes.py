"""Scenes of grasps for rendering, with colored links in contact, and cameras for them."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.grasps import HumanGrasp, RobotGrasp
from fungrasp.hands import Hand
from fungrasp.media.camera import Camera, fit_camera
from fungrasp.media.hand_mesh import human_hand_mesh
from fungrasp.media.materials import painted_parts
from fungrasp.media.render import Renderer, Views
from fungrasp.media.surfaces import VISIBLE_GROUPS, model_materials
from fungrasp.media.visual_meshes import dressed_spec
from fungrasp.objects import ObjectModel
from fungrasp.optimization.link_contacts import LinkDistances

SKIN = (0.86, 0.68, 0.57)
"""Color of a human hand, sRGB."""

CONTACT = (0.95, 0.49, 0.16)
"""Color of links in contact, sRGB."""

MISSED = (0.85, 0.25, 0.45)
"""Color of links that should touch and do not, sRGB."""

UNWANTED = (0.95, 0.80, 0.25)
"""Color of links that touch and should not, sRGB."""

OBJECT_BODY = "object"
"""Name of the object's body in these scenes."""

HAND_BODY = "hand"
"""Name of the hand's body in these scenes."""

PALM_TINT = 0.75
"""Share of ``CONTACT`` in the color of a robot's palm in contact, which is large."""

FRAMED = 0.6
"""Largest radius of geoms that a camera frames [m]; larger ones are surroundings."""

BEST_ELEVATION = 26.0
"""Preferred camera elevation, that of a person looking at a table [degrees]."""

_PALETTE = 64
_PREFIX = "robot/"


def human_grasp_scene(
    joints: np.ndarray, obj: ObjectModel, object_pose: np.ndarray, link_contacts: np.ndarray
) -> mujoco.MjModel:
    """Create the model of a human hand with colored links in contact and an object, without joints.

    Args:
        joints: [m], world frame, shape [21, 3].
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
    apart = SignedDistanceBank([obj.signed_distance]).query(np.zeros(1, dtype=int), local[None])[0][0]
    near = np.clip((0.030 - np.abs(apart)) / 0.020, 0.0, 1.0)
    touching = hand.links @ contacts.astype(float)
    touching -= hand.links[:, 0] * contacts[0] * (1.0 - near)
    place = (0.5 + touching * (_PALETTE - 1)) / _PALETTE
    mesh = _add_mesh(spec, HAND_BODY, hand.vertices, hand.faces)
    mesh.usertexcoord = np.stack([place, np.full_like(place, 0.5)], axis=-1).ravel()
    body = spec.worldbody.add_body(name=HAND_BODY)
    _add_mesh_geom(body, HAND_BODY, [1, 1, 1, 1]).material = "skin"
    held = add_object(spec, obj)
    held.pos, held.quat = pose[:3], pose[3:]
    return _compiled(spec)


def robot_grasp_scene(
    hand: Hand,
    wrist_pose: np.ndarray,
    joint_positions: np.ndarray,
    obj: ObjectModel,
    object_pose: np.ndarray,
    link_contacts: np.ndarray | None = None,
    wanted: np.ndarray | None = None,
) -> tuple[mujoco.MjModel, np.ndarray]:
    """Create the model of a robot hand with colored links in contact and an object, both with free joints.

    Args:
        wrist_pose: pose of the palm body, world frame, shape [7].
        joint_positions: in the order of ``hand.joint_names`` [rad], shape [M].
        object_pose: world frame, shape [7].
        link_contacts: in the order of ``hand.links``, shape [L] bool; none if None.
        wanted: links that should touch, shape [L] bool; as ``link_contacts`` if None.

    Returns:
        the model and its qpos, shape [nq].

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=HAND_BODY, mass=0.1, inertia=[1e-4, 1e-4, 1e-4])
    body.explicitinertial = True
    body.add_freejoint(name=HAND_BODY)
    spec.attach(dressed_spec(hand), prefix=_PREFIX, frame=body.add_frame())
    add_object(spec, obj).add_freejoint(name=OBJECT_BODY)
    model = _compiled(spec)
    if link_contacts is not None:
        colors = robot_scene_colors(model, hand, np.asarray(link_contacts)[None], wanted)[0]
        tinted = np.any(colors != model_materials(model).colors, axis=1)
        model.geom_rgba[tinted], model.geom_matid[tinted] = colors[tinted], -1
    pose, positions = np.asarray(wrist_pose, dtype=float), np.asarray(joint_positions, dtype=float)
    states = robot_scene_states(
        model, hand, pose[None], positions[None], np.asarray(object_pose, float)[None]
    )
    return model, states[0]


def grasp_scene(
    grasp: HumanGrasp | RobotGrasp, obj: ObjectModel, hand: Hand | None = None
) -> tuple[mujoco.MjModel, np.ndarray]:
    """Return the scene of a grasp and its qpos, shape [nq]. Links of a human hand in contact are ``CONTACT``;
    of a robot hand, those that should touch are ``CONTACT`` or ``MISSED``, others that touch ``UNWANTED``.

    Args:
        hand: required for a robot grasp.
    """
    if isinstance(grasp, HumanGrasp):
        model = human_grasp_scene(grasp.hand_joints, obj, grasp.object_pose, grasp.link_contacts)
        return model, model.qpos0
    assert hand is not None
    touch = LinkDistances(hand, obj).of(grasp.wrist_pose, grasp.joint_positions, grasp.object_pose)
    return robot_grasp_scene(
        hand,
        grasp.wrist_pose,
        grasp.joint_positions,
        obj,
        grasp.object_pose,
        touch.reached,
        grasp.link_contacts,
    )


def robot_scene_states(
    model: mujoco.MjModel,
    hand: Hand,
    wrist_poses: np.ndarray,
    joint_positions: np.ndarray,
    object_poses: np.ndarray,
) -> np.ndarray:
    """Return the qpos of a ``robot_grasp_scene`` along a motion.

    Args:
        model: result of ``robot_grasp_scene`` for the same hand.
        wrist_poses: poses of the palm body, world frame, shape [T, 7].
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
    object_poses = _finite("object_pose", object_poses, (count, 7))
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.palm)
    states = np.tile(model.qpos0, (count, 1))

    def put(joint: str, values: np.ndarray) -> None:
        start = int(model.joint(joint).qposadr[0])
        states[:, start : start + values.shape[1]] = values

    put(HAND_BODY, compose(wrist, invert(np.concatenate([palm.xpos, palm.xquat]))))
    put(OBJECT_BODY, object_poses)
    for i, name in enumerate(hand.joint_names):
        put(_PREFIX + name, joints[:, i : i + 1])
    return states


def robot_scene_colors(
    model: mujoco.MjModel, hand: Hand, link_contacts: np.ndarray, wanted: np.ndarray | None = None
) -> np.ndarray:
    """Return geom colors of a ``robot_grasp_scene`` with highlighted links in contact.

    Args:
        model: result of ``robot_grasp_scene`` for the same hand, without contacts.
        link_contacts: in the order of ``hand.links``, shape [T, L] bool.
        wanted: links that should touch, shape [L] bool; as ``link_contacts`` if None.

    Returns:
        sRGB and opacity, shape [T, ngeom, 4].

    Raises:
        FungraspError: ``link_contacts`` has the wrong shape.
    """
    contacts = np.asarray(link_contacts)
    if contacts.ndim != 2 or contacts.shape[1] != len(hand.links):
        raise FungraspError(f"link_contacts must have shape [T, {len(hand.links)}], not {contacts.shape}")
    colors = np.tile(model_materials(model).colors, (len(contacts), 1, 1))
    asked = contacts if wanted is None else np.broadcast_to(np.asarray(wanted, dtype=bool), contacts.shape)
    touches, asked = contacts[..., None].astype(bool), asked[..., None]
    tints = np.where(touches & asked, CONTACT, np.where(touches, UNWANTED, MISSED))
    shares = (touches | asked) * 1.0
    owner = {_PREFIX + body: k for k, bodies in enumerate(hand.links) for body in bodies}
    for geom in range(model.ngeom):
        link = owner.get(model.body(int(model.geom_bodyid[geom])).name)
        if link is not None:
            share = shares[:, link] * (PALM_TINT if link == 0 else 1.0)
            colors[:, geom, :3] += share * (tints[:, link] - colors[:, geom, :3])
    return colors


def add_object(spec: mujoco.MjSpec, obj: ObjectModel) -> mujoco.MjsBody:
    """Add a body ``OBJECT_BODY`` with the visual geoms of an object."""
    body = spec.worldbody.add_body(name=OBJECT_BODY)
    for number, (look, mask) in enumerate(painted_parts(obj)):
        name = f"{OBJECT_BODY}{number or ''}"
        material = spec.add_material(name=name, rgba=[*look.color, 1.0])
        material.specular, material.shininess = look.specular, look.shininess
        used, faces = np.unique(obj.faces[mask], return_inverse=True)
        _add_mesh(spec, name, obj.vertices[used], faces.reshape(-1, 3))
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


def look_at_grasp(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    width: int = 640,
    height: int = 480,
    margin: float = 1.12,
    elevations: Sequence[float] = (14.0, 30.0, 48.0),
    azimuths: int = 12,
) -> Camera:
    """Return a camera above the table that frames hand and object and shows the contacts well.

    The best of the candidate views maximizes a weighted sum of the visible shares of the colored links, the
    object and each geom of the hand, each relative to the view that shows most of it.

    Args:
        model: result of ``human_grasp_scene`` or ``robot_grasp_scene``, or any model with a body named
            ``OBJECT_BODY``.
        qpos: shape [nq], or [T, nq] for a motion, which is framed as a whole and evaluated at its last state;
            the model's reference if None.
        margin: ratio of the image size to the size of the contents; a caption bar needs about 1.3.
        elevations: elevations of the candidate views [degrees].
        azimuths: number of azimuths of the candidate views.
    """
    states = np.atleast_2d(model.qpos0 if qpos is None else np.asarray(qpos, dtype=float))
    small = (48 * width // max(width, height) + 1, 48 * height // max(width, height) + 1)
    views = [(e, a) for e in elevations for a in np.arange(azimuths) * 360.0 / azimuths]
    corners = _drawn_corners(model, states)
    cameras = [fit_camera(corners, a, e, width=small[0], height=small[1]) for e, a in views]
    renderer = Renderer(model, antialias=1, shadows=False)
    seen = renderer.views(states[-1:].repeat(len(views), 0), cameras)
    of_object = [g for g in range(model.ngeom) if model.body(int(model.geom_bodyid[g])).name == OBJECT_BODY]
    of_hand = np.setdiff1d(np.unique(seen.segmentation[seen.segmentation >= 0]), of_object)
    score = 0.4 * _shares(np.isin(seen.segmentation, of_object))
    score += 0.5 * np.mean([_shares(seen.segmentation == g) for g in of_hand] or [0.0 * score], axis=0)
    score += 0.8 * _shares(_touching(model, seen) & ~np.isin(seen.segmentation, of_object))
    score -= 0.004 * np.abs(np.array([e for e, _ in views]) - BEST_ELEVATION)
    elevation, azimuth = views[int(np.argmax(score))]
    return fit_camera(corners, azimuth, elevation, width=width, height=height, margin=margin)


def frame_geoms(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    azimuth: float,
    elevation: float,
    *,
    width: int = 640,
    height: int = 480,
    margin: float = 1.12,
) -> Camera:
    """Return a camera that tightly frames all visible geoms except planes and very large ones.

    Args:
        qpos: shape [nq], or [T, nq] for a motion, which is framed as a whole.
        azimuth: azimuth of the camera, from the world's x toward y [degrees].
        elevation: elevation above the horizontal [degrees].
        margin: ratio of the image size to the size of the contents.

    Raises:
        FungraspError: there is no geom to frame.
    """
    corners = _drawn_corners(model, qpos)
    return fit_camera(corners, azimuth, elevation, width=width, height=height, margin=margin)


def _drawn_corners(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return the bounding box corners of the framed geoms in a sample of the states [m], shape [P, 3]."""
    chosen = (
        np.isin(model.geom_group, VISIBLE_GROUPS) & (model.geom_rbound > 0) & (model.geom_rbound < FRAMED)
    )
    chosen &= model_materials(model).colors[:, 3] > 0
    if not chosen.any():
        raise FungraspError("there is nothing to look at: the model has no visible geom of a size to frame")
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(8, 3)
    boxes = model.geom_aabb[chosen]
    local = boxes[:, None, :3] + corners * boxes[:, None, 3:]
    states = np.atleast_2d(np.asarray(qpos, dtype=float))
    step = max(1, len(states) // 24)
    points = []
    data = mujoco.MjData(model)
    for i in [*range(0, len(states), step), len(states) - 1]:
        data.qpos[:] = states[i]
        mujoco.mj_kinematics(model, data)
        rotation = data.geom_xmat[chosen].reshape(-1, 3, 3)
        points.append(data.geom_xpos[chosen][:, None] + np.einsum("gij,gpj->gpi", rotation, local))
    return np.concatenate(points).reshape(-1, 3)


def view_angles(camera: Camera) -> tuple[float, float]:
    """Return azimuth and elevation of a camera seen from its target [degrees]."""
    x, y, z = np.subtract(camera.position, camera.target)
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _shares(mask: np.ndarray) -> np.ndarray:
    """Return the visible share in each view relative to the best one. mask: shape [views, H, W] bool."""
    pixels = mask.sum((1, 2))
    return np.sqrt(pixels / max(pixels.max(), 1))


def _touching(model: mujoco.MjModel, seen: Views) -> np.ndarray:
    apart = np.abs(model.geom_rgba[:, None, :3] - np.array([CONTACT, MISSED, UNWANTED]))
    whole = np.flatnonzero((apart < 1e-3).all(axis=2).any(axis=1))
    textured = np.flatnonzero(model.geom_matid >= 0)
    orange = seen.color[..., 2] < 0.5 * seen.color[..., 0]
    return np.isin(seen.segmentation, whole) | (np.isin(seen.segmentation, textured) & orange)
