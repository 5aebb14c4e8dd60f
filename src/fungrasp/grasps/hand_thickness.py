"""Half the thickness of an adult's hand: what is between its bones and its skin."""

from __future__ import annotations

import numpy as np

FINGER_RADII = np.array([[10.5, 9.5, 8.5, 7.8]] * 4 + [[17.0, 12.5, 10.5, 9.0]]) * 1e-3
"""At the four joints of each finger [m], shape [5, 4], in the order of ``FINGERS``; the thumb's first lies in
its ball."""

WRIST_RADIUS = 0.022
"""At the wrist [m]."""

PALM_RADIUS = 0.014
"""In the middle of the palm [m]."""

PALM_BALL_RADIUS = 0.0165
"""Of the palm with its balls, at the wrist's end [m]."""

LINK_RADII = np.array([0.012] + [0.010, 0.009, 0.008] * 4 + [0.012, 0.011, 0.010])
"""In the middle of each link [m], in the order of ``HUMAN_LINKS``, for those who look at links and not at
joints."""

FOREARM_RADII = np.array([0.018, 0.028])
"""Of the bare forearm at the wrist and 0.25 m from it [m]."""
