"""The palm of a foreign model: the body that carries the fingers."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.checking.findings import listed
from fungrasp.hands.kinematic_tree import ancestors, body_name, subtree

PALM_SHARE = 0.8
"""The palm is the last body that carries more than this share of the tree's ends."""

MIN_BRANCHES = 3
"""Several bodies from which so many branches go out are the palms of several hands."""


def find_palm(model: mujoco.MjModel, answer: str | None) -> int:
    """Id of the palm: the body that is given, else the last that carries nearly all ends of the tree.

    Raises:
        FungraspError: no such body, or no body carries the fingers.
    """
    names = {model.body(b).name: b for b in range(1, model.nbody)}
    if answer is not None:
        if answer not in names:
            raise FungraspError(f"--palm: {UnknownNameError('body', answer, names)}")
        return names[answer]
    moving = set(np.flatnonzero(model.body_jntnum > 0).tolist())
    if not moving:
        raise FungraspError("the model has no joints, so it is no hand")
    hands = _palms(model, moving)
    if len(hands) > 1:
        raise FungraspError(
            f"several bodies carry fingers: {listed([body_name(model, body) for body in hands])}; choose the "
            "palm with --palm BODY"
        )
    ends = branch_ends(model, moving)
    if len(ends) == 1:
        raise FungraspError(
            f"one chain of joints is all there is, up to '{body_name(model, ends[0])}': a gripper with one "
            "jaw, or an arm without a hand"
        )
    # A scene may hold things beside the hand: the tree with most ends is the hand's.
    roots = [ancestors(model, end)[-1] for end in ends]
    root = max(dict.fromkeys(roots), key=roots.count)
    ends = [end for end, top in zip(ends, roots, strict=True) if top == root]
    held = {body: sum(body in ancestors(model, end)[1:] for end in ends) for body in range(1, model.nbody)}
    candidates = [body for body, count in held.items() if count > PALM_SHARE * len(ends) and count > 1]
    if not candidates:
        raise FungraspError(
            f"the fingers {listed([body_name(model, end) for end in ends])} hang on no common body; name the "
            "palm with --palm BODY (if they hang on the world, put the palm into a body of its own)"
        )
    return max(candidates, key=lambda body: len(ancestors(model, body)))


def branch_ends(model: mujoco.MjModel, moving: set[int]) -> list[int]:
    """Moving bodies that carry no other."""
    return [body for body in sorted(moving) if not moving & (set(subtree(model, body)) - {body})]


def _palms(model: mujoco.MjModel, moving: set[int]) -> list[int]:
    """Bodies on which at least three moving branches begin, and no other such body."""
    branches = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        branches[model.body_parentid[body]] += bool(moving & set(subtree(model, body)))
    wide = {body for body in range(1, model.nbody) if branches[body] >= MIN_BRANCHES}
    return [body for body in sorted(wide) if not wide & (set(subtree(model, body)) - {body})]
