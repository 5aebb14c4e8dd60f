"""A hand as one self-contained MJCF text, alone or on an arm."""

from __future__ import annotations

from fungrasp.hands.arm import mount
from fungrasp.hands.hand import Hand
from fungrasp.hands.self_contained_mjcf import self_contained_xml


def export_hand(hand: Hand, arm: str | None = None) -> str:
    """MJCF of the hand with one position actuator per independent joint; it needs no other file.

    Args:
        hand: what to write; its palm is fixed at the world's origin.
        arm: name of an arm to mount the hand on; then the arm's base is at the world's origin.

    Raises:
        UnknownNameError: no such arm.
        FungraspError: the model can't be written as one file.
    """
    return self_contained_xml(hand.spec() if arm is None else mount(hand, arm))
