"""Which way the joints of a hand close."""

from __future__ import annotations

import numpy as np

from fungrasp.hands.kinematics import HandKinematics

BENT = 1.3
"""A finger that is shorter by this factor at both limits of a joint bends to both sides."""

TOWARD = 0.35
"""Cosine of the angle to the closing direction within which a tip moves as its finger bends: fingers a third
of a turn apart have 0.5."""

NEAR_ZERO = 0.25
"""A thumb's limit this much nearer to zero than the other is that of the open thumb."""

STEP = 1e-3
"""For derivatives [rad]."""


def partly_closed(kinematics: HandKinematics, share: float) -> np.ndarray:
    """Independent joints that have gone a share of their way from open to closed [rad], shape [U].

    A joint closes towards the limit to which its fingertip moves out of the palm, a thumb's joint away from
    zero; joints that do neither are taken to close towards their upper limits. A finger that bends to both
    sides is open where it is straight, and its thumb closes towards the other tips.

    Args:
        kinematics: of 5 copies of any hand; they are moved.
        share: 0 is open, 1 is closed.
    """
    lower, upper = kinematics.lower, kinematics.upper
    middle = 0.5 * (lower + upper)
    start = np.empty_like(lower)
    # Not on a limit, where fingers may be straight and the derivative small.
    others = np.clip(np.zeros_like(lower), 0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper)
    for u in range(len(lower)):
        trial = np.repeat(others[None], 5, axis=0)
        trial[:, u] = lower[u], middle[u], upper[u], others[u] - STEP, others[u] + STEP
        length, closing, is_thumb = _moved_finger(kinematics, trial)
        both_ways = length[1] > BENT * max(length[0], length[2])
        # Thumbs turn as well as bend: only a range on the negative side tells that they close downwards.
        negative = closing < -TOWARD if both_ways or not is_thumb else abs(upper[u]) < NEAR_ZERO * -lower[u]
        opened, closed = (upper[u], lower[u]) if negative else (lower[u], upper[u])
        if both_ways:
            opened = middle[u]
        start[u] = opened + share * (closed - opened)
    return start


def _moved_finger(kinematics: HandKinematics, independent: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Of the finger that a joint moves most: its length [m], shape [5], the cosine of the angle between its
    tip's motion from copy 3 to copy 4, which differ in that joint, and the direction in which it closes, and
    whether it is the thumb."""
    hand = kinematics.hand
    kinematics.update(None, independent)
    points = kinematics.points(kinematics.body_points(hand.keypoint_names))
    counts = np.array([len(finger.links) for finger in hand.fingers.values()])
    last = np.cumsum(counts + 1)
    bases, tips = points[:, last - counts], points[:, last]
    thumb = list(hand.fingers).index("thumb")
    moved = int(np.linalg.norm(np.ptp(tips, axis=0), axis=1).argmax())
    toward = hand.palm_normal
    if moved == thumb:
        toward = np.delete(tips[3], thumb, axis=0).mean(axis=0) - tips[3, thumb]
    motion = tips[4, moved] - tips[3, moved]
    size = np.linalg.norm(motion) * np.linalg.norm(toward)
    length = np.linalg.norm(tips - bases, axis=-1)[:, moved]
    return length, float(motion @ toward / max(size, 1e-12)), moved == thumb
