"""Of many variations of a grasp, the one that holds best: a learned critic names the promising plans, and
rehearsals decide between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import digest
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.motion import plan_motion
from fungrasp.policies.network import PolicyNetwork
from fungrasp.policies.plan_features import plan_features
from fungrasp.policies.policy_file import check_fits
from fungrasp.policies.references import References
from fungrasp.policies.rehearse import RehearsalSettings, rehearse
from fungrasp.policies.variations import Spread, vary, with_settings
from fungrasp.task import LiftTask
from fungrasp.task.observation import flatten, layout


@dataclass(frozen=True)
class ChoiceSettings:
    """How many variations to choose from."""

    tries: int = 24
    """Plans of each grasp, the unchanged one included."""
    rehearsal: RehearsalSettings | None = field(default_factory=RehearsalSettings)
    """Trials that decide between the most promising; the critic alone decides if None."""
    chunk: int = 512
    """Plans made together."""

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise FungraspError(f"there must be at least one plan to choose from, not {self.tries}")


class Planner:
    """Chooses plans for tasks, and remembers what it has chosen."""

    def __init__(self, settings: ChoiceSettings | None = None, threads: int = 0):
        """
        Args:
            settings: the defaults if None.
            threads: 0 means all processors. The choice does not depend on it.
        """
        self.settings, self._threads = settings or ChoiceSettings(), threads
        self._known: dict[str, tuple[References, np.ndarray]] = {}

    def __call__(
        self, task: LiftTask, objects: Mapping[str, ObjectModel], critic: PolicyNetwork, seed: int = 0
    ) -> tuple[References, np.ndarray]:
        """As ``choose_references``."""
        grasps = task.grasps
        key = digest(
            seed,
            critic.card.sha256,
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            [objects[name].digest for name in grasps.object_name.tolist()],
            (task.settled_pose, task.set_point.pose, task.finger_set_point),
        )
        if key not in self._known:
            chosen = choose_references(task, objects, critic, self.settings, seed, self._threads)
            self._known[key] = chosen
        return self._known[key]


def choose_references(
    task: LiftTask,
    objects: Mapping[str, ObjectModel],
    critic: PolicyNetwork,
    settings: ChoiceSettings | None = None,
    seed: int = 0,
    threads: int = 0,
) -> tuple[References, np.ndarray]:
    """Plan variations of each world's grasp, rehearse the most promising, and keep the best.

    All grasps are varied in the same ways, so that a world's choice does not depend on the others.

    Args:
        task: reset.
        objects: by name.
        critic: a policy file of the kind "critic", made for the task's hand.
        settings: the defaults if None.
        seed: of the variations and rehearsals.
        threads: of the rehearsals; 0 means all processors.

    Returns:
        One reference for each world; the success expected of it, shape [W].

    Raises:
        FungraspError: the critic was made for another hand or other features.
    """
    s, hand = settings or ChoiceSettings(), task.scene.hand
    plans, expected = _propose(task, objects, critic, s, seed)
    worlds = np.arange(len(task.worlds))
    if s.rehearsal is None:
        best = expected.argmax(axis=0)
        value = expected[best, worlds]
    else:
        best, value = rehearse(plans, expected, objects, hand, s.rehearsal, seed, threads)
    return plans.select(best * len(worlds) + worlds), value


def _propose(
    task: LiftTask, objects: Mapping[str, ObjectModel], critic: PolicyNetwork, s: ChoiceSettings, seed: int
) -> tuple[References, np.ndarray]:
    """Variations of each world's plan, W of one kind after the other, and the success expected of them,
    shape [tries, W]."""
    hand = task.scene.hand
    grasps, worlds = with_settings(task.grasps), len(task.worlds)
    per_round = max(1, s.chunk // worlds)
    proposals, expected = [], []
    for first in range(0, s.tries, per_round):
        attempts = np.arange(first, min(first + per_round, s.tries))
        rows = np.tile(np.arange(worlds), len(attempts))
        number = np.repeat(attempts, worlds)
        varied = vary(grasps.select(rows), hand, np.zeros_like(rows), number, seed, Spread())
        motion = plan_motion(
            hand,
            varied,
            objects,
            task.settled_pose[rows],
            task.set_point.pose[rows],
            task.finger_set_point[rows],
            protocol=task.protocol,
        )
        proposals.append(References.of(motion, varied, task.settled_pose[rows], hand))
        score = expect(critic, hand, proposals[-1], objects, 1 / task.protocol.control_period)
        expected.append(score.reshape(len(attempts), worlds))
    return References.join(proposals), np.concatenate(expected)


def expect(
    critic: PolicyNetwork, hand: Hand, plans: References, objects: Mapping[str, ObjectModel], rate: float
) -> np.ndarray:
    """Expected success of plans, in [0, 1], shape [N].

    Args:
        critic: of the kind "critic".
        hand: of the plans.
        plans: N of them.
        objects: by name.
        rate: of control [Hz].
    """
    parts = plan_features(plans, objects)
    check_fits(critic.card, hand, layout(parts), (), rate)
    value, _, _ = critic(np.nan_to_num(flatten(parts)).astype(np.float32))
    return value[:, 0]
