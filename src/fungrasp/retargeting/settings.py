"""Settings of retargeting, without heavy imports."""

from __future__ import annotations

from dataclasses import dataclass, field

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.records import CheckedRecord

METHODS = ("contact", "angle-copy", "dexgraspnet")
"""Retargeting methods: our own (contacts and forces) and two baselines."""


@dataclass(frozen=True)
class Start(CheckedRecord):
    """A start of the solver, relative to the robot hand aligned with the human's. Axes of a right palm: along
    the fingers, out of the palm, across it; mirrored for a left hand."""

    turn: tuple[float, float, float]
    """Rotation vector about the mean fingertip [rad]."""
    shift: tuple[float, float, float]
    """Shift of the wrist after the rotation [m]."""
    contact_unit: float = 0.002
    """Distance between contact points of robot and human [m]."""
    closure_unit: float = 0.03
    """Unbalanced part of contact forces that sum to one [-]."""


STARTS = (
    Start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.003, 0.03),
    Start((0.04, -0.22, 0.7), (0.01, -0.014, 0.0), 0.001, 0.1),
    Start((0.07, 0.03, -0.21), (0.0, -0.024, -0.014), 0.002, 0.03),
    Start((0.24, 0.0, 0.23), (0.017, -0.008, 0.002), 0.002, 0.1),
)
"""Four of 69 starts, selected greedily by the reduction of the cost over the grasps of five hands."""


@dataclass(frozen=True)
class RetargetSettings(CheckedRecord):
    """Scale of each cost term (the value that counts as one unit), and iterations."""

    fingertip_unit: float = 0.01
    """Distance between robot and human fingertip, first stage [m]."""
    direction_unit: float = 0.5
    """Difference between unit vectors along a link, first and second stage [-]."""
    gap_unit: float = 0.001
    """Gap between the object and a link that should touch it [m]."""
    soft_object_unit: float = 0.003
    """Penetration of the object, second stage [m]: loose, so that links can still pass through a wall."""
    object_unit: float = 0.0003
    """Penetration of the object [m]."""
    table_unit: float = 0.0002
    """Penetration of the table [m]."""
    table_margin: float = 0.001
    """Distance to keep from the table [m]."""
    self_unit: float = 0.0005
    """Self-penetration of the hand [m]."""
    closure_friction: float = 0.2
    """Friction coefficient in the force balance, well below the nominal one [-]."""
    posture_unit: float = 0.4
    """Difference between unit vectors along a link, third stage [-]."""
    iterations: tuple[int, int, int] = (6, 5, 12)
    """Solver iterations of the three stages."""
    starts: tuple[Start, ...] = STARTS
    """Starts of the solver. Grasps that are not firm or not as shown are solved again from the next start."""
    further_starts: int = 16
    """Maximum number of random starts that follow, for grasps that are not as shown or penetrate the
    object."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a setting has another type, or the number of random starts is negative.
        """
        super().__post_init__()
        if self.further_starts < 0:
            raise FungraspError(f"further_starts must not be negative, not {self.further_starts}")


def method_name(name: str) -> str:
    """Check the name of a retargeting method.

    Raises:
        FungraspError: the method is unknown.
    """
    if name not in METHODS:
        raise UnknownNameError("retargeting method", name, METHODS)
    return name


@dataclass(frozen=True)
class RetargetSpec(CheckedRecord):
    """Settings of retargeting: hand, method and weights."""

    hand: str = "allegro"
    """Name of the robot hand, or the path of its TOML file."""
    method: str = "contact"
    """Retargeting method: contact, angle-copy or dexgraspnet."""
    settings: RetargetSettings = field(default_factory=RetargetSettings)
    """Weights and iterations."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: the method is unknown.
        """
        super().__post_init__()
        object.__setattr__(self, "method", method_name(self.method))
