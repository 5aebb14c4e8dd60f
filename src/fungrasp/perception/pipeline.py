"""From one image with depth and the object's mesh to a human grasp.

hand in the image -> hand in metres -> table -> object's pose -> the hand again, which now touches what it
holds -> contacts -> world. Each step's doubts are collected in words; a result that they make doubtful is
still given, marked as not sure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.conversion import MIRRORED
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, Side
from fungrasp.perception.hand.contact_flags import touching_links
from fungrasp.perception.hand.detection import DetectedHand, hand_lengths
from fungrasp.perception.hand.fit import fit_hand
from fungrasp.perception.hand.handedness import settle_side
from fungrasp.perception.hand.held_hand import fit_held
from fungrasp.perception.hand.landmarks import HandDetector, choose_hand
from fungrasp.perception.hand.object_contact import Surroundings
from fungrasp.perception.hand.refine import refine_hand
from fungrasp.perception.io.capture import Box, Capture
from fungrasp.perception.object_pose.alternative_pose import other_pose
from fungrasp.perception.object_pose.estimate import SIZES, estimate_object_pose
from fungrasp.perception.object_pose.external_pose import judge_estimate
from fungrasp.perception.quality import Quality, measure_quality
from fungrasp.perception.scene.table import NO_TABLE, table_under
from fungrasp.perception.scene.world_frame import guessed_table, in_world, put_down, world_from_table

__all__ = ["DepthDetector", "Detector", "Perceived", "Quality", "find_hands", "perceive"]

SURE_HAND = 0.6
"""Hands of a lower score are "not sure". Of 85 found in rendered captures 72 have more, whose joints are off
by 9.7 mm in the mean; those of the others by 32 mm."""


class Detector(Protocol):
    """What finds hands in a colour image; ``HandDetector`` is one."""

    def detect(self, colour: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """All hands found in an RGB image, shape [H, W, 3]; near: a box beside or around the hand."""
        ...


@runtime_checkable
class DepthDetector(Detector, Protocol):
    """A detector that makes use of how large hands are in the image."""

    def detect_with_depth(
        self, colour: np.ndarray, lengths: np.ndarray, near: Box | None = None
    ) -> list[DetectedHand]:
        """As ``detect``. lengths: ``hand_lengths`` of the image [pixels], shape [H, W]."""
        ...


@dataclass(frozen=True, eq=False)
class Perceived:
    """What was made of an image."""

    grasp: HumanGrasp
    """World frame, a right hand. If the image shows a left one, the scene reflected in the plane y = 0: the
    object's name then ends in "_mirrored", and its mesh must be reflected as well (see ``mirror_pose``)."""
    pose_world_camera: np.ndarray
    """Camera in the world, shape [7], before any reflection; see ``world_frame`` for where the world is."""
    hand: HandEstimate
    """As refined, camera frame, as it is seen."""
    object: ObjectEstimate
    """Camera frame, as it is seen."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame, shape
    [4]."""
    table_found: bool
    """Whether the table was given or seen; else it is a guess."""
    quality: Quality
    """In figures."""
    doubts: tuple[str, ...]
    """What was uncertain, in words; empty when nothing was."""
    sure: bool
    """Whether hand and object are both believed, the latter's surface to 10 mm on average. A table that is
    only guessed is a doubt, but the hand on the object does not depend on it; so is which way round a nearly
    symmetric object is."""


def perceive(
    capture: Capture,
    model: ObjectModel,
    *,
    coloured: trimesh.Trimesh | None = None,
    side: Side | None = None,
    task: str = "",
    table: np.ndarray | None = None,
    hand: HandEstimate | None = None,
    object_estimate: ObjectEstimate | None = None,
    detector: Detector | None = None,
    seed: int = 0,
    improve_pose: bool = False,
) -> Perceived:
    """The grasp in an image.

    Args:
        capture: colour and depth; its mask or box says where the object is.
        model: the object.
        coloured: the same mesh with its colours, which tell apart the sides of a nearly symmetric object.
        side: which hand it is, if known.
        task: what the grasp is for, see ``HumanGrasp``.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], unit normal upwards; looked for if None.
        hand: from another estimator; found in the image if None.
        object_estimate: from another estimator; found in the image if None. One that is not ``judged``
            gets the score that the depth gives it, see ``judge_estimate``.
        detector: finds hands; by default MediaPipe's models, which ``fungrasp setup perception`` fetches.
        seed: the same seed gives the same answer.
        improve_pose: whether an ``object_estimate`` that is not ``judged`` is fitted to the depth nearby.

    Raises:
        FungraspError: there is no hand in the image, no depth at it, the mesh is not of a size that a hand
            holds, or the hand models are not set up.
    """
    _check_size(model)
    doubts: list[str] = []
    mesh = model if coloured is None else coloured
    if hand is not None:
        seen = _see(capture, mesh, hand, None, table, object_estimate, seed, improve_pose)
    else:
        near = _object_box(capture, model, object_estimate)
        hands = find_hands(detector or HandDetector(), capture, near)
        candidates, doubts = _candidates(hands, near, side)
        seen = max(
            (
                _see(capture, mesh, fit_hand(d, capture), d, table, object_estimate, seed, improve_pose)
                for d in candidates
            ),
            key=lambda found: found.thing.score * found.hand.score,
        )
        if len(candidates) > 1:
            u, v = seen.hand.pixels.mean(axis=0)
            doubts.append(
                f"{len(hands)} hands are in the image; the one that holds the object more likely was taken, "
                f"at pixel {u:.0f}, {v:.0f}; a mask or box of the object settles it"
            )
    thing, plane = seen.thing, seen.table
    if not thing.accepted:
        doubts.append(f"the object's pose: {thing.note or 'not sure'}")
    elif other := other_pose(model, thing):
        doubts.append(other)
    hand = _refined(seen, capture, model, side)
    if hand.side != seen.hand.side:
        doubts.append(f"which hand it is: a {hand.side} one fits the depth better; --hand says which it is")
    if hand.score < SURE_HAND:
        doubts.append(f"the hand: its score is only {hand.score:.2f}")
    table_found = plane is not None
    if plane is None:
        surface = transform_points(thing.pose_camera_object, model.vertices)
        plane = guessed_table(np.concatenate([surface, hand.joints_camera]))
        doubts.append(
            "no table was seen: the camera was taken to be level and the table to be right below the grasp"
        )
    centre = transform_points(thing.pose_camera_object, model.center_of_mass[None])[0]
    pose_world_camera = world_from_table(plane, centre)
    return Perceived(
        grasp=_grasp(model, hand, thing, pose_world_camera, task),
        pose_world_camera=pose_world_camera,
        hand=hand,
        object=thing,
        table=plane,
        table_found=table_found,
        quality=measure_quality(capture, hand, thing, model.signed_distance),
        doubts=tuple(doubts),
        sure=thing.accepted and hand.score >= SURE_HAND,
    )


def find_hands(detector: Detector, capture: Capture, near: Box | None = None) -> list[DetectedHand]:
    """All hands found in an image by a detector, which may be one that depth helps."""
    if isinstance(detector, DepthDetector):
        lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
        return detector.detect_with_depth(capture.colour, lengths, near)
    return detector.detect(capture.colour, near)


def _check_size(model: ObjectModel) -> None:
    size = float(np.linalg.norm(model.size))
    if not SIZES[0] < size < SIZES[1]:
        unit = "; is the mesh in millimetres?" if size >= SIZES[1] else ""
        raise FungraspError(f"'{model.name}' is {size:.4g} m large, which no hand holds{unit}")


@dataclass(frozen=True, eq=False)
class _Seen:
    """A hand, and the table and the object that go with it."""

    detected: DetectedHand | None
    hand: HandEstimate
    table: np.ndarray | None
    thing: ObjectEstimate


def _candidates(
    hands: list[DetectedHand], near: Box | None, side: Side | None
) -> tuple[list[DetectedHand], list[str]]:
    """The hands that may be meant, and what was doubtful about choosing them.

    One, where the object's place says which, or only one is there; else the two largest of the side.
    """
    chosen, note = choose_hand(hands, near, side)
    fitting = [hand for hand in hands if side in (None, hand.side)]
    if near is None and len(fitting) > 1:
        fitting.sort(key=lambda hand: -float(np.prod(hand.box[2:] - hand.box[:2])))
        meant, note = fitting[:2], ""
    else:
        meant = [chosen]
    settled = [settle_side(hand, side) for hand in meant]
    notes = [note, *(word for _, word in settled)]
    return [hand for hand, _ in settled], [word for word in notes if word]


def _object_box(capture: Capture, model: ObjectModel, thing: ObjectEstimate | None) -> Box | None:
    """The box given, or that of the mask, or of the object where it is said to be [pixels]."""
    if capture.box is not None:
        return capture.box
    if capture.mask is not None:
        rows, columns = np.nonzero(capture.mask)
        return float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max())
    if thing is None:
        return None
    pixels = capture.intrinsics.project(transform_points(thing.pose_camera_object, model.vertices))
    if not np.isfinite(pixels).all():
        return None
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _see(
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: HandEstimate,
    detected: DetectedHand | None,
    table: np.ndarray | None,
    thing: ObjectEstimate | None,
    seed: int,
    improve: bool,
) -> _Seen:
    """The table under a hand and the object in it, unless they are known."""
    if table is None:
        table = table_under(capture, hand.joints_camera, np.random.default_rng(seed))
    under = NO_TABLE if table is None else table
    if thing is None:
        thing = estimate_object_pose(capture, mesh, hand, under, seed=seed)
    elif not thing.judged:
        thing = judge_estimate(thing, capture, mesh, hand, under, seed=seed, improve=improve)
    if table is None and thing.accepted:
        # The object tells as well what is below it.
        surface = transform_points(thing.pose_camera_object, np.asarray(mesh.vertices))
        table = table_under(capture, surface, np.random.default_rng(seed))
    return _Seen(detected, hand, table, thing)


def _refined(seen: _Seen, capture: Capture, model: ObjectModel, side: Side | None) -> HandEstimate:
    """The hand that touches the object; unchanged where the object's pose is not believed."""
    if not seen.thing.accepted:
        return seen.hand
    surface, pose = model.signed_distance, seen.thing.pose_camera_object
    if seen.detected is None:
        return refine_hand(seen.hand, surface, pose, seen.table)
    around = Surroundings(surface, pose, seen.table)
    return fit_held(seen.detected, capture, around, seen.hand.joints_camera, side=side)


def _grasp(
    model: ObjectModel,
    hand: HandEstimate,
    thing: ObjectEstimate,
    pose_world_camera: np.ndarray,
    task: str,
) -> HumanGrasp:
    pose = in_world(pose_world_camera, thing.pose_camera_object)
    grasp = HumanGrasp(
        object_name=model.name,
        object_mass=model.mass,
        object_pose=pose,
        object_rest_pose=put_down(model, pose),
        hand_joints=transform_points(pose_world_camera, hand.joints_camera),
        link_contacts=touching_links(hand.joints_camera, model.signed_distance, thing.pose_camera_object),
        task=task,
    )
    if hand.side == "right":
        return grasp
    return replace(
        grasp,
        object_name=model.name + MIRRORED,
        object_pose=mirror_pose(grasp.object_pose),
        object_rest_pose=mirror_pose(grasp.object_rest_pose),
        hand_joints=mirror_points(grasp.hand_joints),
    )
