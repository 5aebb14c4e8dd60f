"""What stands behind an emulator: joints that move when commanded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class PlantCommand:
    """What a device's electronics tell its motors. With neither positions nor torques: no power."""

    positions: np.ndarray | None = None
    """Goal of position servos [rad], shape [U]."""
    torques: np.ndarray | None = None
    """Torques of torque-controlled motors [N m], shape [U]."""
    velocity_limits: np.ndarray | None = None
    """Highest speeds of position servos [rad/s], shape [U]; None: the plant's own."""
    torque_limits: np.ndarray | None = None
    """Highest torques of position servos [N m], shape [U]; None: the plant's own."""


@dataclass(frozen=True, eq=False)
class PlantState:
    """True state of the joints."""

    positions: np.ndarray
    """[rad], shape [U]."""
    velocities: np.ndarray
    """[rad/s], shape [U]."""
    torques: np.ndarray
    """Torques of the motors [N m], shape [U]."""


class Plant(Protocol):
    """Joints of an arm or a hand, in the order of its driver. May be called from several threads."""

    def apply(self, command: PlantCommand, now: float) -> None:
        """Take a command at host time ``now`` [s]; it stays until the next."""
        ...

    def state(self, now: float) -> PlantState:
        """State at host time ``now`` [s], which never decreases."""
        ...
