"""Synthesis of human grasps from specifications: the solver of retargeting, applied to the human hand with
contact targets on named parts of the object.

from fungrasp.synthesis import GraspSpecification, synthesize_grasps

spec = GraspSpecification("can", "drink", "body", "wrap", at=(0, 0, 0), palm=(0, 1, 0), fingers=(1, 0, 0))
grasps = synthesize_grasps([spec], seed=0)
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job
from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, load_object
from fungrasp.objects.object_model import GRAVITY
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem
from fungrasp.optimization.terms import Term
from fungrasp.synthesis.grasp_candidates import (
    HAND,
    GraspCandidates,
    check_candidates,
    choose_grasps,
    join_candidates,
)
from fungrasp.synthesis.grasp_specification import GRASP_KINDS, GraspSpecification
from fungrasp.synthesis.human_hand_terms import (
    HumanPoints,
    PartTargets,
    natural_posture,
    part_gap,
    part_samples,
    place_error,
)

BATCH_SIZE = 12
"""Number of specifications solved together."""

CONTACT_TOLERANCE = 0.001
"""Penetration at which the closing hand stops [m]; the solver removes it."""

FARTHEST, DEEPEST, STEP = 0.15, 0.05, 0.002
"""The hand approaches from ``FARTHEST`` before the held point to at most ``DEEPEST`` beyond it, in steps of
``STEP`` [m]."""


@dataclass(frozen=True)
class SynthesisSettings:
    """Random starts, scales of the cost terms, and criteria of good grasps."""

    starts: int = 5
    """Candidates per specification: the first starts as specified, the others shifted and turned at
    random."""
    shift: float = 0.006
    """Standard deviation of the random shifts of the wrist [m]."""
    turn: float = 0.12
    """Standard deviation of the random rotations of the wrist [rad]."""
    gap_unit: float = 0.0015
    """Distance of a link from its part that counts as one unit [m]."""
    place_unit: float = 0.006
    """Distance of a link from its specified place that counts as one unit [m]."""
    object_unit: float = 0.0006
    """Penetration of the object that counts as one unit [m]."""
    table_unit: float = 0.0006
    """Penetration of the table that counts as one unit [m]."""
    table_margin: float = 0.0015
    """Distance to keep from the table [m]."""
    self_unit: float = 0.001
    """Self-penetration of the hand that counts as one unit [m]."""
    closure_unit: float = 0.06
    """Unbalanced part of contact forces with a sum of one that counts as one unit [-]."""
    wrist_unit: float = 0.02
    """Distance of the wrist from its start that counts as one unit [m]."""
    wrist_turn_unit: float = 0.3
    """Turn of the wrist from its start that counts as one unit [rad]."""
    first_iterations: int = 20
    """Solver iterations with units four times as large (twice for places)."""
    second_iterations: int = 40
    """Solver iterations with the units above and force closure."""
    max_penetration: float = 0.002
    """Largest penetration of the object, and self-penetration of the hand [m]."""
    max_cost: float = 25.0
    """Largest objective of a grasp that looks natural."""
    min_difference: float = 0.006
    """Smallest mean joint distance between grasps of one object [m]."""


def synthesize_grasps(
    specs: Sequence[GraspSpecification],
    seed: int | Sequence[int] = 0,
    settings: SynthesisSettings | None = None,
    objects: Mapping[str, ObjectModel] | None = None,
    *,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> HumanGraspSet:
    """Synthesize human grasps of objects at rest on the table. Specifications without a solution are skipped.

    Every grasp has the human hand's bone lengths, joints within limits, at most 2 mm of penetration, nothing
    below the table, and its links on their parts. No two grasps are alike, whatever their seeds.

    Args:
        specs: specifications. Grasps keep their order, all of the first seed before those of the next.
        seed: seed of the random starts, or several seeds: each specification is solved with each.
        settings: defaults if None.
        objects: by name; built-in objects may be missing.
        store: keeps finished parts, so that an interrupted run can continue; the caller removes it.
        ray: cluster to run on. The result is the same.
        progress: called with the finished share, 0 to 1.

    Raises:
        FungraspError: an object or part is unknown, no specification has a solution, or a part can't be
            written.
    """
    seeds = (seed,) if isinstance(seed, int) else tuple(seed)
    models, settings = specified_objects(specs, objects), settings or SynthesisSettings()
    job = Synthesis(tuple(specs), models, settings, seeds)
    batches = [GraspCandidates(**arrays) for arrays in run_job(job, store, ray=ray, progress=progress)]
    candidates = join_candidates(batches, [len(part.specifications) for part in job.parts()])
    goals = settings.max_penetration, settings.max_cost, settings.min_difference
    return choose_grasps(candidates, job.specifications * len(seeds), models, *goals)


@dataclass(frozen=True)
class SpecificationBatch:
    """Specifications that are solved together. Batches are independent of each other."""

    seed: int
    """Seed of the random starts."""
    specifications: tuple[GraspSpecification, ...]
    """At most ``BATCH_SIZE`` specifications."""


@dataclass(frozen=True, eq=False)
class Synthesis(Job[SpecificationBatch]):
    """A synthesis job; its parts are batches of specifications."""

    specifications: tuple[GraspSpecification, ...]
    """Specifications to solve."""
    objects: Mapping[str, ObjectModel]
    """Objects by name."""
    settings: SynthesisSettings
    """Settings of the solver, and criteria of good grasps."""
    seeds: tuple[int, ...]
    """Seeds; each specification is solved with each."""

    def parts(self) -> list[SpecificationBatch]:
        """Return the batches of all seeds."""
        count, specs = len(self.specifications), self.specifications
        batches = [specs[start : start + BATCH_SIZE] for start in range(0, count, BATCH_SIZE)]
        return [SpecificationBatch(seed, batch) for seed in self.seeds for batch in batches]

    def key(self, part: SpecificationBatch) -> str:
        """Return a digest of everything that the candidates depend on."""
        objects = {spec.object: self.objects[spec.object] for spec in part.specifications}
        return part_key("synthesis", load_hand(HAND), objects, self.settings, part)

    def size(self, part: SpecificationBatch) -> float:
        """Return the number of specifications."""
        return len(part.specifications)

    def run(self, parts: Sequence[SpecificationBatch], progress: Callable[[float], None]) -> list[Arrays]:
        """Return the fields of each part's good ``GraspCandidates``."""
        s, results = self.settings, []
        for part in parts:
            found = solve_batch(part.specifications, self.objects, part.seed, s)
            good = found.good(s.max_penetration, s.max_cost)
            results.append({f.name: getattr(found, f.name)[good] for f in fields(GraspCandidates)})
        return results


def specified_objects(
    specs: Sequence[GraspSpecification], known: Mapping[str, ObjectModel] | None = None
) -> dict[str, ObjectModel]:
    """Return the specifications' objects by name, and check that they have the parts.

    Args:
        known: objects by name; built-in objects may be missing.

    Raises:
        FungraspError: an object or part does not exist.
    """
    known = known or {}
    names = dict.fromkeys(spec.object for spec in specs)
    objects = {name: known[name] if name in known else load_object(name) for name in names}
    for spec in specs:
        for part in spec.all_parts:
            part_samples(objects[spec.object], part)
    return objects


def solve_batch(
    specs: Sequence[GraspSpecification],
    objects: Mapping[str, ObjectModel],
    seed: int,
    settings: SynthesisSettings,
) -> GraspCandidates:
    """Solve a few specifications together, and return their candidates."""
    owner = np.repeat(np.arange(len(specs)), settings.starts)
    each = [spec for spec in specs for _ in range(settings.starts)]
    hand = load_hand(HAND)
    points = HumanPoints(HandKinematics(hand, len(each)))
    names = [spec.object for spec in each]
    rest = np.array([spec.rest_pose(objects[spec.object]) for spec in each])
    scene = CollisionScene.settled(names, rest, objects)
    offsets = random_offsets(specs, seed, settings.starts, settings.shift, settings.turn)
    pose = approach_until_contact(points, scene, each, specified_wrist_pose(each, offsets))
    independent = close_until_contact(points, scene, each, pose)
    targets = PartTargets.from_specifications(each, objects)
    problem = _problem(points, scene, each, objects, pose, independent)
    wrist = partial(
        terms.stay_near,
        start=(pose, independent),
        unit=np.inf,
        position_unit=settings.wrist_unit,
        rotation_unit=settings.wrist_turn_unit,
    )
    table = partial(terms.table_penetration, margin=settings.table_margin)

    def objective(factor: float, *more: Term) -> list[Term]:
        """Return the terms. ``factor`` scales the units of contact and penetration; its root those of
        places."""
        specified = [
            partial(natural_posture, kinds=[spec.kind for spec in each]),
            partial(part_gap, targets=targets, unit=factor * settings.gap_unit),
            partial(place_error, targets=targets, unit=factor**0.5 * settings.place_unit),
        ]
        return [
            wrist,
            partial(terms.object_penetration, unit=factor * settings.object_unit),
            partial(table, unit=factor * settings.table_unit),
            partial(terms.self_penetration, unit=factor * settings.self_unit),
            *more,
            terms.residual_terms(specified),
        ]

    first, second = settings.first_iterations, settings.second_iterations
    pose, independent, _ = minimize(points, problem, objective(4.0), pose, independent, first)
    closure = partial(terms.force_closure, unit=settings.closure_unit)
    pose, independent, cost = minimize(points, problem, objective(1.0, closure), pose, independent, second)
    return check_candidates(scene, each, owner, objects, (pose, independent, cost))


def _problem(
    points: HumanPoints,
    scene: CollisionScene,
    specs: Sequence[GraspSpecification],
    objects: Mapping[str, ObjectModel],
    pose: np.ndarray,
    independent: np.ndarray,
) -> RetargetingProblem:
    """Make a retargeting problem: target links of the specifications, human hand at its start."""
    contacts = np.array([[link in spec.links for link in HUMAN_LINKS] for spec in specs])
    joints = HandState(points, scene, pose, independent).keypoints
    nowhere = np.zeros((len(specs), len(points.match.far), 3))
    return RetargetingProblem(
        **{f.name: getattr(scene, f.name) for f in fields(scene)},
        joints=joints,
        contacts=contacts,
        surface=nowhere,
        normals=nowhere,
        center=np.array([objects[spec.object].center_of_mass for spec in specs]),
        extent=np.array([0.5 * np.linalg.norm(objects[spec.object].size) for spec in specs]),
        weight=GRAVITY * np.array([objects[spec.object].mass for spec in specs]),
    )


def random_offsets(
    specs: Sequence[GraspSpecification], seed: int, starts: int, shift: float, turn: float
) -> np.ndarray:
    """Return shift [m] and turn [rad] of the wrist at each start, zero for the first start of a
    specification.

    Args:
        specs: each gets ``starts`` candidates, in consecutive rows.
        seed: random seed. The offsets depend only on it and the specification.
        shift, turn: standard deviations [m], [rad].

    Returns:
        shape [N, 6], N = len(specs) * starts.
    """
    result = []
    for spec in specs:
        # The class's former name: the built-in grasps were made with these random numbers.
        text = repr(spec).replace(type(spec).__name__, "GraspWish", 1)
        random = np.random.default_rng([seed, zlib.crc32(text.encode())])
        offsets = random.normal(size=(starts, 6)) * np.repeat([shift, turn], 3)
        offsets[0] = 0.0
        result.append(offsets)
    return np.concatenate(result)


def specified_wrist_pose(specs: Sequence[GraspSpecification], offsets: np.ndarray) -> np.ndarray:
    """Return wrist poses that put the center of the grasp kind at the held point, object frame, shape [N, 7].

    Args:
        specs: one per candidate, length N.
        offsets: result of ``random_offsets``, shape [N, 6].
    """
    x = np.array([spec.palm for spec in specs], dtype=float)
    z = np.array([spec.fingers for spec in specs], dtype=float)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z -= np.sum(z * x, axis=1, keepdims=True) * x
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    # Columns are the palm's axes in the object frame: out of the palm, to the thumb's side, to the fingers.
    matrix = np.stack([x, np.cross(z, x), z], axis=-1)
    center = np.array([GRASP_KINDS[spec.kind].center for spec in specs])
    place = np.array([spec.at for spec in specs], dtype=float)
    rotation = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    rotation = quaternion_multiply(quaternion_from_rotation_vector(offsets[:, 3:]), rotation)
    turned = Rotation.from_quat(rotation, scalar_first=True).apply(center)
    return np.concatenate([place + offsets[:, :3] - turned, rotation], axis=1)


def approach_until_contact(
    points: HumanPoints, scene: CollisionScene, specs: Sequence[GraspSpecification], pose: np.ndarray
) -> np.ndarray:
    """Move wrist poses along the palm's direction until the palm touches; return them, shape [N, 7].

    For kinds that do not use the palm, stop when the held point is between the fingers.
    """
    into = Rotation.from_quat(pose[:, 3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    deepest = np.array([DEEPEST if GRASP_KINDS[spec.kind].palm else 0.0 for spec in specs])
    base = np.isin(
        points.spheres.link, [0, *(i for i, name in enumerate(HUMAN_LINKS) if name.endswith("proximal"))]
    )
    opened = np.array([GRASP_KINDS[spec.kind].open for spec in specs])
    depth, free = np.full(len(pose), -FARTHEST), np.ones(len(pose), dtype=bool)
    for step in np.arange(-FARTHEST, DEEPEST + STEP / 2, STEP):
        moved = pose.copy()
        moved[:, :3] += step * into
        state = HandState(points, scene, moved, opened)
        clear = np.minimum(state.clearance, state.heights)[:, base].min(axis=1)
        free &= (clear > -CONTACT_TOLERANCE) & (step <= deepest + 1e-9)
        depth[free] = step
    result = pose.copy()
    result[:, :3] += depth[:, None] * into
    return result


def close_until_contact(
    points: HumanPoints, scene: CollisionScene, specs: Sequence[GraspSpecification], pose: np.ndarray
) -> np.ndarray:
    """Close each finger until it touches object or table; return the joints [rad], shape [N, 21]."""
    opened = np.array([GRASP_KINDS[spec.kind].open for spec in specs])
    closed = np.array([GRASP_KINDS[spec.kind].closed for spec in specs])
    finger_of_joint = np.repeat(np.arange(5), [4, 4, 4, 4, 5])
    finger_of_sphere = np.where(points.spheres.link > 0, (points.spheres.link - 1) // 3, -1)
    share, free = np.zeros((len(specs), 5)), np.ones((len(specs), 5), dtype=bool)
    for step in np.linspace(0.0, 1.0, 21):
        state = HandState(points, scene, pose, opened + step * (closed - opened))
        clear = np.minimum(state.clearance, state.heights)
        for finger in range(5):
            free[:, finger] &= clear[:, finger_of_sphere == finger].min(axis=1) > -CONTACT_TOLERANCE
        share[free] = step
    return opened + share[:, finger_of_joint] * (closed - opened)
