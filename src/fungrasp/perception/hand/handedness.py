"""Which hand it is: what the landmark model says, whoever took the picture, and how its fingers bend."""

from __future__ import annotations

import dataclasses

import numpy as np

from fungrasp.grasps.anatomy import joint_bends
from fungrasp.perception.estimates import Side
from fungrasp.perception.hand.detection import DetectedHand
from fungrasp.perception.hand.initial_skeleton import MIRROR_X

UNDECIDED = 0.6
"""Below this part of its windows' votes the landmark model is overruled by how the fingers bend."""

BENT_BACK = np.radians(8.0)
"""Fingers bent back by more, on average over their joints, are those of the other hand [rad]."""

IMPOSSIBLE = np.radians(20.0)
"""If the landmark model is sure of the side, fingers bent back by more say that its landmarks are wrong
[rad]."""

DISTRUST = 0.5
"""What then remains of the hand's score."""


def settle_side(hand: DetectedHand, side: Side | None = None) -> tuple[DetectedHand, str]:
    """The hand with the side that it has.

    The landmark model tells the side from the picture, and is at times wrong about a hand behind an object.
    The same landmarks in 3D, taken for a hand of the other side, bend their fingers backwards.

    Args:
        hand: as it was found.
        side: which hand it is, if somebody said so: that counts.

    Returns:
        The hand, and a sentence if the side was in doubt, else an empty one.
    """
    if side is not None:
        return dataclasses.replace(hand, side=side), ""
    bend = mean_bend(hand)
    if hand.side_score < UNDECIDED and bend < -BENT_BACK:
        other: Side = "left" if hand.side == "right" else "right"
        return (
            dataclasses.replace(hand, side=other),
            f"the hand looks like a {hand.side} one, but its fingers bend like those of a {other} one: taken "
            f"for a {other} one; --hand says which it is",
        )
    if bend < -IMPOSSIBLE:
        return (
            dataclasses.replace(hand, score=DISTRUST * hand.score),
            "the fingers seem to be bent backwards: their landmarks are probably wrong",
        )
    return hand, ""


def mean_bend(hand: DetectedHand) -> float:
    """Mean flexion of the joints of the four fingers, taken for a hand of its side [rad]."""
    shape = hand.shape_camera if hand.side == "right" else hand.shape_camera * MIRROR_X
    return float(joint_bends(shape)[0][:4].mean())
