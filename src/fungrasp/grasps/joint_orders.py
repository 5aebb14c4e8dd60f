"""Orders in which other programs give the 21 joints of a hand, and where ours are in them."""

from __future__ import annotations

import numpy as np

from fungrasp.core.errors import UnknownNameError

OPENPOSE = np.array([0, *range(5, 21), *range(1, 5)])
"""Wrist, then thumb, index, middle, ring, little finger, each from its base to its tip: OpenPose, HaMeR,
WiLoR, FreiHAND, MediaPipe."""

MANO = np.array([0, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20, 13, 14, 15, 16])
"""MANO's 16 joints (wrist, index, middle, little finger, ring, thumb, three each), then the tips of thumb,
index, middle, ring and little finger."""

ORDERS = {"openpose": OPENPOSE, "mano": MANO, "fungrasp": np.arange(21)}
"""Index, by order, of each of ``HUMAN_JOINTS``."""


def joint_order(name: str) -> np.ndarray:
    """Where each of ``HUMAN_JOINTS`` is in an order, shape [21].

    Raises:
        FungraspError: no such order.
    """
    if name not in ORDERS:
        raise UnknownNameError("order of joints", name, ORDERS)
    return ORDERS[name]
