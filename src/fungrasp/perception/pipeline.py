"""From one RGB-D image and the object's mesh to a human grasp, in six steps.

1. The hand in the image: landmarks (``hand.mediapipe_detector``).
2. The hand in metres: a skeleton fitted to landmarks and depth (``hand.fit``).
3. The table: the largest plane below the hand (``scene.table``).
4. The object's pose: the mesh fitted to the depth (``object_pose.estimate``).
5. The hand again, which now touches the object that it holds (``hand.fit``).
6. The grasp: links in contact, and all of it in the world frame (``scene.world_frame``).

Each step adds its warnings; a result of low confidence is still given, marked as such.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.objects import MIRRORED, ObjectModel
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, Side
from fungrasp.perception.hand.contact_evidence import HandSurroundings, touching_links
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.hand.fit import fit_held_hands, refine_hand
from fungrasp.perception.hand.meant_hands import MeantHand, hands_elsewhere, may_hold, meant_hands
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.confidence import ambiguity
from fungrasp.perception.object_pose.estimate import SIZES, estimate_object_pose
from fungrasp.perception.object_pose.external_pose import score_given_pose
from fungrasp.perception.quality import PerceptionQuality, measure_quality
from fungrasp.perception.scene.table import NO_TABLE, table_under
from fungrasp.perception.scene.world_frame import guessed_table, in_world, put_down, world_from_table
from fungrasp.perception.warning import PerceptionWarning

ACCEPTED_HAND = 0.6
"""Hands of a lower score are of low confidence. Of 85 found in rendered captures 72 have more, whose joints
are off by 9.7 mm in the mean; those of the others by 32 mm."""


@dataclass(frozen=True, eq=False)
class PossibleHand:
    """One of the hands that an image allows."""

    hand: HandEstimate
    """Camera frame, not mirrored."""
    grasp: HumanGrasp
    """World frame, a right hand."""
    probability: float
    """Of this hand, or one like it."""


@dataclass(frozen=True, eq=False)
class Perceived:
    """What was made of an image."""

    grasp: HumanGrasp
    """World frame, a right hand. If the image shows a left one, the scene reflected in the plane y = 0: the
    object's name then ends in "_mirrored", and its mesh must be reflected as well (see ``mirror_pose``)."""
    pose_world_camera: np.ndarray
    """Camera in the world, shape [7], before any reflection; see ``world_frame`` for where the world is."""
    hand: HandEstimate
    """The hand after refinement against the object, camera frame, not mirrored."""
    object: ObjectEstimate
    """The object, camera frame, not mirrored."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height of a point above it [m], camera frame, shape
    [4]."""
    table_found: bool
    """Whether the table was given or seen; else it is a guess."""
    quality: PerceptionQuality
    """Residuals, penetration and scores."""
    warnings: tuple[PerceptionWarning, ...]
    """What was uncertain; empty if nothing was."""
    confident: bool
    """Whether the scores of hand and object both pass their thresholds: the object's surface is then right to
    10 mm on average. A table that is only guessed gives a warning, but the hand on the object does not depend
    on it; so does the question which way round a nearly symmetric object is."""
    hands: tuple[PossibleHand, ...] = ()
    """Hands that the image allows, the best first, which is ``hand``: their fingers differ most where the
    object hides them."""


def perceive(
    capture: Capture,
    model: ObjectModel,
    *,
    colored: trimesh.Trimesh | None = None,
    side: Side | None = None,
    task: str = "",
    table: np.ndarray | None = None,
    hand: HandEstimate | None = None,
    object_estimate: ObjectEstimate | None = None,
    detector: HandDetector | None = None,
    seed: int = 0,
    improve_pose: bool = False,
    hands: int = 1,
) -> Perceived:
    """The grasp in an image.

    Args:
        capture: color and depth; its mask, box or point says where the object is.
        model: the object.
        colored: the same mesh with its colors, which tell apart the sides of a nearly symmetric object.
        side: which hand it is, if known.
        task: what the grasp is for, see ``HumanGrasp``.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], unit normal upwards; looked for if None.
        hand: from another estimator; found in the image if None.
        object_estimate: from another estimator; found in the image if None. One that is not ``judged``
            gets the score that the depth gives it, see ``score_given_pose``.
        detector: finds hands; by default MediaPipe's models, which ``fungrasp setup perception`` fetches.
        seed: the same seed gives the same answer.
        improve_pose: whether an ``object_estimate`` that is not ``judged`` is fitted to the depth nearby.
        hands: at most so many that the image allows are given, see ``Perceived.hands``.

    Raises:
        FungraspError: there is no hand in the image, no depth at it, the mesh is not of a size that a hand
            holds, or the hand models are not set up.
    """
    _check_size(model)
    mesh = model if colored is None else colored

    # 1, 2: the hand in the image and in metres. Where it is open which of two hands is meant, both go on.
    def scene_of(meant: MeantHand) -> _Scene:
        return _scene(capture, mesh, meant, table, object_estimate, seed, improve_pose)

    # 3, 4: the table and the object; the hand that holds the object more probably is the one.
    if hand is not None:
        scene = scene_of(MeantHand(hand))
    else:
        detector = detector or MediaPipeHandDetector()
        scenes = [scene_of(h) for h in meant_hands(capture, model, object_estimate, side, detector)]
        if not any(_worth(scene, mesh)[0] for scene in scenes):
            # The one that holds it may be harder to see than somebody else's.
            known = [scene.hand.detected for scene in scenes if scene.hand.detected is not None]
            scenes += [scene_of(h) for h in hands_elsewhere(capture, known, side, detector)]
        scene = max(scenes, key=lambda scene: _worth(scene, mesh))
    # 5: the hand again, touching the object.
    possible = _refined_hands(scene, capture, model, side, seed, hands)
    refined = possible[0][0]
    # 6: the grasp in the world.
    plane = scene.table
    if plane is None:
        surface = transform_points(scene.object.pose_camera_object, model.vertices)
        plane = guessed_table(np.concatenate([surface, refined.joints_camera]))
    center = transform_points(scene.object.pose_camera_object, model.center_of_mass[None])[0]
    pose_world_camera = world_from_table(plane, center)
    grasps = [_grasp(model, one, scene.object, pose_world_camera, task) for one, _ in possible]
    several = len(possible) > 1
    return Perceived(
        grasp=grasps[0],
        hands=tuple(
            PossibleHand(one, replace(grasp, probability=part) if several else grasp, part)
            for (one, part), grasp in zip(possible, grasps, strict=True)
        ),
        pose_world_camera=pose_world_camera,
        hand=refined,
        object=scene.object,
        table=plane,
        table_found=scene.table is not None,
        quality=measure_quality(capture, refined, scene.object, model.signed_distance),
        warnings=(*scene.hand.warnings, *_warnings(scene, refined, model)),
        confident=scene.object.accepted and refined.score >= ACCEPTED_HAND,
    )


def _check_size(model: ObjectModel) -> None:
    size = float(np.linalg.norm(model.size))
    if not SIZES[0] < size < SIZES[1]:
        unit = "; is the mesh in millimetres?" if size >= SIZES[1] else ""
        raise FungraspError(f"'{model.name}' is {size:.4g} m large, which no hand holds{unit}")


@dataclass(frozen=True, eq=False)
class _Scene:
    """A hand, and the table and the object that go with it."""

    hand: MeantHand
    table: np.ndarray | None
    object: ObjectEstimate


def _scene(
    capture: Capture,
    mesh: ObjectModel | trimesh.Trimesh,
    hand: MeantHand,
    table: np.ndarray | None,
    thing: ObjectEstimate | None,
    seed: int,
    improve: bool,
) -> _Scene:
    """The table under a hand and the object in it, unless they are known."""
    estimate = hand.estimate
    if table is None:
        table = table_under(capture, estimate.joints_camera, np.random.default_rng(seed))
    under = NO_TABLE if table is None else table
    if thing is None:
        thing = estimate_object_pose(capture, mesh, estimate, under, seed=seed)
    elif not thing.judged:
        thing = score_given_pose(thing, capture, mesh, estimate, under, seed=seed, improve=improve)
    if table is None and thing.accepted:
        # The object tells as well what is below it.
        surface = transform_points(thing.pose_camera_object, np.asarray(mesh.vertices))
        table = table_under(capture, surface, np.random.default_rng(seed))
    return _Scene(hand, table, thing)


def _worth(scene: _Scene, mesh: ObjectModel | trimesh.Trimesh) -> tuple[bool, float]:
    """How probable a scene is: one in which the hand is at the object first, then by the scores."""
    held = may_hold(scene.hand.estimate, scene.object, np.asarray(mesh.vertices))
    return held, scene.object.score * scene.hand.estimate.score


def _refined_hands(
    scene: _Scene, capture: Capture, model: ObjectModel, side: Side | None, seed: int, count: int
) -> list[tuple[HandEstimate, float]]:
    """Hands that touch the object, and their probabilities; the one hand unchanged where the object's pose is
    not accepted."""
    hand, thing = scene.hand, scene.object
    if not thing.accepted:
        return [(hand.estimate, 1.0)]
    surroundings = HandSurroundings(model.signed_distance, thing.pose_camera_object, scene.table)
    if hand.detected is None:
        return [(refine_hand(hand.estimate, surroundings), 1.0)]
    joints = hand.estimate.joints_camera
    return fit_held_hands(hand.detected, capture, surroundings, joints, count, side=side, seed=seed)


def _warnings(scene: _Scene, refined: HandEstimate, model: ObjectModel) -> list[PerceptionWarning]:
    """What is uncertain about object, refined hand and table."""
    found = []
    if not scene.object.accepted:
        found.append(
            PerceptionWarning.of("object_not_accepted", reason=scene.object.note or "low confidence")
        )
    elif (ambiguous := ambiguity(model, scene.object)) is not None:
        found.append(ambiguous)
    if refined.side != scene.hand.estimate.side:
        found.append(PerceptionWarning.of("side_from_depth", side=refined.side))
    if refined.score < ACCEPTED_HAND:
        found.append(PerceptionWarning.of("low_hand_score", score=refined.score))
    if scene.table is None:
        found.append(PerceptionWarning.of("no_table"))
    return found


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
