"""Grasps that hold in simulation: variations of a grasp are tried in the lift test and the best is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import MotionPlanner
from fungrasp.planning.selection.variations import VariationSpread, vary, with_settings
from fungrasp.simulation import Scene, build_scene
from fungrasp.task import LiftEnvironment, Outcomes, Policy, play

ROUND = 3
"""Variations tried at once for a grasp that has not succeeded yet."""


def refine_grasps(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    policy: Policy,
    *,
    tries: int,
    seed: int = 0,
    threads: int = 0,
    spread: VariationSpread | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> RobotGraspSet:
    """Try variations of each grasp in the lift test until one succeeds; keep the best.

    Variations change wrist, fingers, squeeze and the last press of the wrist. Half of them start from the
    grasp, half from the best variation so far. The result for a grasp depends on the seed and its index
    alone.

    Args:
        grasps: N grasps of ``hand``.
        objects: by name.
        hand: the robot hand.
        policy: what follows the plans.
        tries: most episodes per grasp, the unchanged grasp included.
        seed: of the random numbers.
        threads: 0 means all processors.
        spread: of the variations; the default if None.
        progress: called with the number of grasps that are finished.

    Returns:
        N grasps; ``extra`` has the controller's settings of each (``MotionPlanner``) and
        ``refined_tries``, the number of episodes it took, negative where none succeeded.
    """
    spread = spread or VariationSpread()
    scene = build_scene(hand, objects)
    best = with_settings(grasps)
    score = np.full(len(grasps), -np.inf)
    used = np.zeros(len(grasps), dtype=int)
    solved = np.zeros(len(grasps), dtype=bool)
    done = 0
    while done < tries and not solved.all():
        rows = np.flatnonzero(~solved)
        number = 1 if done == 0 else min(ROUND, tries - done)
        indices = np.repeat(rows, number)
        proposals = best.select(indices)
        if done:
            attempt = np.tile(np.arange(number), len(rows))
            start = with_settings(grasps).select(indices)
            proposals = vary(
                _where((attempt + done) % 2 == 0, start, proposals),
                hand,
                indices,
                done + attempt,
                seed,
                spread,
            )
        outcomes = _try(scene, proposals, objects, policy, threads)
        value = _score(outcomes).reshape(len(rows), number)
        winner = np.argmax(value, axis=1) + number * np.arange(len(rows))
        better = np.flatnonzero(value.max(axis=1) > score[rows])
        best = _put(best, rows[better], proposals.select(winner[better]))
        score[rows] = np.maximum(score[rows], value.max(axis=1))
        used[rows] += number
        solved[rows] |= outcomes.success.reshape(len(rows), number).any(axis=1)
        done += number
        progress(int(solved[rows].sum()))
    progress(int((~solved).sum()))
    return replace(
        best,
        keypoints=_keypoints(best, hand),
        extra={**best.extra, "refined_tries": np.where(solved, used, -used)},
    )


def _try(
    scene: Scene,
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    policy: Policy,
    threads: int,
    chunk: int = 256,
) -> Outcomes:
    planner = MotionPlanner(scene.hand, objects)
    results = []
    for start in range(0, len(grasps), chunk):
        part = grasps.select(np.arange(start, min(start + chunk, len(grasps))))
        environment = LiftEnvironment(scene, len(part), threads=threads)
        results.append(play(environment, policy, planner.plan(part, environment.settle(part))))
    return Outcomes.join(results)


def _score(outcomes: Outcomes) -> np.ndarray:
    lifted = np.clip(np.nan_to_num(outcomes.lifted_height_m, posinf=0.0), -0.1, 0.1)
    return (
        10.0 * outcomes.success
        + outcomes.contact_ratio
        + 10.0 * lifted
        - 0.01 * outcomes.sim_distance_hand_mm_s.clip(0, 50)
    )


def _keypoints(grasps: RobotGraspSet, hand: Hand) -> np.ndarray:
    in_object = compose(invert(grasps.object_pose), grasps.wrist_pose)
    points = HandKinematics(hand, len(grasps)).keypoints(in_object, grasps.joint_positions)
    return transform_points(grasps.object_pose, points)


def _where(condition: np.ndarray, a: RobotGraspSet, b: RobotGraspSet) -> RobotGraspSet:
    return _put(b, np.flatnonzero(condition), a.select(np.flatnonzero(condition)))


def _put(into: RobotGraspSet, rows: np.ndarray, values: RobotGraspSet) -> RobotGraspSet:
    """``into`` with the wrist, joints and settings of some rows replaced."""
    wrist, joints = into.wrist_pose.copy(), into.joint_positions.copy()
    extra = {name: value.copy() for name, value in into.extra.items()}
    wrist[rows], joints[rows] = values.wrist_pose, values.joint_positions
    for name in extra:
        extra[name][rows] = values.extra[name]
    return replace(into, wrist_pose=wrist, joint_positions=joints, extra=extra)
