"""Plans tried in a simulation of the policy's own before it acts, in worlds that differ from what it was
told: those that hold in most of them are good plans, and not only lucky ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.geometry.poses import compose
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import References, begin_on_way
from fungrasp.simulation import Scene, SceneSettings, Worlds, build_scene
from fungrasp.task import Action, LiftTask, Protocol
from fungrasp.transfer import MILD, Differences, Randomisation
from fungrasp.transfer.randomization import Sample, Spread, sample

Actor = Callable[[LiftTask, References, Differences], Callable[[], Action]]
"""Makes what acts in trials that have begun, from a reference for each world and sensors that err."""
Rounds = tuple[tuple[int, int], ...]
"""In each round, how many plans of a grasp are tried, the best so far, and how often each."""

LOST_HEIGHT = 0.03
"""An object lower than this a while after the lift began is lost [m]."""
LOST_AFTER = 1.0
"""[s]"""
MOST_SLIP = 10.0
"""[mm/s]"""


@dataclass(frozen=True)
class RehearsalSettings:
    """Of the trials before a grasp."""

    randomisation: Randomisation = MILD
    """What differs from what the policy was told. It sees none of it."""
    timestep: float = 0.01
    """Of physics [s]."""
    hold_time: float = 2.0
    """[s]."""
    early: int = 4
    """Trials begin this many control steps before the fingers close."""
    contact: float = 0.1
    """Weight of the contact ratio against success."""
    slip: float = 0.01
    """Weight of the slip against success [s/mm]; ten millimetres a second count at most."""
    chunk: int = 512
    """Trials at once."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of T trials."""

    success: np.ndarray
    """Shape [T] bool."""
    contact_ratio: np.ndarray
    """Zero for lost objects, shape [T]."""
    slip: np.ndarray
    """In the hand [mm/s], zero for lost objects, shape [T]."""


def blind(task: LiftTask, plans: References, sensors: Differences) -> Callable[[], Action]:
    """An ``Actor`` that does what is planned, wherever the object is."""

    def act() -> Action:
        goal, fingers = plans.motion.at(task.control_step)
        return Action(compose(plans.settled_pose, goal), fingers, task.control_step >= plans.motion.lift)

    return act


@dataclass(frozen=True, eq=False)
class Tally:
    """What is known of K plans of each of W grasps; all arrays have the shape [K, W]."""

    expected: np.ndarray
    """Success that a critic expects."""
    prior: float
    """Trials that its expectation stands for."""
    tried: np.ndarray
    """Trials."""
    held: np.ndarray
    """Those that succeeded."""
    bonus: np.ndarray
    """Sum over the trials of what counts besides success."""

    @classmethod
    def untried(cls, expected: np.ndarray, prior: float) -> Tally:
        """Before any trial."""
        return cls(expected, prior, *(np.zeros(expected.shape) for _ in range(3)))

    @property
    def success(self) -> np.ndarray:
        """Expected after the trials."""
        return (self.held + self.prior * self.expected) / (self.tried + self.prior)

    @property
    def order(self) -> np.ndarray:
        """Plans of each grasp, the best first."""
        score = self.success + self.bonus / np.maximum(self.tried, 1)
        return np.argsort(-score, axis=0, kind="stable")

    def add(self, plans: np.ndarray, outcome: Outcome, bonus: np.ndarray) -> None:
        """Count trials. plans: of each grasp, shape [P, W]; outcome and bonus: as often each, P W in turn."""
        grasps = np.arange(plans.shape[1])
        self.tried[plans, grasps] += len(bonus) // plans.size
        self.held[plans, grasps] += outcome.success.reshape(*plans.shape, -1).sum(axis=2)
        self.bonus[plans, grasps] += bonus.reshape(*plans.shape, -1).sum(axis=2)

    def select(self, plans: np.ndarray, grasps: np.ndarray) -> Tally:
        """Of plans [P, G] of some grasps [G]."""
        return self._each(lambda name: getattr(self, name)[plans, grasps])

    def join(self, other: Tally) -> Tally:
        """With more plans of the same grasps."""
        return self._each(lambda name: np.concatenate([getattr(self, name), getattr(other, name)]))

    def _each(self, values: Callable[[str], np.ndarray]) -> Tally:
        """With another array in the place of each."""
        return replace(self, **{name: values(name) for name in ("expected", "tried", "held", "bonus")})


def rehearse(
    plans: References,
    tally: Tally,
    rounds: Rounds,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    settings: RehearsalSettings | None = None,
    seed: Sequence[int] = (0,),
    threads: int = 0,
    actor: Actor = blind,
) -> None:
    """Try the most promising plans of each grasp in differing worlds.

    All plans meet the same differences, so what is found of a grasp does not depend on the others.

    Args:
        plans: of W grasps K each, those of one variation after those of another, length K W.
        tally: of these plans; the trials are added to it.
        rounds: of the trials, at least one.
        objects: by name.
        hand: of the plans.
        settings: the defaults if None.
        seed: of the differences.
        threads: 0 means all processors.
        actor: of what acts in the trials.
    """
    s = settings or RehearsalSettings()
    count = tally.expected.shape[1]
    names = sorted(set(plans.object_name.tolist()))
    scene = build_scene(hand, {name: objects[name] for name in names}, SceneSettings(timestep=s.timestep))
    trials = sum(each for _, each in rounds)
    drawn = sample(s.randomisation, trials, len(hand.joint_names), np.random.default_rng(seed))
    among, done = tally.order, 0
    for most, each in rounds:
        among = np.take_along_axis(among, tally.select(among, np.arange(count)).order, axis=0)[:most]
        flat = (among * count + np.arange(count)).ravel()
        rows, draws = np.repeat(flat, each), np.tile(done + np.arange(each), len(flat))
        outcome = _trials(plans, rows, drawn, draws, scene, s, threads, actor)
        slip = np.minimum(outcome.slip, MOST_SLIP)
        tally.add(among, outcome, s.contact * outcome.contact_ratio - s.slip * slip)
        done += each


def _trials(
    plans: References,
    rows: np.ndarray,
    drawn: Sample,
    draws: np.ndarray,
    scene: Scene,
    s: RehearsalSettings,
    threads: int,
    actor: Actor,
) -> Outcome:
    """Of plans [T] in worlds that were drawn [T]."""
    index = scene.indices(plans.object_name.tolist())
    protocol = replace(Protocol(), hold_time=s.hold_time)
    results = []
    for first in range(0, len(rows), s.chunk):
        part = rows[first : first + s.chunk]
        told, ids = plans.select(part), np.arange(len(part))
        worlds = Worlds(scene, index[part], told.mass, threads=threads)
        task = LiftTask(scene, told.grasps(scene.hand), worlds, protocol)
        worlds.reset()
        differences = Differences(_steady(s.randomisation), worlds, np.random.default_rng(0))
        differences.begin(ids, index[part], told.mass, drawn.select(draws[first : first + s.chunk]))
        task.latency[:] = differences.latency(ids, protocol.control_period)
        placed = differences.placed(ids, told.settled_pose)
        begin_on_way(task, ids, told, ids, np.maximum(told.motion.closing - s.early, 0), placed)
        results.append(try_out(task, actor(task, told, differences), differences.push))
    return Outcome(
        *(np.concatenate([getattr(part, field.name) for part in results]) for field in fields(Outcome))
    )


def _steady(randomisation: Randomisation) -> Randomisation:
    """Without jitter, so that a trial does not depend on which others run beside it."""
    errors = {f.name: getattr(randomisation, f.name) for f in fields(Randomisation)}
    return replace(
        randomisation, **{k: replace(v, jitter=0.0) for k, v in errors.items() if isinstance(v, Spread)}
    )


def try_out(
    task: LiftTask, act: Callable[[], Action], disturb: Callable[[np.ndarray], None] = lambda since: None
) -> Outcome:
    """Play trials that have begun, and end those whose object was lost early.

    Args:
        task: in W worlds.
        act: what to do in the next control period.
        disturb: called before each period with the time since the lift began [s], shape [W].
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
    measured = trials.contact_ratio, trials.sim_distance_hand_mm_s
    return Outcome(trials.success & ~lost, *(np.where(lost, 0.0, np.nan_to_num(m)) for m in measured))
