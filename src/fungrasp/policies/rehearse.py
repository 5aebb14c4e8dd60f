"""Plans tried in a simulation of the policy's own before it acts, in worlds that differ from what it was
told: those that hold in most of them are good plans, and not only lucky ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.references import References, begin_on_way
from fungrasp.simulation import Scene, SceneSettings, Worlds, build_scene
from fungrasp.task import Action, LiftTask, Protocol
from fungrasp.transfer import MILD, Differences, Randomisation
from fungrasp.transfer.randomisation import Sample, sample

LOST_HEIGHT = 0.03
"""An object lower than this a while after the lift began is lost [m]."""
LOST_AFTER = 1.0
"""[s]"""


@dataclass(frozen=True)
class RehearsalSettings:
    """Of the trials before a grasp."""

    rounds: tuple[tuple[int, int], ...] = ((12, 1), (6, 2), (3, 3))
    """In each round, how many plans of a grasp are tried, the best so far, and how often each."""
    randomisation: Randomisation = MILD
    """What differs from what the policy was told. It sees none of it."""
    timestep: float = 0.01
    """Of physics [s]."""
    hold_time: float = 1.0
    """[s]."""
    early: int = 4
    """Trials begin this many control steps before the fingers close."""
    prior: float = 4.0
    """Trials that the critic's expectation stands for."""
    contact: float = 0.1
    """Weight of the contact ratio against success."""
    chunk: int = 512
    """Trials at once."""

    def __post_init__(self) -> None:
        if not self.rounds or min(number for pair in self.rounds for number in pair) < 1:
            raise FungraspError(f"a rehearsal needs rounds of at least one plan and trial, not {self.rounds}")


def rehearse(
    plans: References,
    expected: np.ndarray,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    settings: RehearsalSettings | None = None,
    seed: int = 0,
    threads: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Try the most promising plans of each grasp blindly, in differing worlds, and pick the best.

    All plans meet the same differences, so the choice for a grasp does not depend on the others.

    Args:
        plans: of W grasps K each, those of one variation after those of another, length K W.
        expected: success expected of them, shape [K, W].
        objects: by name.
        hand: of the plans.
        settings: the defaults if None.
        seed: of the differences.
        threads: 0 means all processors.

    Returns:
        Which of its K plans is the best for each grasp, shape [W] int; success expected of it now, shape [W].
    """
    s = settings or RehearsalSettings()
    number, count = expected.shape
    names = sorted(set(plans.object_name.tolist()))
    scene = build_scene(hand, {name: objects[name] for name in names}, SceneSettings(timestep=s.timestep))
    trials = sum(each for _, each in s.rounds)
    drawn = sample(s.randomisation, trials, len(hand.joint_names), np.random.default_rng(seed))
    tried, held, touched = (np.zeros((number, count)) for _ in range(3))
    order, grasp, done = np.argsort(-expected, axis=0, kind="stable"), np.arange(count), 0

    def success() -> np.ndarray:
        return (held + s.prior * expected) / (tried + s.prior)

    for most, each in s.rounds:
        among = order[:most]
        flat = (among * count + grasp).ravel()
        rows, draws = np.repeat(flat, each), np.tile(done + np.arange(each), len(flat))
        outcome = _trials(plans, rows, drawn, draws, scene, s, threads)
        for total, values in zip((held, touched), outcome, strict=True):
            total[among, grasp] += values.reshape(*among.shape, each).sum(axis=2)
        tried[among, grasp] += each
        done += each
        score = success() + s.contact * touched / np.maximum(tried, 1)
        ranks = np.argsort(-np.take_along_axis(score, among, axis=0), axis=0, kind="stable")
        order = np.take_along_axis(among, ranks, axis=0)
    return order[0], success()[order[0], grasp]


def _trials(
    plans: References,
    rows: np.ndarray,
    drawn: Sample,
    draws: np.ndarray,
    scene: Scene,
    s: RehearsalSettings,
    threads: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Success [T] bool and contact ratio [T] of plans [T] in worlds that were drawn [T]."""
    index = scene.indices(plans.object_name.tolist())
    protocol = replace(Protocol(), hold_time=s.hold_time)
    results = []
    for first in range(0, len(rows), s.chunk):
        part = rows[first : first + s.chunk]
        told, ids = plans.select(part), np.arange(len(part))
        worlds = Worlds(scene, index[part], told.mass, threads=threads)
        task = LiftTask(scene, told.grasps(scene.hand), worlds, protocol)
        worlds.reset()
        differences = Differences(s.randomisation, worlds, np.random.default_rng(0))
        differences.begin(ids, index[part], told.mass, drawn.select(draws[first : first + s.chunk]))
        task.latency[:] = differences.latency(ids, protocol.control_period)
        placed = differences.placed(ids, told.settled_pose)
        begin_on_way(task, ids, told, ids, np.maximum(told.motion.closing - s.early, 0), placed)
        results.append(try_out(task, lambda told=told, task=task: _blind(told, task), differences.push))
    success, ratio = (np.concatenate(parts) for parts in zip(*results, strict=True))
    return success, ratio


def _blind(told: References, task: LiftTask) -> Action:
    goal, fingers = told.motion.at(task.control_step)
    return Action(compose(told.settled_pose, goal), fingers, task.control_step >= told.motion.lift)


def try_out(
    task: LiftTask, act: Callable[[], Action], disturb: Callable[[np.ndarray], None] = lambda since: None
) -> tuple[np.ndarray, np.ndarray]:
    """Play trials that have begun, and end those whose object was lost early.

    Args:
        task: in W worlds.
        act: what to do in the next control period.
        disturb: called before each period with the time since the lift began [s], shape [W].

    Returns:
        Success [W] bool and contact ratio, zero for lost objects, shape [W].
    """
    lost = np.zeros(len(task.worlds), dtype=bool)
    while not task.done.all():
        disturb(task.time - task.lift_time)
        task.step(act())
        height = task.worlds.center_of_mass[:, 2] - task.settled_height
        gone = ((task.time - task.lift_time > LOST_AFTER) & (height < LOST_HEIGHT)) | ~np.isfinite(height)
        lost |= gone & ~task.done
        task.done |= gone
    trials = task.trials()
    return trials.success & ~lost, np.where(lost, 0.0, np.nan_to_num(trials.contact_ratio))
