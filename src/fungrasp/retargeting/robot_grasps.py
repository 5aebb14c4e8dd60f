"""Conversion of grasp arguments to robot grasps; human grasps are retargeted."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects, as_grasp_set, load_objects
from fungrasp.hands import Hand, as_hand
from fungrasp.hands.hand_registry import check_no_hand
from fungrasp.objects import ObjectModel
from fungrasp.retargeting.human_to_robot import retarget
from fungrasp.retargeting.settings import RetargetSpec


class RobotGrasps(NamedTuple):
    """Robot grasps with objects and hand."""

    robot: RobotGraspSet
    """N robot grasps."""
    objects: dict[str, ObjectModel]
    """Objects of the grasps, by name."""
    hand: Hand
    """Hand of the grasps."""
    human: HumanGraspSet | None
    """Human grasps, if they were retargeted here."""


def as_robot_grasps(
    grasps: AnyGrasps, objects: Objects = None, hand: Hand | str | Path | None = None, threads: int = 0
) -> RobotGrasps:
    """Convert robot or human grasps to robot grasps.

    Args:
        grasps: robot grasps, or human grasps, which are retargeted with the defaults of ``retarget``.
        objects: see ``retarget``.
        hand: hand for human grasps; allegro if None. For robot grasps, it must be their own.
        threads: 0 for all processors.

    Raises:
        FungraspError: the argument is not grasps, an object is missing, the hand is unknown, or the grasps
            are of another hand.
    """
    found = as_grasp_set(grasps)
    check_no_hand(objects)
    known = load_objects(found, objects)
    if isinstance(found, HumanGraspSet):
        used = as_hand(RetargetSpec.hand if hand is None else hand)
        return RobotGrasps(retarget(found, known, used, threads=threads), known, used, found)
    used = found.load_hand() if hand is None else as_hand(hand)
    found.check_hand(used)
    return RobotGrasps(found, known, used, None)
