"""From one RGB-D image and the object's mesh to a human grasp, in six steps.

1. The hand in the image: landmarks (``hand.mediapipe_detector``).
2. The hand in meters: a skeleton fitted to landmarks and depth (``hand.fit``).
3. The table: the largest plane below the hand (``scene.table``).
4. The object's pose: the mesh fitted to the depth (``object_pose.estimate``).
5. The hand again, which now touches the object that it holds (``hand.fit``).
6. The grasp: links in contact, and all of it in the world frame (``scene.table``).

Each step adds its warnings; a result of low confidence is still given, marked as such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.objects import MIRRORED, ObjectModel, ResolvedObject, resolve_object
from fungrasp.perception.camera.frames import RgbdCamera
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, Side
from fungrasp.perception.hand.contact_evidence import HandSurroundings, touching_links
from fungrasp.perception.hand.detected_hand import DetectedHand, HandDetector, find_hands
from fungrasp.perception.hand.fit import fit_hand, fit_held_hand, refine_hand
from fungrasp.perception.hand.joint_confidence import joint_confidences, joint_features
from fungrasp.perception.hand.meant_hands import MeantHand, hands_elsewhere, may_hold, meant_hands, object_box
from fungrasp.perception.hand.mediapipe_detector import MediaPipeHandDetector
from fungrasp.perception.image_source import ImageSource, as_capture
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.capture_checks import check_hints
from fungrasp.perception.object_pose.confidence import ambiguity
from fungrasp.perception.object_pose.estimate import best_estimate, search_object_pose
from fungrasp.perception.object_pose.external_pose import score_given_pose
from fungrasp.perception.object_pose.known_object import known_object
from fungrasp.perception.object_pose.shape_fit import FittedShape, fit_shape
from fungrasp.perception.perceived import (
    HandCandidate,
    Perceived,
    PerceptionTrace,
    Stopwatch,
    measure_quality,
)
from fungrasp.perception.plausibility import (
    check_held,
    check_holdable,
    edge_of_hand,
    plausibility_doubt,
    plausibility_warnings,
)
from fungrasp.perception.scene.table import (
    NO_TABLE,
    guessed_table,
    in_world,
    put_down,
    table_under,
    world_from_table,
)
from fungrasp.perception.verdict import perception_verdict

if TYPE_CHECKING:
    import trimesh

    Mesh = ObjectModel | trimesh.Trimesh
    """An object's surface, with colors if they are known."""

UNKNOWN = "unknown"
"""Stands for an object without a mesh."""


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
    """The grasp in an image; ``retarget`` takes the ``grasps`` and the ``objects`` of the result.

    Args:
        capture: color and depth; its mask, box or point says where the object is. Or where they are: a
            folder (see ``read_folder``), a recording or "builtin"; paths of color image, depth and
            intrinsics; or a camera, whose image is taken when hand, table and object are seen.
        obj: the object, its mesh file [m], the name of a built-in object, or a shape, "box:60x28x30" [mm]; or
            "unknown": a box, cylinder or sphere is fitted to what is seen.
            Colors of the mesh file tell apart the sides of a nearly symmetric object.
        mass: of a mesh [kg]; None takes a built-in object's own, or guesses it from the mesh, with a note.
        side: which hand it is, if known.
        task: what the grasp is for, see ``HumanGrasp``.
        table: plane ``[nx ny nz d]``, camera frame, shape [4], unit normal upwards; looked for if None.
        hand: from another estimator, or that estimator; found in the image if None.
        object_estimate: from another estimator, or that estimator; found in the image if None. One that is
            not ``judged`` gets the score that the depth gives it, see ``score_given_pose``.
        detector: finds hands; by default MediaPipe's models, which ``fungrasp setup perception`` fetches.
        seed: the same seed gives the same answer.
        improve_pose: whether an ``object_estimate`` that is not ``judged`` is fitted to the depth nearby.

    Raises:
        FungraspError: the image or the object can't be read, there is no hand in the image, no depth at it,
            the mesh is not of a size that a hand holds, or the hand models are not set up.
    """
    if seed < 0:
        raise FungraspError(f"the seed must be 0 or more, not {seed}")
    fitted = None
    if isinstance(obj, str) and obj == UNKNOWN:
        if object_estimate is not None:
            raise FungraspError("the pose of an object without a mesh can't be given: it has no frame")
        capture = capture if isinstance(capture, Capture) else as_capture(capture, None)
        check_hints(capture)
        fitted = _fitted_shape(capture, hand, side, table, detector, seed)
        obj = fitted.name
        object_estimate = ObjectEstimate(fitted.pose, fitted.quality, fitted.fits)
    held = obj if isinstance(obj, ResolvedObject) else resolve_object(obj, mass)
    model = held.model
    mesh = model if held.colored is None else held.colored
    if not isinstance(capture, Capture):
        capture = as_capture(capture, model)
    check_hints(capture)
    hand = hand(capture) if callable(hand) else hand
    if callable(object_estimate):
        object_estimate = object_estimate(capture, mesh)
    check_holdable(model)
    given, watch = object_estimate, Stopwatch()
    if given is None or not given.judged:
        with watch.stage("mesh"):
            known_object(mesh)

    def scene_of(one: HandEstimate, meant: MeantHand | None = None) -> HandCandidate:
        return _scene(capture, mesh, one, meant, table, given, seed, improve_pose, watch)

    def scenes_of(found: Sequence[MeantHand], needed: bool = True) -> list[HandCandidate]:
        with watch.stage("hand"):
            measured = _fitted_hands(found, capture, needed)
        return [scene_of(one, meant) for meant, one in measured]

    # 1, 2: the hand in the image and in meters. Where it is open which of two hands is meant, both go on.
    # 3, 4: the table and the object; the hand that holds the object more probably is the one.
    detected: list[DetectedHand] = []
    if hand is not None:
        scenes = [scene_of(hand)]
    else:
        detector = detector or MediaPipeHandDetector()
        with watch.stage("detection"):
            near = object_box(capture, model, given)
            detected = find_hands(detector, capture, near)
        scenes = scenes_of(meant_hands(capture, detected, near, side, detector))
        if not any(scene.holds for scene in scenes):
            # The one that holds it may be harder to see than somebody else's.
            known = [scene.detected for scene in scenes if scene.detected is not None]
            with watch.stage("detection"):
                others = hands_elsewhere(capture, known, side, detector)
            scenes += scenes_of(others, needed=False)
    chosen = max(range(len(scenes)), key=lambda i: (scenes[i].holds, scenes[i].worth))
    scene = scenes[chosen]
    check_held(scene, model, told=object_box(capture, model, given) is not None)
    # 5: the hand again, touching the object.
    with watch.stage("refinement"):
        refined = _refined_hand(scene, capture, model, side, seed)
        of_joints = joint_features(capture, scene.hand, refined, scene.object.accepted)
        confidence = joint_confidences(of_joints, edge_of_hand(capture, refined) is not None)
        refined = replace(refined, confidence=confidence)
    # 6: the grasp in the world.
    with watch.stage("grasp"):
        plane = scene.table
        if plane is None:
            surface = transform_points(scene.object.pose_camera_object, model.vertices)
            plane = guessed_table(np.concatenate([surface, refined.joints_camera]))
        center = transform_points(scene.object.pose_camera_object, model.center_of_mass[None])[0]
        pose_world_camera = world_from_table(plane, center)
        grasp = _grasp(held, refined, scene.object, pose_world_camera, task)
        quality = measure_quality(capture, refined, scene.object, model.signed_distance)
        warnings = (*capture.warnings, *scene.warnings, *_warnings(scene, refined, model, capture))
    return Perceived(
        capture=capture,
        object_model=model,
        grasp=grasp,
        pose_world_camera=pose_world_camera,
        hand=refined,
        object=scene.object,
        table=plane,
        table_found=scene.table is not None,
        quality=quality,
        warnings=warnings,
        verdict=perception_verdict(
            scene.object,
            refined,
            "" if fitted is None else fitted.name,
            plausibility_doubt(scene, warnings, fitted),
            given is not None,
        ),
        notes=held.notes,
        mass_range=held.mass_range,
        fitted=fitted,
        trace=PerceptionTrace(tuple(detected), tuple(scenes), chosen, watch.seconds),
    )


def _fitted_shape(
    capture: Capture,
    hand: HandEstimate | Callable[[Capture], HandEstimate] | None,
    side: Side | None,
    table: np.ndarray | None,
    detector: HandDetector | None,
    seed: int,
) -> FittedShape:
    """The shape of an object without a mesh, in the hand for which it explains most of what is seen."""
    if hand is not None:
        held_by = [hand(capture) if callable(hand) else hand]
    else:
        detector, near = detector or MediaPipeHandDetector(), object_box(capture, None, None)
        meant = meant_hands(capture, find_hands(detector, capture, near), near, side, detector)
        held_by = [one for _, one in _fitted_hands(meant, capture)]
    shapes, problem = [], None
    for one in held_by:
        under = (
            table
            if table is not None
            else table_under(capture, one.joints_camera, np.random.default_rng(seed))
        )
        try:
            shapes.append(fit_shape(capture, one.joints_camera, under, seed=seed))
        except FungraspError as error:
            problem = error
    if not shapes:
        assert problem is not None
        raise problem
    return max(shapes, key=lambda shape: shape.quality)


def _fitted_hands(
    found: Sequence[MeantHand], capture: Capture, needed: bool = True
) -> list[tuple[MeantHand, HandEstimate]]:
    """Each hand in meters, without those that have no depth, as of somebody far away.

    Raises:
        FungraspError: none has, and one is needed.
    """
    measured, problem = [], None
    for meant in found:
        try:
            measured.append((meant, fit_hand(meant.detected, capture)))
        except FungraspError as error:
            problem = error
    if needed and problem is not None and not measured:
        raise problem
    return measured


def _scene(
    capture: Capture,
    mesh: Mesh,
    hand: HandEstimate,
    meant: MeantHand | None,
    table: np.ndarray | None,
    given: ObjectEstimate | None,
    seed: int,
    improve: bool,
    watch: Stopwatch,
) -> HandCandidate:
    """The table under a hand and the object in it, unless they are known."""
    thing, answers = given, None
    if table is None:
        with watch.stage("table"):
            table = table_under(capture, hand.joints_camera, np.random.default_rng(seed))
    under = NO_TABLE if table is None else table
    with watch.stage("object"):
        if thing is None:
            answers = search_object_pose(capture, mesh, hand, under, seed=seed)
            thing = best_estimate(answers)
        elif not thing.judged:
            thing = score_given_pose(thing, capture, mesh, hand, under, seed=seed, improve=improve)
    if table is None and thing.accepted:
        # The object tells as well what is below it.
        with watch.stage("table"):
            surface = transform_points(thing.pose_camera_object, np.asarray(mesh.vertices))
            table = table_under(capture, surface, np.random.default_rng(seed))
    holds = may_hold(hand, thing, np.asarray(mesh.vertices))
    if meant is None:
        return HandCandidate(None, hand, table, thing, answers, holds)
    return HandCandidate(meant.detected, hand, table, thing, answers, holds, meant.warnings)


def _refined_hand(
    scene: HandCandidate, capture: Capture, model: ObjectModel, side: Side | None, seed: int
) -> HandEstimate:
    """The hand, touching the object; unchanged where the object's pose is not accepted."""
    hand, thing = scene.hand, scene.object
    if not thing.accepted:
        return hand
    surroundings = HandSurroundings(model.signed_distance, thing.pose_camera_object, scene.table)
    if scene.detected is None:
        return refine_hand(hand, surroundings)
    return fit_held_hand(scene.detected, capture, surroundings, hand.joints_camera, side=side, seed=seed)


def _warnings(
    scene: HandCandidate, refined: HandEstimate, model: ObjectModel, capture: Capture
) -> list[PerceptionWarning]:
    """What is uncertain about object, refined hand, image and table."""
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
    held: ResolvedObject,
    hand: HandEstimate,
    thing: ObjectEstimate,
    pose_world_camera: np.ndarray,
    task: str,
) -> HumanGrasp:
    model, pose = held.model, in_world(pose_world_camera, thing.pose_camera_object)
    grasp = HumanGrasp(
        object_name=model.name,
        object_mass=model.mass,
        object_pose=pose,
        object_rest_pose=put_down(model, pose),
        hand_joints=transform_points(pose_world_camera, hand.joints_camera),
        link_contacts=touching_links(hand.joints_camera, model.signed_distance, thing.pose_camera_object),
        task=task,
        object_mass_spread=held.mass_spread,
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
