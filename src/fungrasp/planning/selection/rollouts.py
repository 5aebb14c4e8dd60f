"""Rollouts of plans in randomized simulated worlds. Plans that hold in most of them are selected."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel, with_sizes
from fungrasp.planning.approach_path import BLOCKED
from fungrasp.planning.selection.candidates import Candidates
from fungrasp.planning.selection.settings import RolloutSettings
from fungrasp.sim2real import (
    NOMINAL,
    EpisodeSample,
    MeasurementError,
    Randomization,
    draw,
    random_stream,
)
from fungrasp.simulation import Scene, SceneSettings, build_scene
from fungrasp.task import DIVERGED, Belief, GraspPlan, LiftEnvironment, LiftProtocol, Policy, play
from fungrasp.task.use import LARGEST_SHIFT, LARGEST_TURN, load_use_motions, motion_of, play_use

_log = logging.getLogger(__name__)

NEARLY_WITHSTOOD = 0.65
"""Largest value of a rollout that passes the lift test but fails the use test. It guides the search and is
far below the value of a confirmed plan."""

WITHSTOOD = 0.9
"""Smallest value of a rollout that passes the use test; the value grows as the object moves less."""

LARGEST_SLIP = 10.0
"""Slip at which the penalty saturates [mm/s]."""


WHOLE = 10_000
"""More control steps than any motion has."""

MOST = 2.0
"""Bound of sampled mass errors in standard deviations, to exclude extreme masses such as a box full of
lead."""


@dataclass(frozen=True, eq=False, repr=False)
class RolloutResults(BatchRecord):
    """Outcomes of R rollouts."""

    success: np.ndarray
    """Whether the object was held, or a value in [0, 1] with use motions, shape [R]."""
    as_shown: np.ndarray
    """Success of rollouts that held the object as shown, zero for others, shape [R]; equal to success if the
    person's contacts are unknown."""
    shown_share: np.ndarray
    """Share of the target links that touch as shown, shape [R]; zero for lost objects and for unknown
    contacts."""
    contact_ratio: np.ndarray
    """Share of the target links in contact during the hold; zero for lost objects, shape [R]."""
    slip: np.ndarray
    """Displacement in the hand during the hold [mm/s]; zero for lost objects, shape [R]."""


class RolloutTrials:
    """Runs the rollouts of a search. All candidates get the same random parameters in the same order, so the
    result of a grasp does not depend on the other grasps."""

    def __init__(
        self,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        policy: Policy,
        settings: RolloutSettings,
        beliefs: Belief,
        object_names: Sequence[str],
        number: int,
        seed: Sequence[int],
        threads: int = 0,
    ):
        """
        Args:
            beliefs: G rows.
            object_names: names of their objects, length G.
            number: largest number of rollouts of a candidate.
            threads: 0 for all processors.
        """
        self._beliefs, self._policy, self._threads, self.settings = beliefs, policy, threads, settings
        self._whole = replace(
            settings,
            randomization=settings.rehearsed,
            timestep=SceneSettings.timestep,
            hold_time=LiftProtocol.hold_time,
            early=WHOLE,
        )
        self._scene, self._true_scene = (
            _scene(object_names, objects, hand, s) for s in (settings, self._whole)
        )
        self._samples = [
            draw(drawn, number, len(hand.joint_names), random_stream("rollouts", *seed))
            for drawn in (settings.randomization, settings.rehearsed)
        ]
        self._pose_errors = random_stream("believed pose errors", *seed).normal(size=(number, 6))
        self._mass_errors = random_stream("believed mass errors", *seed).normal(size=number)

    def __call__(
        self, candidates: Candidates, grasps: np.ndarray, chosen: np.ndarray, which: np.ndarray
    ) -> None:
        """Run one more rollout each of R candidates and add it to their tally.

        Args:
            candidates: candidates of S grasps.
            grasps: indices of these grasps in the beliefs, shape [S].
            chosen, which: candidate and grasp (index into S) of each rollout, shape [R]; pairs are unique.
        """
        s, number = self.settings, candidates.tally.tried[chosen, which].astype(int)
        whole = number % s.rehearsal == s.rehearsal - 1
        for some, kind, scene in ((~whole, s, self._scene), (whole, self._whole, self._true_scene)):
            if some.any():
                self._try(candidates, grasps, chosen[some], which[some], kind, scene)

    def _try(
        self,
        candidates: Candidates,
        grasps: np.ndarray,
        chosen: np.ndarray,
        which: np.ndarray,
        s: RolloutSettings,
        scene: Scene,
    ) -> None:
        tally = candidates.tally
        rows, beliefs = chosen * len(grasps) + which, self._beliefs.select(grasps[which])
        draws = tally.tried[chosen, which].astype(int)
        sample = self._samples[s is self._whole].select(draws)
        if s is not self._whole or s.randomization != NOMINAL:
            # Otherwise the world is as believed.
            sample = _with_estimated_errors(
                sample, beliefs, self._pose_errors[draws], self._mass_errors[draws]
            )
        tasks = candidates.grasps.select(rows).task if s.for_use else None
        plans = candidates.plans.select(rows)
        found = roll_out(plans, beliefs, sample, scene, self._policy, s, self._threads, tasks)
        slip = np.minimum(found.slip, LARGEST_SLIP)
        bonus = s.share * found.shown_share + s.contact * found.contact_ratio - s.slip * slip
        tally.add(chosen, which, found.success, found.as_shown, bonus)


def roll_out(
    plans: GraspPlan,
    beliefs: Belief,
    sample: EpisodeSample,
    scene: Scene,
    policy: Policy,
    settings: RolloutSettings,
    threads: int = 0,
    tasks: np.ndarray | None = None,
) -> RolloutResults:
    """Run one rollout each of R plans.

    Args:
        plans: R plans.
        beliefs: R rows.
        sample: random parameters, R rows.
        scene: scene with the plans' objects.
        threads: 0 for all processors.
        tasks: tasks of the grasps, shape [R] str, whose use motions follow the hold; none if None.
    """
    s = settings
    protocol = replace(LiftProtocol(), hold_time=s.hold_time)
    randomization = _without_jitter(s.randomization)
    results, unstable = [], 0
    for first in range(0, len(plans), s.chunk):
        rows = slice(first, first + s.chunk)
        some = plans.select(rows)
        ids = np.arange(len(some))
        environment = LiftEnvironment(scene, len(ids), randomization, protocol, threads=threads)
        # If the approach is not free, hands may push the object on the way: simulate it.
        step = np.where(some.path_collision > BLOCKED, 0, np.maximum(some.closing_step - s.early, 0))
        environment.begin(ids, some, step, sample.select(rows), beliefs.select(rows))
        outcomes = play(environment, policy, some, end_lost=True)
        lost = outcomes.reason == "lost before the hold"
        success = outcomes.success.astype(float)
        if tasks is not None:
            success *= _withstood(environment, tasks[rows], outcomes.success)
        known = some.shown_places is not None
        as_shown = success * (outcomes.held_as_shown if known else 1.0)
        share = outcomes.success * outcomes.shown_share
        measured = as_shown, share, outcomes.contact_ratio, outcomes.sim_distance_hand_mm_s
        unstable += int(environment.engine.diverged.sum())
        results.append(RolloutResults(success, *(np.where(lost, 0.0, np.nan_to_num(m)) for m in measured)))
    if unstable:
        _log.warning(
            "%d of %d rollouts became unstable in simulation and count as failed", unstable, len(plans)
        )
    return RolloutResults.join(results)


def _withstood(environment: LiftEnvironment, tasks: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return how well W objects withstand their use motions, shape [W]: 1 without a motion, ``WITHSTOOD`` to
    1 if the use test is passed, 0.5 to ``NEARLY_WITHSTOOD`` if it is failed, 0 if the simulation diverged."""
    known = load_use_motions().values()
    motions = [motion_of(task, known) for task in tasks.tolist()]
    use = play_use(environment, motions, held)
    moved = np.maximum(use.shift_m / LARGEST_SHIFT, use.turn_rad / LARGEST_TURN)
    wanted = np.array([m.trigger.force if m is not None and m.trigger is not None else 0.0 for m in motions])
    pressed = np.where(wanted > 0, use.trigger_force_n / np.maximum(wanted, 1e-9), 1.0)
    near = np.clip(np.nan_to_num(np.minimum(1.0 / (moved + 1e-9), pressed)), 0.0, 1.0)
    failed = 0.5 + (NEARLY_WITHSTOOD - 0.5) * near
    passed = 1.0 - (1.0 - WITHSTOOD) * np.nan_to_num(moved)
    failed = np.where(use.reason == DIVERGED, 0.0, failed)
    return np.where(use.motion == "", 1.0, np.where(use.success, passed, failed))


def _scene(
    names: Sequence[str], objects: Mapping[str, ObjectModel], hand: Hand, settings: RolloutSettings
) -> Scene:
    present = {name: objects[name] for name in sorted(set(names))}
    sizes = with_sizes(present, settings.randomization.object_scales)
    s = settings
    physics = SceneSettings(timestep=s.timestep, device=s.device, buffers=s.buffers)
    return build_scene(hand, sizes, physics)


def _without_jitter(randomization: Randomization) -> Randomization:
    """Remove jitter and dropouts, so that a rollout does not depend on the others in its batch."""
    errors = {f.name: getattr(randomization, f.name) for f in fields(Randomization)}
    still = {n: replace(e, jitter=0.0) for n, e in errors.items() if isinstance(e, MeasurementError)}
    return replace(randomization, **still, tracker_dropout=0.0)


def _with_estimated_errors(
    sample: EpisodeSample, beliefs: Belief, z: np.ndarray, mass: np.ndarray
) -> EpisodeSample:
    """Sample pose and mass errors from the belief: ``e = L z`` with ``L L^T`` the pose covariance.

    Args:
        sample: R rows; unchanged if the belief has neither covariance nor mass spread.
        beliefs: R rows.
        z: standard normal numbers, shape [R, 6].
        mass: standard normal numbers, shape [R].
    """
    if beliefs.object_mass_spread is not None:
        sample = replace(sample, mass=np.exp(beliefs.object_mass_spread * np.clip(mass, -MOST, MOST)))
    if beliefs.object_pose_covariance is None:
        return sample
    factor = np.linalg.cholesky(beliefs.object_pose_covariance + 1e-12 * np.eye(6))
    return replace(sample, object_bias=np.einsum("rij,rj->ri", factor, z))
