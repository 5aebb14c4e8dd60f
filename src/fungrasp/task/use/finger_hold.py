"""How fingers hold an object that is used: they give way as little as their torques allow."""

from __future__ import annotations

import numpy as np

from fungrasp.hands import Hand

HOLD_GAIN = 0.3
"""Share of a joint's displacement by which its setpoint goes against it, at each setpoint: with 0.1 fewer
objects stay in the hand, and much more overshoots, as a joint follows its setpoints late."""


class FingerHold:
    """Setpoints of the fingers of W hands that hold something.

    A servo alone is a spring: a finger of 4 N m/rad yields by a centimeter to 3 N. Integral control of the
    joint angles moves the setpoints until the joints are where they were, as far as the torque limits allow.
    It needs the encoders alone, and no bias of theirs matters.
    """

    def __init__(self, hand: Hand, setpoints: np.ndarray, joints: np.ndarray):
        """
        Args:
            hand: the robot hand.
            setpoints: of the independent joints in the hold [rad], shape [W, U].
            joints: where these are [rad], shape [W, U].
        """
        servos = hand.actuators.values()
        self._most = np.array([servo.force_limit / servo.kp for servo in servos])
        self._reference, self._setpoints = joints.copy(), setpoints.copy()

    def keep(self, joints: np.ndarray) -> np.ndarray:
        """The next setpoints [rad], shape [W, U]. joints: where they are [rad], shape [W, U]."""
        moved = self._setpoints + HOLD_GAIN * (self._reference - joints)
        # A setpoint beyond the torque limit would only make the joint come back late.
        self._setpoints = np.clip(moved, joints - self._most, joints + self._most)
        return self._setpoints
