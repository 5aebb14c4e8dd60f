"""Scenes of a grasp for the renderer, and cameras that show it well."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import trimesh
from scipy.spatial import KDTree

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert
from fungrasp.hands import Hand
from fungrasp.report.camera import Camera, fit_camera
from fungrasp.report.hand_mesh import human_hand_mesh
from fungrasp.report.render import Renderer, Views
from fungrasp.report.shading import Look

SKIN = (0.86, 0.68, 0.57)
"""Colour of a human hand, sRGB."""

CONTACT = (0.95, 0.49, 0.16)
"""Colour of links in contact, sRGB."""

OBJECT = (0.36, 0.55, 0.72)
"""Colour of an object, sRGB."""

OBJECT_BODY = "object"
"""Name of the object's body in the scenes made here."""

HAND_BODY = "hand"
"""Name of the body that carries the hand in the scenes made here."""

PALM_TINT = 0.75
"""How much of ``CONTACT`` goes into the colour of a robot's palm in contact, which is large."""

_PALETTE = 64
_PREFIX = "robot/"
_SPACING = 0.01


def human_grasp_scene(
    joints: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    object_pose: np.ndarray,
    link_contacts: np.ndarray,
    *,
    object_colour: Sequence[float] = OBJECT,
) -> mujoco.MjModel:
    """A human hand, its links in contact coloured, holding an object. The model has no joints.

    Args:
        joints: [m], world frame, shape [21, 3].
        vertices: of the object [m], object frame, shape [V, 3].
        faces: of the object, shape [T, 3].
        object_pose: world frame, shape [7].
        link_contacts: shape [16] bool.
        object_colour: sRGB.

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    contacts = _flags(link_contacts, 16)
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
    surface = _dense(vertices, faces)
    apart, _ = KDTree(surface).query(inverse_transform_points(np.asarray(object_pose, float), hand.vertices))
    near = np.clip((0.030 - apart) / 0.020, 0.0, 1.0)
    touching = hand.links @ contacts.astype(float)
    touching -= hand.links[:, 0] * contacts[0] * (1.0 - near)
    place = (0.5 + touching * (_PALETTE - 1)) / _PALETTE
    mesh = _add_mesh(spec, HAND_BODY, hand.vertices, hand.faces)
    mesh.usertexcoord = np.stack([place, np.full_like(place, 0.5)], axis=-1).ravel()
    body = spec.worldbody.add_body(name=HAND_BODY)
    _add_mesh_geom(body, HAND_BODY, [1, 1, 1, 1]).material = "skin"
    _add_object(spec, vertices, faces, object_pose, object_colour)
    return spec.compile()


def robot_grasp_scene(
    hand: Hand,
    wrist_pose: np.ndarray,
    joint_positions: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    object_pose: np.ndarray,
    link_contacts: np.ndarray | None = None,
    *,
    object_colour: Sequence[float] = OBJECT,
) -> tuple[mujoco.MjModel, np.ndarray]:
    """A robot hand, its links in contact coloured, holding an object.

    Args:
        wrist_pose: of the palm body, world frame, shape [7].
        joint_positions: in the order of ``hand.joint_names`` [rad], shape [M].
        vertices: of the object [m], object frame, shape [V, 3].
        faces: of the object, shape [T, 3].
        object_pose: world frame, shape [7].
        link_contacts: in the order of ``hand.links``, shape [L] bool; None for none.
        object_colour: sRGB.

    Returns:
        the model, and its qpos, shape [nq].

    Raises:
        FungraspError: an argument has the wrong shape or is not finite.
    """
    pose = _finite("wrist_pose", wrist_pose, (7,))
    positions = _finite("joint_positions", joint_positions, (len(hand.joint_names),))
    contacts = _flags(
        np.zeros(len(hand.links), bool) if link_contacts is None else link_contacts, len(hand.links)
    )
    child = hand.spec()
    tints = {}
    for k, (bodies, flag) in enumerate(zip(hand.links, contacts, strict=True)):
        tints |= {body: (PALM_TINT if k == 0 else 1.0) * flag for body in bodies}
    for geom in child.geoms:
        tint = tints.get(geom.parent.name, 0.0)
        if tint > 0:
            own = np.asarray(geom.rgba[:3], dtype=float)
            geom.rgba = [*(own + tint * (np.asarray(CONTACT) - own)), 1.0]
            geom.material = ""
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.palm)
    pose_world_hand = compose(pose, invert(np.concatenate([palm.xpos, palm.xquat])))
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=HAND_BODY, pos=pose_world_hand[:3], quat=pose_world_hand[3:])
    spec.attach(child, prefix=_PREFIX, frame=body.add_frame())
    _add_object(spec, vertices, faces, object_pose, object_colour)
    model = spec.compile()
    qpos = model.qpos0.copy()
    for name, position in zip(hand.joint_names, positions, strict=True):
        qpos[model.joint(_PREFIX + name).qposadr[0]] = position
    return model, qpos


def look_at_grasp(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    width: int = 640,
    height: int = 480,
    elevations: Sequence[float] = (14.0, 30.0, 48.0),
    azimuths: int = 12,
) -> Camera:
    """A camera above the table that frames hand and object, and from which most of the contact can be seen.

    Of all views tried, it has the largest sum of visible shares: of the coloured links' pixels, of the object's and of
    the hand's, each compared with the view that shows most of it.

    Args:
        model: made by ``human_grasp_scene`` or ``robot_grasp_scene``, or any with a body named ``OBJECT_BODY``.
        qpos: shape [nq]; None for the model's reference.
    """
    qpos = model.qpos0 if qpos is None else np.asarray(qpos, dtype=float)
    small = (48 * width // max(width, height) + 1, 48 * height // max(width, height) + 1)
    views = [(e, a) for e in elevations for a in np.arange(azimuths) * 360.0 / azimuths]
    cameras = [frame_geoms(model, qpos, a, e, width=small[0], height=small[1]) for e, a in views]
    seen = Renderer(model, antialias=1, shadows=False).views(np.tile(qpos, (len(views), 1)), cameras)
    of_object = [g for g in range(model.ngeom) if model.body(int(model.geom_bodyid[g])).name == OBJECT_BODY]
    on_object = np.isin(seen.segmentation, of_object)
    on_hand = (seen.segmentation >= 0) & ~on_object
    touching = on_hand & _touching(model, seen)
    score = np.zeros(len(views))
    for mask, weight in ((touching, 1.0), (on_object, 0.8), (on_hand, 0.5)):
        pixels = mask.sum((1, 2))
        score += weight * np.sqrt(pixels / max(pixels.max(), 1))
    elevation, azimuth = views[int(np.argmax(score))]
    return frame_geoms(model, qpos, azimuth, elevation, width=width, height=height)


def frame_geoms(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    azimuth: float,
    elevation: float,
    *,
    width: int = 640,
    height: int = 480,
    fov_y: float = 30.0,
) -> Camera:
    """A camera that frames all drawn geoms but planes and huge ones, tightly.

    Args:
        qpos: shape [nq].
        azimuth: of the camera, from the world's x towards y [degrees].
        elevation: above the horizontal [degrees].
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    chosen = (model.geom_group < 3) & (model.geom_rbound > 0) & (model.geom_rbound < 0.6)
    if not chosen.any():
        raise FungraspError("there is nothing to look at: the model has no visible geom of a size to frame")
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(8, 3)
    boxes = model.geom_aabb[chosen]
    local = boxes[:, None, :3] + corners * boxes[:, None, 3:]
    rotation = data.geom_xmat[chosen].reshape(-1, 3, 3)
    points = data.geom_xpos[chosen][:, None] + np.einsum("gij,gpj->gpi", rotation, local)
    points = points.reshape(-1, 3)
    return fit_camera(
        points, np.zeros(len(points)), azimuth, elevation, fov_y=fov_y, width=width, height=height
    )


def four_views(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    width: int = 480,
    height: int = 360,
    azimuth: float = -60.0,
    look: Look | None = None,
) -> list[np.ndarray]:
    """A thing from four sides, a quarter turn apart, alternately from low and from high, for ``grid``.

    Args:
        qpos: shape [nq]; None for the model's reference.
        azimuth: of the first view [degrees].

    Returns:
        four pictures, sRGB, shape [height, width, 3] uint8.
    """
    qpos = model.qpos0 if qpos is None else np.asarray(qpos, dtype=float)
    renderer = Renderer(model, look=look)
    cameras = [
        frame_geoms(model, qpos, azimuth + 90.0 * i, 22.0 + 18.0 * (i % 2), width=width, height=height)
        for i in range(4)
    ]
    return [next(renderer.stream(qpos, camera)) for camera in cameras]


def _touching(model: mujoco.MjModel, seen: Views) -> np.ndarray:
    whole = np.flatnonzero(np.all(np.abs(model.geom_rgba[:, :3] - np.asarray(CONTACT)) < 1e-3, axis=1))
    textured = np.flatnonzero(model.geom_matid >= 0)
    assert seen.colour is not None
    orange = seen.colour[..., 2] < 0.5 * seen.colour[..., 0]
    return np.isin(seen.segmentation, whole) | (np.isin(seen.segmentation, textured) & orange)


def _add_object(
    spec: mujoco.MjSpec, vertices: np.ndarray, faces: np.ndarray, pose: np.ndarray, colour: Sequence[float]
) -> None:
    pose = _finite("object_pose", pose, (7,))
    vertices = np.asarray(vertices, dtype=float)
    faces = np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or faces.ndim != 2 or faces.shape[1:] != (3,):
        raise FungraspError(
            f"an object needs vertices [V, 3] and faces [T, 3], not {vertices.shape} and {faces.shape}"
        )
    _add_mesh(spec, OBJECT_BODY, vertices, faces)
    body = spec.worldbody.add_body(name=OBJECT_BODY, pos=pose[:3], quat=pose[3:])
    _add_mesh_geom(body, OBJECT_BODY, [*colour, 1.0])


def _dense(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Points at most ``_SPACING`` apart on a surface."""
    points, _ = trimesh.remesh.subdivide_to_size(vertices, faces, _SPACING, max_iter=12)
    return points


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
