"""Plans of variations of grasps, and what a learned critic expects of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import plan_motion, raised
from fungrasp.planning.references import References
from fungrasp.planning.selection.predictor_features import plan_features
from fungrasp.planning.selection.rollouts import Tally
from fungrasp.planning.selection.variations import Spread, vary
from fungrasp.policies.checkpoint.checkpoint_file import check_fits
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.task import LiftTask, Protocol
from fungrasp.task.observation import flatten, layout

STEP = 1e-4
"""Poses are told in steps of so much [m, rad], so that what is settled anew is not planned anew."""


@dataclass(frozen=True, eq=False)
class Start:
    """What N grasps are planned from; tables are at zero here."""

    grasps: RobotGraspSet
    settled_pose: np.ndarray
    """Of the objects, world frame, shape [N, 7]."""
    palm: np.ndarray
    """World frame, shape [N, 7]."""
    fingers: np.ndarray
    """Independent joints [rad], shape [N, U]."""

    @classmethod
    def of(cls, task: LiftTask, table: np.ndarray) -> Start:
        """That of a task that has been reset. table: its height under each object [m], shape [N]."""
        return cls(
            task.grasps,
            _in_steps(raised(task.settled_pose, -table)),
            _in_steps(raised(task.set_point.pose, -table)),
            _rounded(task.finger_set_point),
        )

    def __len__(self) -> int:
        return len(self.grasps)

    def select(self, rows: np.ndarray) -> Start:
        """Some of them."""
        return Start(self.grasps.select(rows), self.settled_pose[rows], self.palm[rows], self.fingers[rows])


def _rounded(values: np.ndarray) -> np.ndarray:
    return STEP * np.round(values / STEP) + 0.0  # no -0.0, which would look like another place


def _in_steps(pose: np.ndarray) -> np.ndarray:
    told = _rounded(pose)
    told[:, 3:] /= np.linalg.norm(told[:, 3:], axis=1, keepdims=True)
    return told


@dataclass(frozen=True, eq=False)
class Pool:
    """K plans of each of G grasps, those of one variation after those of another."""

    grasps: RobotGraspSet
    """As varied, K G of them."""
    plans: References
    """K G of them."""
    tally: Tally
    """Shape [K, G]."""

    def best(self) -> tuple[References, np.ndarray]:
        """The best plan of each grasp, and the success expected of it, shape [G]."""
        count = self.tally.expected.shape[1]
        best, grasps = self.tally.order[0], np.arange(count)
        return self.plans.select(best * count + grasps), self.tally.success[best, grasps]

    def among_best(self, number: int, grasps: np.ndarray) -> Pool:
        """So many plans, the best, of some grasps."""
        best = self.tally.order[:number, grasps]
        rows = (best * self.tally.expected.shape[1] + grasps).ravel()
        return Pool(self.grasps.select(rows), self.plans.select(rows), self.tally.select(best, grasps))

    def join(self, other: Pool) -> Pool:
        """With more plans of the same grasps."""
        return Pool(
            RobotGraspSet.concatenate([self.grasps, other.grasps]),
            References.join([self.plans, other.plans]),
            self.tally.join(other.tally),
        )


def propose(
    start: Start,
    grasps: RobotGraspSet,
    attempts: np.ndarray,
    search: int,
    spread: Spread,
    seed: int,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    protocol: Protocol,
    critic: PolicyNetwork,
    prior: float,
    chunk: int,
) -> Pool:
    """Plan variations.

    Args:
        start: of G grasps.
        grasps: to vary, G after G, K G of them.
        attempts: number of each variation, shape [K G].
        search: another number of the variations.
        spread: of the variations.
        seed: of the variations.
        objects: by name.
        hand: of the grasps.
        protocol: of the motions.
        critic: says what to expect.
        prior: trials that its expectation stands for.
        chunk: plans made together.
    """
    count = len(start)
    where = np.resize(np.arange(count), len(grasps))
    varied = vary(grasps, hand, np.full(len(grasps), search), attempts, seed, spread)
    plans, expected = [], []
    for first in range(0, len(grasps), chunk):
        part = slice(first, first + chunk)
        told, some = start.select(where[part]), varied.select(part)
        motion = plan_motion(
            hand, some, objects, told.settled_pose, told.palm, told.fingers, protocol=protocol
        )
        plans.append(References.of(motion, some, told.settled_pose, hand))
        expected.append(expect(critic, hand, plans[-1], objects, 1 / protocol.control_period))
    tally = Tally.untried(np.concatenate(expected).reshape(-1, count), prior)
    return Pool(varied, References.join(plans), tally)


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
