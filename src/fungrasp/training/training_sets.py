"""Grasps to train on, from files."""

from __future__ import annotations

from pathlib import Path

from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet, load_grasps, load_objects
from fungrasp.grasps.grasp_files import BUILTIN
from fungrasp.hands import Hand
from fungrasp.retargeting import RetargetSpec, method_name, retarget
from fungrasp.training.run import TrainingSet

BUILTIN_TERMS = "Apache-2.0, part of fungrasp"
"""Terms of the built-in grasps."""


def load_training_sets(
    names: tuple[str, ...],
    folder: Path | None,
    hand: Hand,
    method: str = RetargetSpec.method,
    terms: tuple[str, ...] = (),
    threads: int = 0,
) -> list[TrainingSet]:
    """Grasps of a hand from files, retargeted where they are human.

    Args:
        names: of files, or "builtin".
        folder: of meshes.
        hand: the robot hand.
        method: of retargeting.
        terms: one for each name, or none.
        threads: 0 means all processors.

    Raises:
        FungraspError: a file or an object can't be read, grasps of another hand, or an unknown method.
    """
    method = method_name(method)
    if not names or len(set(names)) < len(names):
        raise FungraspError("--grasps needs at least one set, and each once")
    if terms and len(terms) != len(names):
        raise FungraspError(f"--terms needs one text for each of the {len(names)} --grasps, not {len(terms)}")
    sets = []
    for number, name in enumerate(names):
        grasps = load_grasps(name)
        place = None if name == BUILTIN else folder
        objects = load_objects(grasps, place)
        if isinstance(grasps, RobotGraspSet):
            grasps.check_hand(hand)
            robot, label = grasps, ""
        else:
            robot = retarget(grasps, objects, hand, method, threads=threads)
            label = f", retargeted with {method}"
        said = terms[number] if terms else BUILTIN_TERMS if name == BUILTIN else "not stated"
        title = "built-in grasps" if name == BUILTIN else Path(name).name
        sets.append(TrainingSet(title + label, robot, objects, said, place))
    return sets
