"""Whether a foreign hand is a right or a left one: by the place of its thumb, its names, or the user."""

from __future__ import annotations

import re

import mujoco

from fungrasp.core.errors import FungraspError
from fungrasp.hands.checking.finding import Finding, warning
from fungrasp.hands.checking.kinematic_tree import ancestors, body_name, subtree

SIDES = {
    side: re.compile(rf"(?<![a-z0-9])(?:{words})(?![a-z0-9])")
    for side, words in {"right": "right|rh|r", "left": "left|lh|l"}.items()
}
"""Parts of names that tell the side of a hand; "l1" is a link."""


def find_side(
    model: mujoco.MjModel,
    palm: int,
    standing: str | None,
    fingers: int,
    answer: str | None,
    findings: list[Finding],
) -> str:
    """The side of a hand; doubts are added to the findings.

    Args:
        model: any.
        palm: its body.
        standing: the hand's side by the place of its thumb; None if it stands in the middle.
        fingers: beside the thumb.
        answer: the side that the user gives.
        findings: doubts are added.

    Raises:
        FungraspError: nothing tells it.
    """
    named = _named_side(model, palm)
    if answer is not None:
        if standing not in (None, answer):
            findings.append(
                warning(f"the thumb stands where that of a {standing} hand does; --side {answer} is taken")
            )
        elif standing is None and named not in (None, answer):
            findings.append(warning(f"the names say {named} hand; --side {answer} is taken"))
        return answer
    if standing is not None:
        if named not in (None, standing):
            findings.append(
                warning(
                    f"the names say {named} hand, the thumb stands where that of a {standing} one does: "
                    f"taken as a {standing} hand; --side {named} changes it"
                )
            )
        return standing
    if named is None and fingers > 2:
        raise FungraspError(
            "the thumb stands in the middle, so that a left hand can't be told from a right one: say "
            "--side right or --side left"
        )
    # Two fingers and a thumb in the middle are their own mirror image.
    side = named or "right"
    findings.append(
        warning(
            f"the thumb stands in the middle: taken as a {side} hand, "
            f"{'as its names say' if named else 'as it would do for either'}; --side changes it"
        )
    )
    return side


def _named_side(model: mujoco.MjModel, palm: int) -> str | None:
    """The side that the names of most of a palm's bodies say, else those of what carries it."""
    for bodies in (subtree(model, palm), ancestors(model, palm)):
        names = [body_name(model, b).lower() for b in bodies]
        for side, pattern in SIDES.items():
            if sum(bool(pattern.search(name)) for name in names) > 0.5 * len(names):
                return side
    return None
