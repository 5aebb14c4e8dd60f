"""What can't be, or hardly is: an object that no hand holds, or nowhere near the hand; a hand of another size
or color than people's; a hand or an object that is not whole in the image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_grasp import MAX_HAND_DISTANCE
from fungrasp.grasps.human_hand import HAND_SIZE_SPREAD, hand_size
from fungrasp.objects import ObjectModel
from fungrasp.perception.camera.readiness import along_bones, cut_edge
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, PerceptionWarning
from fungrasp.perception.hand.fit import OTHER_SIDE
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.estimate import SIZES
from fungrasp.perception.object_pose.shape_fit import FittedShape
from fungrasp.perception.perceived import HandCandidate

THICKEST = 0.25
"""A hand holds no object whose shortest side is longer [m]: it spans some 0.2."""

TINGE = 10
"""Skin of all people is redder than it is blue; by this it shows, of 255."""

BLUE = 0.05
"""Part of the hand's pixels that are blue from which on the colors are swapped: of an overexposed hand 8 %
tell, in images as they should be none."""


def check_held(scene: HandCandidate, model: ObjectModel, told: bool) -> None:
    """Complain about an object that the hand can't be holding, as a ``HumanGrasp`` does.

    Args:
        scene: hand and object.
        model: the object.
        told: whether it was said where the object is.

    Raises:
        FungraspError: the object is too far from the hand, or its mesh from its origin.
    """
    pose, joints = scene.object.pose_camera_object, scene.hand.joints_camera
    if np.linalg.norm(joints - pose[:3], axis=1).max() <= MAX_HAND_DISTANCE:
        return
    surface = transform_points(pose, model.vertices)
    apart = float(np.linalg.norm(surface - joints.mean(axis=0), axis=1).min())
    if apart < MAX_HAND_DISTANCE / 2:
        _check_origin(model, 0.0)
    what, then = "what fits it best", "a mask, a box or a click would say where it is"
    if told:
        what, then = "what was said to show it", "do mask, box, click or pose show the object in this hand?"
    raise FungraspError(
        f"'{model.name}' is in no hand: {what} is {apart:.2f} m from the hand that was found; {then}"
    )


def _check_origin(model: ObjectModel, allowed: float) -> None:
    """Complain about a mesh of which all is farther from its origin than is allowed [m]."""
    away = float(np.linalg.norm(model.vertices, axis=1).min())
    if away > allowed:
        raise FungraspError(
            f"the origin of '{model.name}' is {away:.2f} m from its surface: move the mesh to its origin, as "
            "poses and grasps are about it"
        )


def plausibility_doubt(
    scene: HandCandidate, warnings: Sequence[PerceptionWarning], fitted: FittedShape | None
) -> str:
    """What speaks against the answer, whatever its probabilities are: they are those of images of the right
    scale and of the side that the hand has, with aligned depth, in which hand and object are whole."""
    for one in warnings:
        # A mesh that fits has the size of what is seen; a shape that was fitted takes any.
        unscaled = one.code == "hand_size" and fitted is not None
        # What is cut off may slide along the edge, and fingers beyond it are found inside.
        unlike = one.code in ("cut_off", "depth_shifted")
        seen = scene.detected
        other_side = one.code == "side_not_as_given" and seen is not None and seen.side_score >= OTHER_SIDE
        if unscaled or unlike or other_side:
            return str(one)
    return ""


def check_holdable(model: ObjectModel) -> None:
    """Complain about a mesh that no hand holds, or that is far from its origin.

    Raises:
        FungraspError: see there.
    """
    size = float(np.linalg.norm(model.size))
    if not SIZES[0] < size < SIZES[1] or min(model.size) > THICKEST:
        sides = " x ".join(f"{1000 * side:,.0f}" for side in model.size)
        raise FungraspError(f"'{model.name}' is {sides} mm, which no hand holds: is its unit right?")
    _check_origin(model, MAX_HAND_DISTANCE)


def edge_of_hand(capture: Capture, hand: HandEstimate) -> str | None:
    """The edge of the image that cuts off a hand; None if it is whole."""
    lens = capture.intrinsics
    return cut_edge(lens, np.concatenate([hand.pixels, lens.project(hand.joints_camera)]))


def plausibility_warnings(
    capture: Capture, hand: HandEstimate, thing: ObjectEstimate, model: ObjectModel
) -> list[PerceptionWarning]:
    """Warnings of a hand, or an object whose pose is accepted, that the image's edge cuts off; of swapped red
    and blue; and of a hand smaller or larger than those of 95 % of adults: of the scale of depth and
    intrinsics, nothing else in an image tells as much."""
    lens, edges = capture.intrinsics, {"hand": edge_of_hand(capture, hand)}
    if thing.accepted:
        pixels = lens.project(transform_points(thing.pose_camera_object, model.vertices))
        edges["object"] = cut_edge(lens, pixels)
    found = [PerceptionWarning.of("cut_off", what=what, edge=edge) for what, edge in edges.items() if edge]
    u, v = along_bones(lens, hand.pixels)
    redder = capture.color[v, u, 0].astype(int) - capture.color[v, u, 2]
    blue, red = (redder < -TINGE).sum(), (redder > TINGE).sum()
    if blue > max(BLUE * len(redder), red):
        found.append(PerceptionWarning.of("colors_swapped"))
    size, spread = hand_size(hand.joints_camera), 2 * HAND_SIZE_SPREAD
    if abs(np.log(size)) >= spread:
        low, high = np.exp([-spread, spread]).tolist()
        found.append(PerceptionWarning.of("hand_size", size=size, low=low, high=high))
    return found
