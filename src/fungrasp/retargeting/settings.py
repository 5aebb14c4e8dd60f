"""How human grasps are retargeted: settings, without what retargets."""

from __future__ import annotations

from dataclasses import dataclass, field

from fungrasp.core.errors import UnknownNameError

METHODS = ("contact", "angle-copy", "dexgraspnet")
"""Methods of retargeting: our own by contacts and forces, and two baselines."""


@dataclass(frozen=True)
class Start:
    """How a start differs from the hand that is laid along the person's. Axes are those of a right hand's
    palm: along the fingers, out of the palm, and across; those of a left hand are mirrored."""

    turn: tuple[float, float, float]
    """Rotation vector about the mean fingertip [rad]."""
    shift: tuple[float, float, float]
    """Of the wrist, afterwards [m]."""
    contact_unit: float = 0.002
    """Distance of where a link touches from where the person does [m]."""
    closure_unit: float = 0.03
    """Unbalanced part of contact forces that sum to one [-]."""


STARTS = (
    Start((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.003, 0.03),
    Start((0.04, -0.22, 0.7), (0.01, -0.014, 0.0), 0.001, 0.1),
    Start((0.07, 0.03, -0.21), (0.0, -0.024, -0.014), 0.002, 0.03),
    Start((0.24, 0.0, 0.23), (0.017, -0.008, 0.002), 0.002, 0.1),
)
"""Of 69 near the person's hand those that, one after another, lowered the cost of five hands' grasps most."""


@dataclass(frozen=True)
class RetargetSettings:
    """The size at which each term of the objective counts as one unit, and numbers of iterations."""

    fingertip_unit: float = 0.01
    """Distance of a fingertip from the human one, first stage [m]."""
    direction_unit: float = 0.5
    """Difference of the unit vectors along a link, first and second stage [-]."""
    gap_unit: float = 0.001
    """Gap between a link that should touch and the object [m]."""
    soft_object_unit: float = 0.003
    """Penetration of the object, second stage [m]: links on the wrong side of a wall can still pass it."""
    object_unit: float = 0.0003
    """Penetration of the object [m]."""
    table_unit: float = 0.0002
    """Penetration of the table [m]."""
    table_margin: float = 0.001
    """Distance to keep from the table [m]."""
    self_unit: float = 0.0005
    """Penetration of the hand by itself [m]."""
    closure_friction: float = 0.2
    """Friction coefficient that the balance may use; well below the nominal one [-]."""
    posture_unit: float = 0.4
    """Difference of the unit vectors along a link, third stage [-]."""
    iterations: tuple[int, int, int] = (6, 5, 12)
    """Solver iterations of the three stages."""
    starts: tuple[Start, ...] = STARTS
    """Grasps that are not firm or not as shown are solved again from the second on, until they are."""


def method_name(name: str) -> str:
    """The name of a retargeting method, checked.

    Raises:
        FungraspError: there is none of this name.
    """
    if name not in METHODS:
        raise UnknownNameError("retargeting method", name, METHODS)
    return name


@dataclass(frozen=True)
class RetargetSpec:
    """How human grasps are retargeted."""

    hand: str = "allegro"
    """Name of the robot hand, or the path of its TOML file."""
    method: str = "contact"
    """Retargeting method: contact, angle-copy or dexgraspnet."""
    settings: RetargetSettings = field(default_factory=RetargetSettings)
    """Weights and iterations."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: no such method.
        """
        object.__setattr__(self, "method", method_name(self.method))
