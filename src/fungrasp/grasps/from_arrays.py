"""Human grasps from arrays of joints, meshes and poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.contacts import CONTACT_REACH, link_points
from fungrasp.grasps.conversion import Convention, converted
from fungrasp.grasps.diagnosis import checked_grasps
from fungrasp.grasps.human_grasp import HumanGrasp
from fungrasp.grasps.human_hand import HUMAN_LINKS, LINK_RADII, joint_order
from fungrasp.objects import ObjectModel, ResolvedObject, resolve_object
from fungrasp.objects.object_variants import mirrored_object

if TYPE_CHECKING:
    import trimesh

SKIN = 0.009
"""Mean depth of finger joints under the skin [m], see ``LINK_RADII``."""

LANDMARK_ERROR = 0.005
"""Error of a landmark as a share of its distance: 3 pixels at a focal length of 600 pixels."""


def human_grasp(
    joints: ArrayLike,
    mesh: ObjectModel | ResolvedObject | trimesh.Trimesh | str | Path,
    *,
    order: str = "fungrasp",
    object_pose: ArrayLike | None = None,
    contacts: ArrayLike | None = None,
    mass: float | None = None,
    task: str = "",
    convention: Convention | None = None,
) -> HumanGrasp:
    """Create a human grasp from arrays, with the same checks as for grasp files.

    Args:
        joints: joints of a right hand [m], shape [21, 3], world frame (z up, table top at z = 0), or mesh
            frame without ``object_pose``.
        mesh: the object, as a mesh [m] (trimesh or file), name of a built-in object, or model
            (``object_from_mesh``, ``load_object``).
        order: joint order: "mediapipe", "openpose", "mano" and others
            (``fungrasp.grasps.human_hand.ORDERS``).
        object_pose: pose of the grasped object in the world, ``[x y z qw qx qy qz]`` or a 4 x 4 matrix. None:
            the object stands on the table with its z axis up.
        contacts: flags for ``HUMAN_LINKS``, shape [16] bool, or contact points [m], shape [P, 3], in the
            frame of the joints. None: computed from the distance between hand and mesh.
        mass: mass of the object [kg]. None: that of the model, or guessed from the size of the mesh.
        task: "drink", "cut", ...; empty if unknown.
        convention: convention of joints and pose if it differs: ``Convention(unit="mm")``,
            ``Convention(up="y")``, ``Convention(side="left")`` (hand and object are mirrored), ...

    Returns:
        The grasp with its object, for ``fungrasp.retarget(grasp)``.

    Raises:
        FungraspError: a shape, joint order or unit is wrong, the hand is a left one or far from the object,
            or the mesh cannot be read.
    """
    obj = resolve_object(mesh, mass)
    model = obj.model
    ordered = _finite("joints", joints, (21, 3))[joint_order(order)]
    if convention is not None:
        ordered, object_pose = _converted(ordered, object_pose, convention)
        model = mirrored_object(model) if convention.side == "left" else model
    points = None if contacts is None else _numbers("contacts", contacts)
    if object_pose is None:
        pose = model.rest_pose()
        ordered = transform_points(pose, ordered)
    else:
        pose = as_pose(object_pose)
    if points is None:
        flags = np.zeros(len(HUMAN_LINKS), dtype=bool)
    elif points.ndim == 1:
        if points.shape != (len(HUMAN_LINKS),) or not np.isin(points, (0, 1)).all():
            raise FungraspError(
                f"contacts: shape {points.shape}, expected a flag (true or false) for each of the "
                f"{len(HUMAN_LINKS)} links, or points (P, 3)"
            )
        flags = points.astype(bool)
    else:
        places = _finite("contacts", points, (None, 3))
        flags = touched_links(ordered, places if object_pose is not None else transform_points(pose, places))
    fields = {
        "object_name": np.array([model.name]),
        "object_mass": np.array([model.mass]),
        "object_pose": pose[None],
        "hand_joints": ordered[None],
        "link_contacts": flags[None],
        "task": np.array([task]),
    }
    if obj.mass_spread is not None:
        fields["object_mass_spread"] = np.array([obj.mass_spread])
    if object_pose is None:
        fields["object_rest_pose"] = pose[None]
    mend = "give convention=Convention({}) (of fungrasp.grasps)"
    grasps = checked_grasps(fields, {model.name: model}, "the grasp", mend=mend)
    return replace(grasps, objects={model.name: model})[0]


def _converted(
    joints: np.ndarray, object_pose: ArrayLike | None, convention: Convention
) -> tuple[np.ndarray, np.ndarray | None]:
    """Convert joints and pose to the conventions of fungrasp."""
    fields = {"object_name": np.array([""]), "hand_joints": joints[None]}
    if object_pose is not None:
        fields["object_pose"] = as_pose(object_pose)[None]
    ours = converted(fields, convention)
    return ours["hand_joints"][0], ours["object_pose"][0] if object_pose is not None else None


def mediapipe_joints(
    pixels: ArrayLike, world: ArrayLike, intrinsics: ArrayLike, depth: np.ndarray | None = None
) -> np.ndarray:
    """Return joints from MediaPipe's landmarks [m], camera frame (x right, y down, z forward), shape [21, 3].

    World landmarks have no position; it is fitted so that they project to the pixels. Without a depth image,
    the hand has the size of MediaPipe's mean hand, and the distance has the same relative error as the size.

    Args:
        pixels: landmarks in the image [pixels], shape [21, 2]: normalized landmarks times width and height.
        world: world landmarks [m], shape [21, 3].
        intrinsics: camera matrix, shape [3, 3].
        depth: depth image aligned with the color image [m], shape [H, W], 0 if unknown. It determines size
            and distance, even if the object hides some landmarks.

    Returns:
        Joints in the order of ``HUMAN_JOINTS``.

    Raises:
        FungraspError: a shape is wrong, landmarks are normalized, or fewer than four of them have depth.
    """
    from scipy.optimize import least_squares

    seen, shape = _finite("pixels", pixels, (21, 2)), _finite("world landmarks", world, (21, 3))
    camera = _finite("intrinsics", intrinsics, (3, 3))
    if np.ptp(seen, axis=0).max() <= 1.0:
        raise FungraspError("the landmarks are normalized: multiply them by the image's width and height")
    rays = (seen - camera[:2, 2]) / camera[[0, 1], [0, 1]]
    known, surface = np.zeros(21, dtype=bool), np.zeros(21)
    if depth is not None:
        column, row = np.rint(seen).astype(int).T
        inside = (row >= 0) & (row < depth.shape[0]) & (column >= 0) & (column < depth.shape[1])
        surface[inside] = depth[row[inside], column[inside]]
        known = (surface > 0) & np.isfinite(surface)
        if known.sum() < 4:
            raise FungraspError(
                f"depth is measured at {known.sum()} of the 21 landmarks: at least 4 are needed"
            )

    def residuals(x: np.ndarray) -> np.ndarray:
        places = x[0] * shape + x[1:]
        missed = places[:, :2] / np.maximum(places[:, 2:], 1e-3) - rays
        # Depth is measured at the skin, above the joints.
        behind = places[known, 2] - surface[known] - SKIN
        return np.concatenate(
            [missed.ravel() / LANDMARK_ERROR, behind / SKIN, [100.0 * (x[0] - 1)] * (depth is None)]
        )

    start = [1.0, *(0.5 * rays.mean(axis=0)), float(np.median(surface[known])) if known.any() else 0.5]
    found = least_squares(residuals, start, loss="soft_l1" if depth is not None else "linear").x
    return (found[0] * shape + found[1:])[joint_order("mediapipe")]


def as_pose(pose: ArrayLike) -> np.ndarray:
    """Convert a pose, shape [7] or a 4 x 4 matrix, to ``[x y z qw qx qy qz]``.

    Raises:
        FungraspError: the shape, rotation or quaternion is invalid.
    """
    array = _numbers("object_pose", pose)
    if array.shape == (4, 4):
        rotation = array[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0:
            raise FungraspError("object_pose: the upper left 3 x 3 block of the matrix is no rotation")
        if not np.allclose(array[3], [0, 0, 0, 1], atol=1e-3):
            raise FungraspError(
                f"object_pose: the last row of the matrix is {one_line(array[3])}, not 0 0 0 1: is it "
                "transposed?"
            )
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(rotation).as_quat()
        array = np.array([*array[:3, 3], w, x, y, z])
    elif array.shape != (7,):
        raise FungraspError(f"object_pose: shape {array.shape}, expected (7,) or (4, 4)")
    array = _finite("object_pose", array, (7,))
    length = float(np.linalg.norm(array[3:]))
    if abs(length - 1) > 0.01:
        raise FungraspError(f"object_pose: its quaternion (last four numbers) has length {length:.3g}, not 1")
    return array


def touched_links(hand_joints: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which links are nearest to a contact point, shape [16] bool.

    Args:
        hand_joints: joints [m], shape [21, 3].
        points: contact points in the same frame [m], shape [P, 3].

    Raises:
        FungraspError: a point is farther than ``CONTACT_REACH`` from the hand.
    """
    axes = link_points(hand_joints[None])[0]
    apart = np.linalg.norm(points[:, None, None] - axes[None], axis=-1).min(axis=2) - LINK_RADII
    far = np.flatnonzero(apart.min(axis=1, initial=np.inf) > CONTACT_REACH) if len(points) else []
    if len(far):
        distance = 1e3 * apart[far[0]].min()
        raise FungraspError(
            f"contact point {far[0]} is {distance:.0f} mm from the hand: points are in the frame of the "
            "joints [m]"
        )
    return np.isin(np.arange(len(HUMAN_LINKS)), apart.argmin(axis=1))


def _finite(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> np.ndarray:
    array = _numbers(name, values)
    if array.ndim != len(shape) or any(a not in (b, None) for a, b in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("P" if n is None else str(n) for n in shape)
        many = array.shape[1:] == shape
        raise FungraspError(
            f"{name}: shape {array.shape}, expected ({wanted})"
            + ("; for several grasps, call it for each and HumanGraspSet.of(them)" if many else "")
        )
    if not np.isfinite(array).all():
        raise FungraspError(f"{name}: a number is not finite")
    return array


def _numbers(name: str, values: ArrayLike) -> np.ndarray:
    """Convert numbers, also tensors, to float64.

    Raises:
        FungraspError: the values are not numbers.
    """
    tensor: Any = values
    try:
        if hasattr(tensor, "detach"):
            # NumPy cannot read tensors that are on a GPU, require gradients, or are bfloat16.
            tensor = tensor.detach().cpu().double().numpy()
        return np.asarray(tensor, dtype=float)
    except (TypeError, ValueError, RuntimeError) as problem:
        raise FungraspError(f"{name}: not an array of numbers ({one_line(problem)})") from problem
