"""Settings of retargeting, without heavy imports."""

from __future__ import annotations

from dataclasses import dataclass, field

from fungrasp.core.errors import UnknownNameError
from fungrasp.core.records import CheckedRecord

METHODS = ("contact", "angle-copy", "dexgraspnet")
"""Retargeting methods: our own (contacts and forces) and two baselines."""


@dataclass(frozen=True)
class RetargetSettings(CheckedRecord):
    """Scale of each cost term (the value that counts as one unit), and iterations."""

    fingertip_unit: float = 0.01
    """Distance between robot and human fingertip, first stage [m]."""
    direction_unit: float = 0.5
    """Difference between unit vectors along a link, first and second stage [-]."""
    contact_unit: float = 0.003
    """Distance between contact points of robot and human [m]."""
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
    closure_unit: float = 0.03
    """Unbalanced part of contact forces that sum to one [-]."""
    closure_friction: float = 0.2
    """Friction coefficient in the force balance, well below the nominal one [-]."""
    posture_unit: float = 0.4
    """Difference between unit vectors along a link, third stage [-]."""
    iterations: tuple[int, int, int] = (6, 5, 12)
    """Solver iterations of the three stages."""
    starts: int = 16
    """Maximum number of further starts of the solver, for grasps that are not as shown. Their turns and
    shifts of the palm are random, the same for every grasp."""
    start_turn: float = 0.2
    """Standard deviation of their turns about each axis of the palm [rad]."""
    start_shift: float = 0.01
    """Standard deviation of their shifts along each axis of the palm [m]."""


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
