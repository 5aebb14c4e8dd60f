"""Of many variations of a grasp, the one that a learned critic of plans expects to hold best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.motion import plan_motion
from fungrasp.policies.network import PolicyNetwork
from fungrasp.policies.plan_features import plan_features
from fungrasp.policies.policy_file import check_fits
from fungrasp.policies.references import References
from fungrasp.policies.variations import Spread, vary, with_settings
from fungrasp.task import LiftTask
from fungrasp.task.observation import flatten, layout


@dataclass(frozen=True)
class ChoiceSettings:
    """How many variations to choose from."""

    tries: int = 24
    """Plans of each grasp, the unchanged one included."""
    chunk: int = 512
    """Plans made together."""

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise FungraspError(f"there must be at least one plan to choose from, not {self.tries}")


def choose_references(
    task: LiftTask,
    objects: Mapping[str, ObjectModel],
    critic: PolicyNetwork,
    settings: ChoiceSettings | None = None,
    seed: int = 0,
) -> tuple[References, np.ndarray]:
    """Plan variations of each world's grasp, and keep the one with the highest expected success.

    All grasps are varied in the same ways, so that a world's choice does not depend on the others.

    Args:
        task: reset.
        objects: by name.
        critic: a policy file of the kind "critic", made for the task's hand.
        settings: the defaults if None.
        seed: of the variations.

    Returns:
        One reference for each world; the success expected of it, shape [W].

    Raises:
        FungraspError: the critic was made for another hand or other features.
    """
    s, hand = settings or ChoiceSettings(), task.scene.hand
    grasps, worlds = with_settings(task.grasps), len(task.worlds)
    best: References | None = None
    score = np.full(worlds, -np.inf)
    per_round = max(1, s.chunk // worlds)
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
        plans = References.of(motion, varied, task.settled_pose[rows], hand)
        expected = expect(critic, hand, plans, objects, 1 / task.protocol.control_period)
        expected = expected.reshape(len(attempts), worlds)
        winner = expected.argmax(axis=0)
        chosen = plans.select(winner * worlds + np.arange(worlds))
        value = expected[winner, np.arange(worlds)]
        if best is None:
            best, score = chosen, value
        else:
            both = References.join([best, chosen])
            best = both.select(np.arange(worlds) + worlds * (value > score))
            score = np.maximum(score, value)
    assert best is not None
    return best, score


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
