"""The use test on many grasps: what is tried after the hold, on which parts the person's hand lies, and the
numbers of all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fungrasp.core.files import digest
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.correspondence import HUMAN_FINGER_JOINTS, HUMAN_FINGER_LINKS, correspond
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_parts
from fungrasp.task import DIVERGED, LiftEnvironment
from fungrasp.task.use import UseMotion, UseOutcomes, load_use_motions, motion_of, play_use

PALM_JOINTS = (0, 1, 5, 9, 13)
"""Human joints around the palm: wrist and the four knuckles."""


@dataclass(frozen=True, eq=False)
class UseTest:
    """What is tried with N grasps after their lift tests."""

    motions: Mapping[str, UseMotion]
    """Motions by name."""
    held_parts: Sequence[tuple[frozenset[str], ...]]
    """Parts of the object that the person touches with what each contact link stands for, N x L; empty sets
    where that is not known."""

    @classmethod
    def of(
        cls,
        human: HumanGraspSet | None,
        robot: RobotGraspSet,
        objects: Mapping[str, ObjectModel],
        hand: Hand,
        motions: Mapping[str, UseMotion] | None = None,
    ) -> UseTest:
        """The use test of some grasps.

        Args:
            human: as the person did them; None if that is not known: any part then counts as the one held.
            robot: N grasps.
            motions: those that come with the package if None.
        """
        unknown = [(frozenset[str](),) * len(hand.links)] * len(robot)
        parts = unknown if human is None else held_parts(human, objects, hand)
        return cls(load_use_motions() if motions is None else motions, parts)

    def key(self, rows: np.ndarray) -> str:
        """Digest of all that outcomes of some rows depend on. rows: of the grasps, shape [W]."""
        parts = [[sorted(names) for names in self.held_parts[row]] for row in rows]
        return digest({name: str(motion) for name, motion in self.motions.items()}, str(parts))

    def motions_of(self, tasks: Sequence[str]) -> list[UseMotion | None]:
        """The motion of each task; None for a task without."""
        return [motion_of(task, self.motions.values()) for task in tasks]

    def run(
        self,
        environment: LiftEnvironment,
        rows: np.ndarray,
        tasks: Sequence[str],
        held: np.ndarray,
        watch: Callable[[np.ndarray], None] = lambda controls: None,
    ) -> UseOutcomes:
        """Try W grasps whose lift tests have just ended.

        Args:
            environment: with the worlds.
            rows: of the grasps in their set, shape [W].
            tasks: what the grasps are for, length W.
            held: whether the lift test was passed, shape [W] bool.
            watch: called after each setpoint with what the servos were told, to record.
        """
        parts = [self.held_parts[row] for row in rows]
        return play_use(environment, self.motions_of(tasks), held, parts, watch)


def use_json(use: UseOutcomes, task: np.ndarray) -> dict[str, Any]:
    """Rates over the grasps that were held and whose task has a motion: all, and by task.

    Args:
        use: N outcomes.
        task: what each grasp is for, shape [N] str.
    """
    tested = use.motion != ""
    names = np.unique(task[tested]).tolist()
    return {
        **_rates(use, tested),
        "by_task": {name: _rates(use, tested & (task == name)) for name in names},
        "functional_contact": float(np.nanmean(use.functional_contact))
        if np.isfinite(use.functional_contact).any()
        else None,
    }


def _rates(use: UseOutcomes, which: np.ndarray) -> dict[str, Any]:
    count, passed = int(which.sum()), int(use.success[which].sum())
    if not count:
        return {"count": 0, "success_rate": None}
    return {
        "count": count,
        "success_rate": passed / count,
        "success_interval": list(wilson_interval(passed, count)),
        "unstable": int((use.reason[which] == DIVERGED).sum()),
        "functional_contact": float(np.mean(use.functional_contact[which])),
        "shift_mm_median": 1e3 * float(np.median(use.shift_m[which])),
        "turn_deg_median": float(np.rad2deg(np.median(use.turn_rad[which]))),
    }


def held_parts(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand
) -> list[tuple[frozenset[str], ...]]:
    """The parts that the person touches with what each contact link of a robot hand stands for.

    Args:
        human: N grasps.
        hand: the robot hand, L contact links.

    Returns:
        N tuples of L sets, empty where the person does not touch, or the object has no parts.
    """
    ends = {0: PALM_JOINTS}
    for finger, links in HUMAN_FINGER_LINKS.items():
        joints = HUMAN_FINGER_JOINTS[finger]
        ends |= {link: (joints[i], joints[i + 1]) for i, link in enumerate(links)}
    groups = ((0,), *correspond(hand).human_links)
    joints = inverse_transform_points(human.object_pose, human.hand_joints)
    touched: list[tuple[frozenset[str], ...]] = []
    for row, name in enumerate(human.object_name.tolist()):
        # Of each human link the middle and the far end: where its pad is.
        places = np.stack(
            [
                (joints[row, list(e)].mean(axis=0), joints[row, e[-1] if link else 9])
                for link, e in ends.items()
            ]
        )
        parts = nearest_parts(objects[name], places.reshape(-1, 3)).reshape(-1, 2)
        contact = human.link_contacts[row]
        touched.append(
            tuple(
                frozenset(str(p) for link in links if contact[link] for p in parts[link] if p)
                for links in groups
            )
        )
    return touched
