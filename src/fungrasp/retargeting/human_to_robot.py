"""Retargeting of human grasps to robot hands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Self, overload

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job
from fungrasp.core.parallel import in_chunks
from fungrasp.core.progress import ShowProgress, shown_progress
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import HumanGrasp, HumanGraspSet, RobotGrasp, RobotGraspSet, hand_sides
from fungrasp.grasps.diagnosis import checked_grasps
from fungrasp.grasps.grasp_arguments import HasGrasps, HumanGrasps, Objects, as_human_grasps, load_objects
from fungrasp.grasps.robot_grasp import MASS_SPREAD
from fungrasp.hands import Hand, as_hand, hand_origin
from fungrasp.hands.hand_registry import check_no_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.retargeting.angle_copy import retarget_by_angle_copy
from fungrasp.retargeting.contact_optimization import retarget_by_contact_optimization
from fungrasp.retargeting.dexgraspnet import retarget_by_dexgraspnet
from fungrasp.retargeting.settings import RetargetSettings, RetargetSpec

Solver = Callable[[HandPoints, RetargetingProblem, RetargetSettings], tuple[np.ndarray, np.ndarray]]
SOLVERS: dict[str, Solver] = {
    "contact": retarget_by_contact_optimization,
    "angle-copy": retarget_by_angle_copy,
    "dexgraspnet": retarget_by_dexgraspnet,
}

GRASPS_PER_PART = 128
"""Grasps per part, which is one file and one cluster job: some seconds of work."""

BATCH = 8
"""Parts solved together in one process, to keep all threads busy."""

CHUNK = 64
"""Grasps that one thread solves together."""


@overload
def retarget(
    human: HumanGrasp,
    objects: Objects = None,
    hand: Hand | str | Path = RetargetSpec.hand,
    method: str = RetargetSpec.method,
    settings: RetargetSettings | None = None,
    *,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: ShowProgress = None,
) -> RobotGrasp: ...
@overload
def retarget(
    human: HumanGraspSet | HasGrasps,
    objects: Objects = None,
    hand: Hand | str | Path = RetargetSpec.hand,
    method: str = RetargetSpec.method,
    settings: RetargetSettings | None = None,
    *,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: ShowProgress = None,
) -> RobotGraspSet: ...
def retarget(
    human: HumanGrasps,
    objects: Objects = None,
    hand: Hand | str | Path = RetargetSpec.hand,
    method: str = RetargetSpec.method,
    settings: RetargetSettings | None = None,
    *,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: ShowProgress = None,
) -> RobotGraspSet | RobotGrasp:
    """Retarget human grasps to a robot hand.

    Args:
        human: N human grasps, a single one, or the result of ``perceive``.
        objects: models by name, or a folder of meshes. None: the objects of the grasps, or built-in objects.
        hand: robot hand, its name, or the path of its TOML file.
        method: one of ``settings.METHODS``.
        settings: weights and iterations; defaults if None.
        threads: 0 for all processors. Results do not depend on it.
        store: keeps finished parts, so that an interrupted run can continue; the caller removes it.
        ray: cluster to run on. The result is the same.
        progress: called with the finished share, 0 to 1. True or False: a progress bar or none. None: a bar
            in terminals and notebooks.

    Returns:
        Robot grasps with their hand (``RobotGraspSet.load_hand``) and objects; a single grasp for a single
        human grasp.

    Raises:
        FungraspError: hand or method is unknown, there are no grasps, an object is missing, or hand and
            grasps are of different sides.
    """
    single = isinstance(human, HumanGrasp)
    human = as_human_grasps(human)
    check_no_hand(objects)
    hand = as_hand(hand)
    origin = hand_origin(hand)
    spec = RetargetSpec(origin or hand.name, method, RetargetSettings.given(settings))
    _check(human, hand)
    known = load_objects(human, objects)
    human = checked_grasps(vars(human), known, "retarget", read=True)
    used = {name: known[name] for name in np.unique(human.object_name).tolist()}
    for model in used.values():
        _ = model.signed_distance  # once, not in each worker
    with shown_progress(progress, f"retargeting to {hand.name}", 1.0) as show:
        found = run_job(Retargeting(human, used, hand, spec, threads), store, ray=ray, progress=show)
    whole = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    robot = RobotGraspSet(
        hand=hand.name,
        hand_file=origin,
        object_name=human.object_name,
        object_mass=human.object_mass,
        object_pose=human.object_pose,
        object_rest_pose=human.object_rest_pose,
        joint_names=hand.joint_names,
        task=human.task,
        **whole,
        extra={} if human.object_mass_spread is None else {MASS_SPREAD: human.object_mass_spread},
        objects=used,
    )
    return robot[0] if single else robot


@dataclass(frozen=True, eq=False)
class Retargeting(Job[range]):
    """A retargeting job; its parts are ranges of rows."""

    human: HumanGraspSet
    """N human grasps."""
    objects: Mapping[str, ObjectModel]
    """Objects by name."""
    hand: Hand
    """Robot hand."""
    spec: RetargetSpec
    """Method and settings."""
    threads: int = 0
    """Number of threads, 0 for all processors."""

    def parts(self) -> list[range]:
        """Return ranges of at most ``GRASPS_PER_PART`` grasps."""
        count = len(self.human)
        return [range(i, min(i + GRASPS_PER_PART, count)) for i in range(0, count, GRASPS_PER_PART)]

    def key(self, part: range) -> str:
        """Return a digest of grasps, objects, hand and method."""
        some = self.human.select(np.array(part))
        objects = {name: self.objects[name] for name in np.unique(some.object_name).tolist()}
        return part_key("retarget", some, objects, self.hand, self.spec.method, self.spec.settings)

    def size(self, part: range) -> float:
        """Return the number of grasps."""
        return len(part)

    def together(self, missing: list[range]) -> list[list[range]]:
        """Group ``BATCH`` parts."""
        return [missing[i : i + BATCH] for i in range(0, len(missing), BATCH)]

    def on_one_processor(self) -> Self:
        """Return the job with one thread."""
        return replace(self, threads=1)

    def run(self, parts: Sequence[range], progress: Callable[[float], None]) -> list[Arrays]:
        """Return wrist pose (world frame), joints, key points and contacts of each part's grasps, by the
        names of ``RobotGraspSet``."""
        human = self.human.select(np.concatenate([np.array(part) for part in parts]))
        solve, settings = SOLVERS[self.spec.method], self.spec.settings
        shared = HandPoints(HandKinematics(self.hand, min(CHUNK, len(human))))
        _ = shared.dense  # once, not in each thread
        problem = RetargetingProblem.from_grasps(human, self.objects, shared.match)
        done, lock = 0, Lock()

        def run(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            nonlocal done
            part = problem.rows(rows)
            points = shared.for_hands(len(part))
            kinematics = points.kinematics
            pose, independent = solve(points, part, settings)
            kinematics.update(pose, independent)
            with lock:
                done += len(part)
                progress(done)
            joints = independent @ kinematics.matrix.T + kinematics.offset
            return pose, joints, kinematics.points(points.keypoints)

        chunks = in_chunks(run, len(human), self.threads, CHUNK)
        pose, joints, keypoints = (np.concatenate(x) for x in zip(*chunks, strict=True))
        whole = {
            "wrist_pose": compose(human.object_pose, pose),
            "joint_positions": joints,
            "keypoints": transform_points(human.object_pose, keypoints),
            "link_contacts": problem.contacts,
            "shown_places": problem.surface,
            "shown_normals": problem.normals,
        }
        ends = np.cumsum([len(part) for part in parts])[:-1]
        split = {name: np.split(values, ends) for name, values in whole.items()}
        return [{name: values[i] for name, values in split.items()} for i in range(len(parts))]


def _check(human: HumanGraspSet, hand: Hand) -> None:
    """
    Raises:
        FungraspError: there are no grasps, or some are of the other side.
    """
    if not len(human):
        raise FungraspError("there are no grasps to retarget: the set is empty")
    other = np.flatnonzero(hand_sides(human.hand_joints) != hand.side)
    if len(other):
        raise FungraspError(
            f"'{hand.name}' is a {hand.side} hand, but {len(other)} of {len(human)} grasps are of the other "
            f"hand (row {other[0]}, {human.object_name[other[0]]}); mirror the grasps and their objects: "
            "--mirror, or fungrasp.grasps.mirrored_grasps"
        )
