"""The hand that a command is given."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fungrasp.hands import Hand


def chosen_hand(name: str, dynamics: Path | None) -> Hand:
    """A hand, with identified dynamics where a file of them is given.

    Args:
        name: of the hand, or the path of its TOML file.
        dynamics: what ``fungrasp identify fit`` has written.
    """
    from fungrasp.hands import load_hand
    from fungrasp.sim2real.joint_dynamics import identified_hand

    hand = load_hand(name)
    return hand if dynamics is None else identified_hand(hand, dynamics)
