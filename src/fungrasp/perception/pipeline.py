"""Perceive a human grasp in one RGB-D image, with the object's mesh, in six steps.

1. Detect hands in the image (``hand.mediapipe_detector``).
2. Fit a skeleton to landmarks and depth (``hand.fit``).
3. Find the table, the largest plane below the hand (``scene.table``).
4. Fit the object's mesh to the depth (``object_pose.estimate``).
5. Fit the hand again, in contact with the object (``hand.fit``).
6. Find the links in contact, and transform the grasp to the world frame (``scene.table``).

Each step adds its warnings. Uncertain results are returned too, and marked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.objects import ObjectModel, ResolvedObject, mirrored_object, resolve_object
from fungrasp.perception.acceptance import (
    check_held,
    check_holdable,
    doubt_of,
    joint_probabilities,
    judge,
    plausibility_warnings,
)
from fungrasp.perception.hand.detected_hand import (
    DetectedHand,
    HandDetector,
    HandHypothesis,
    find_hands,
    hand_hypotheses,
    hands_elsewhere,
    may_hold,
    object_box,
)
from fungrasp.perception.hand.fit import fit_hand, fit_held_hand, refine_hand
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.hand.physical_evidence import HandSurroundings, link_gaps, touching_links
from fungrasp.perception.io.capture import Box, Capture, RgbdCamera
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, Side
from fungrasp.perception.io.image_files import check_hints
from fungrasp.perception.io.image_source import ImageSource, as_capture
from fungrasp.perception.io.scene_folders import BUILTIN, BUILTIN_CAPTURE, builtin_truth
from fungrasp.perception.object_pose.estimate import estimate_object_pose, score_given_pose
from fungrasp.perception.object_pose.pose_evidence import ambiguity
from fungrasp.perception.object_pose.shape_fit import FittedShape, fit_shape
from fungrasp.perception.perceived import HandCandidate, Perceived
from fungrasp.perception.scene.table import (
    NO_TABLE,
    guessed_table,
    in_world,
    put_down,
    table_under,
    world_from_table,
)

if TYPE_CHECKING:
    import trimesh

    Mesh = ObjectModel | trimesh.Trimesh
    """Surface of an object, with colors if known."""

UNKNOWN = "unknown"
"""Name of an object without a mesh."""


def perceive(
    capture: Capture | ImageSource | RgbdCamera | str | Path | Sequence[str | Path],
    obj: ObjectModel | ResolvedObject | str | Path,
    *,
    mass: float | None = None,
    side: Side | None = None,
    task: str = "",
    table: np.ndarray | None = None,
    hand: HandEstimate | Callable[[Capture], HandEstimate] | None = None,
    object_estimate: ObjectEstimate | Callable[[Capture, Mesh], ObjectEstimate] | None = None,
    detector: HandDetector | None = None,
    seed: int = 0,
    improve_pose: bool = False,
) -> Perceived:
    """Find the grasp in an image. ``retarget`` accepts the result.

    Args:
        capture: color and depth, with an optional mask, box or point of the object. Or their source: a folder
            (see ``read_folder``), a recording or "builtin"; paths of color image, depth and intrinsics; or a
            camera, which takes an image now.
        obj: object, its mesh file [m], the name of a built-in object, or a shape, "box:60x28x30" [mm].
            "unknown" fits a box, cylinder or sphere to the depth. Colors of the mesh file distinguish the
            sides of nearly symmetric objects.
        mass: mass of a mesh [kg]. None: known for built-in objects, otherwise guessed, with a note.
        side: side of the hand, if known.
        task: task of the grasp, see ``HumanGrasp``.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], unit normal upwards; detected if None.
        hand: estimate or estimator; found in the image if None.
        object_estimate: estimate or estimator; found in the image if None. Unless it is ``judged``, its score
            is computed from the depth, see ``score_given_pose``.
        detector: hand detector; MediaPipe's, from ``fungrasp setup perception``, if None.
        seed: random seed.
        improve_pose: fit an ``object_estimate`` to the depth, unless it is ``judged``.

    Raises:
        FungraspError: invalid argument, unreadable image or object, no hand in the image, no depth at the
            hand, an object that no hand can hold or that is far from the hand, or missing hand models.
    """
    if seed < 0:
        raise FungraspError(f"the seed must be 0 or more, not {seed}")
    unknown = isinstance(obj, str) and obj == UNKNOWN
    if unknown and object_estimate is not None:
        raise FungraspError("the pose of an object without a mesh can't be given: it has no frame")
    if table is not None and table[3] <= 0:
        raise FungraspError(
            "the plane nx,ny,nz,d puts the camera below the table: its normal must point up, and d is the "
            "camera's height [m]; reverse all four signs"
        )
    held = obj if isinstance(obj, ResolvedObject) else None if unknown else resolve_object(obj, mass)
    if not isinstance(capture, Capture):
        capture = as_capture(capture)
    check_hints(capture)
    hand = hand(capture) if callable(hand) else hand
    seen = _Image(capture, side, table, detector, seed)
    fitted = None
    if held is None:
        fitted = _fitted_shape(seen, hand)
        held = resolve_object(fitted.name, mass)
        object_estimate = ObjectEstimate(fitted.pose, fitted.quality, fitted.fits)
    model = held.model
    mesh = model if held.colored is None else held.colored
    given = object_estimate(capture, mesh) if callable(object_estimate) else object_estimate
    check_holdable(model)
    near = object_box(capture, model, given)

    def scene_of(one: HandEstimate, of: HandHypothesis | None = None) -> HandCandidate:
        return _scene(seen, mesh, one, of, given, improve_pose)

    # 1, 2: hands in meters, several if it is unclear which one holds the object.
    # 3, 4: table and object for each of them; the candidate that most probably holds the object is used.
    if hand is not None:
        scenes = [scene_of(hand)]
    else:
        detected = find_hands(seen.detector, capture, near)
        scenes = [scene_of(one, of) for of, one in seen.fitted_hands(seen.hypotheses(detected, near))]
        if not any(scene.holds for scene in scenes):
            # The hand that holds the object may be harder to see than another person's hand.
            known = [scene.detected for scene in scenes if scene.detected is not None]
            others = hands_elsewhere(capture, known, side, seen.detector)
            scenes += [scene_of(one, of) for of, one in seen.fitted_hands(others, needed=False)]
    scenes.sort(key=lambda scene: (scene.holds, scene.worth), reverse=True)
    scene = scenes[0]
    check_held(scene.hand, scene.object, model, hinted=near is not None)
    # 5: the hand again, in contact with the object.
    refined = _refined_hand(seen, scene, model)
    confidence = joint_probabilities(capture, scene.hand, refined, scene.object.accepted)
    refined = replace(refined, confidence=confidence)
    # 6: the grasp in the world.
    plane = scene.table
    if plane is None:
        surface = transform_points(scene.object.pose_camera_object, model.vertices)
        plane = guessed_table(np.concatenate([surface, refined.joints_camera]))
    center = transform_points(scene.object.pose_camera_object, model.center_of_mass[None])[0]
    pose_world_camera = world_from_table(plane, center)
    grasp = _grasp(held, refined, scene.object, pose_world_camera, task)
    gaps = link_gaps(scene.hand.joints_camera, model.signed_distance, scene.object.pose_camera_object)
    warnings = (*capture.warnings, *scene.warnings, *_warnings(scene, refined, model, capture))
    side_score = None if scene.detected is None else scene.detected.side_score
    return Perceived(
        capture=capture,
        object_model=model,
        grasp=grasp,
        pose_world_camera=pose_world_camera,
        hand=refined,
        object=scene.object,
        table=plane,
        table_found=scene.table is not None,
        warnings=warnings,
        acceptance=judge(
            scene.object,
            refined,
            fitted="" if fitted is None else fitted.name,
            touching=_parts(grasp.link_contacts) if scene.object.accepted else None,
            reach=float(np.sort(gaps)[2]),
            doubt=doubt_of(warnings, side_score, fitted is not None),
            given=given is not None,
        ),
        notes=held.notes,
        mass_range=held.mass_range,
        fitted=fitted,
        candidates=tuple(scenes),
    )


def _parts(link_contacts: np.ndarray) -> int:
    """Return how many of palm and five fingers touch. link_contacts: shape [16] bool."""
    return int(link_contacts[0]) + int(link_contacts[1:].reshape(5, 3).any(axis=1).sum())


def perceive_folder(
    folder: str, mesh: str | None, mass: float | None = None, task: str = "", seed: int = 0
) -> Perceived:
    """Perceive the image of a folder, or the built-in image with its own object.

    Args:
        folder: folder of the capture, or ``BUILTIN``.
        mesh: mesh file or name of a built-in object; None for the built-in image.
        mass, task, seed: see ``perceive``.

    Raises:
        FungraspError: bad folder or mesh, no hand in the image, or missing hand models.
    """
    if folder == BUILTIN:
        if mesh is not None or mass is not None:
            raise FungraspError("the built-in image has its own object: --mesh and --mass need a folder")
        truth = builtin_truth()
        return perceive(BUILTIN_CAPTURE, truth.object_name, task=task or truth.task, seed=seed)
    if mesh is None:
        raise FungraspError(
            f"image {folder}: --mesh is missing: give the object's mesh file or a built-in object's name"
        )
    return perceive(folder, mesh, mass=mass, task=task, seed=seed)


@dataclass(frozen=True, eq=False)
class _Image:
    """An image with the arguments about it."""

    capture: Capture
    side: Side | None
    table: np.ndarray | None
    given_detector: HandDetector | None
    seed: int

    @cached_property
    def detector(self) -> HandDetector:
        """Given detector, or MediaPipe's."""
        return self.given_detector or MediaPipeHandDetector()

    def hypotheses(self, detected: Sequence[DetectedHand], near: Box | None) -> list[HandHypothesis]:
        """Return the detected hands that may hold the object. near: box around the object [pixels]."""
        return hand_hypotheses(self.capture, detected, near, self.side, self.detector)

    def fitted_hands(
        self, found: Sequence[HandHypothesis], needed: bool = True
    ) -> list[tuple[HandHypothesis, HandEstimate]]:
        """Fit hands to the depth. Hands without depth, such as distant ones, are dropped.

        Raises:
            FungraspError: no hand has depth, and ``needed``.
        """
        measured, problem = [], None
        for one in found:
            try:
                measured.append((one, fit_hand(one.detected, self.capture)))
            except FungraspError as error:
                problem = error
        if needed and problem is not None and not measured:
            raise problem
        return measured

    def table_under(self, points: np.ndarray) -> np.ndarray | None:
        """Return the given table, or the largest plane below points [m], camera frame, shape [P, 3]."""
        if self.table is not None:
            return self.table
        return table_under(self.capture, points, np.random.default_rng(self.seed))


def _fitted_shape(seen: _Image, hand: HandEstimate | None) -> FittedShape:
    """Fit a shape to an object without a mesh, in the hand for which it explains the image best."""
    if hand is not None:
        held_by = [hand]
    else:
        near = object_box(seen.capture, None, None)
        found = seen.hypotheses(find_hands(seen.detector, seen.capture, near), near)
        held_by = [one for _, one in seen.fitted_hands(found)]
    shapes, problem = [], None
    for one in held_by:
        under = seen.table_under(one.joints_camera)
        try:
            shapes.append(fit_shape(seen.capture, one.joints_camera, under, seed=seen.seed))
        except FungraspError as error:
            problem = error
    if not shapes:
        assert problem is not None
        raise problem
    return max(shapes, key=lambda shape: shape.quality)


def _scene(
    seen: _Image,
    mesh: Mesh,
    hand: HandEstimate,
    of: HandHypothesis | None,
    given: ObjectEstimate | None,
    improve: bool,
) -> HandCandidate:
    """Find the table under a hand and the object in it, unless they are given."""
    obj = given
    table = seen.table_under(hand.joints_camera)
    under = NO_TABLE if table is None else table
    if obj is None:
        obj = estimate_object_pose(seen.capture, mesh, hand, under, seed=seen.seed)
    elif not obj.judged:
        obj = score_given_pose(obj, seen.capture, mesh, hand, under, seed=seen.seed, improve=improve)
    vertices = np.asarray(mesh.vertices)
    if table is None and obj.accepted:
        # The object may show the table as well.
        table = seen.table_under(transform_points(obj.pose_camera_object, vertices))
    holds = may_hold(hand, obj, vertices)
    detected, warnings = (None, ()) if of is None else (of.detected, of.warnings)
    return HandCandidate(detected, hand, table, obj, holds, warnings)


def _refined_hand(seen: _Image, scene: HandCandidate, model: ObjectModel) -> HandEstimate:
    """Fit the hand to the object; return it unchanged if the object's pose is not accepted."""
    hand, obj = scene.hand, scene.object
    if not obj.accepted:
        return hand
    surroundings = HandSurroundings(model.signed_distance, obj.pose_camera_object, scene.table)
    if scene.detected is None:
        return refine_hand(hand, surroundings)
    return fit_held_hand(
        scene.detected, seen.capture, surroundings, hand.joints_camera, side=seen.side, seed=seen.seed
    )


def _warnings(
    scene: HandCandidate, refined: HandEstimate, model: ObjectModel, capture: Capture
) -> list[PerceptionWarning]:
    """Return warnings about object, refined hand, image and table."""
    found = []
    if not scene.object.accepted:
        found += scene.object.warnings
    elif (ambiguous := ambiguity(model, scene.object)) is not None:
        found.append(ambiguous)
    found += plausibility_warnings(capture, refined, scene.object, model)
    if refined.side != scene.hand.side:
        found.append(PerceptionWarning.of("side_from_depth", side=refined.side))
    if scene.table is None:
        found.append(PerceptionWarning.of("no_table"))
    return found


def _grasp(
    held: ResolvedObject, hand: HandEstimate, obj: ObjectEstimate, pose_world_camera: np.ndarray, task: str
) -> HumanGrasp:
    """Return the grasp in the world, with its object; the scene of a left hand is mirrored."""
    model, pose = held.model, in_world(pose_world_camera, obj.pose_camera_object)
    grasp = HumanGrasp(
        object_name=model.name,
        object_mass=model.mass,
        object_pose=pose,
        object_rest_pose=put_down(model, pose),
        hand_joints=transform_points(pose_world_camera, hand.joints_camera),
        link_contacts=touching_links(hand.joints_camera, model.signed_distance, obj.pose_camera_object),
        task=task,
        object_mass_spread=held.mass_spread,
        objects={model.name: model},
    )
    if hand.side == "right":
        return grasp
    mirrored = mirrored_object(model)
    return replace(
        grasp,
        object_name=mirrored.name,
        object_pose=mirror_pose(grasp.object_pose),
        object_rest_pose=mirror_pose(grasp.object_rest_pose),
        hand_joints=mirror_points(grasp.hand_joints),
        objects={mirrored.name: mirrored},
    )
