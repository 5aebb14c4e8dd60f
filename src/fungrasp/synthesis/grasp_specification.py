"""Specifications of human grasps: object, task, part, and kind of grasp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.grasps import HUMAN_LINKS
from fungrasp.objects import ObjectModel

Vector3 = tuple[float, float, float]

WHOLE = "whole"
"""Name of the part with an object's whole surface."""


@dataclass(frozen=True)
class GraspKind:
    """A kind of grasp: how the hand approaches and closes."""

    open: tuple[float, ...]
    """Joints before closing [rad], length 21: mcp, spread, pip, dip of index, middle, ring and pinky; five of
    the thumb."""
    closed: tuple[float, ...]
    """Joints at the end of closing without an object [rad]; each finger stops when it touches."""
    center: Vector3
    """Position of the held point between the open fingers [m], palm frame: x out of the palm, y to the
    thumb's side, z to the fingers."""
    contacts: tuple[str, ...]
    """Human links that must touch the object."""
    palm: bool = False
    """Whether the hand approaches until its palm touches."""
    radial: tuple[str, ...] = ()
    """Links that touch with the side towards the thumb instead of the pad."""

    def __post_init__(self) -> None:
        for angles in (self.open, self.closed):
            if len(angles) != 21:
                raise FungraspError(f"a grasp kind needs 21 joint angles, not {len(angles)}")
        for link in (*self.contacts, *self.radial):
            if link not in HUMAN_LINKS:
                raise UnknownNameError("human link", link, HUMAN_LINKS)


@dataclass(frozen=True)
class GraspSpecification:
    """One human grasp to synthesize.

    Directions and places are in the object's frame. They need not be exact: the hand settles near them.
    """

    object: str
    """Name of the object."""
    task: str
    """Task: "drink", "cut", ..."""
    part: str
    """Part of the object to hold, or ``WHOLE``."""
    kind: str
    """One of ``GRASP_KINDS``."""
    at: Vector3
    """Held point [m]: a point inside the part, or between the fingers."""
    palm: Vector3
    """Direction out of the palm, towards the object."""
    fingers: Vector3
    """Direction from the wrist to the fingers. The thumb's side is then ``fingers x palm``."""
    contacts: tuple[str, ...] = ()
    """Human links that must touch. Default: those of the kind."""
    parts: Mapping[str, str] = field(default_factory=dict)
    """Other parts for some fingers or links to touch: ``{"index": "trigger"}``."""
    places: Mapping[str, Vector3] = field(default_factory=dict)
    """Surface points for some links to touch [m]: ``{"thumb_distal": (0.05, 0.0, 0.03)}``."""
    up: Vector3 = (0.0, 0.0, 1.0)
    """Direction that points up while the object rests on the table."""

    def __post_init__(self) -> None:
        if self.kind not in GRASP_KINDS:
            raise UnknownNameError("kind of grasp", self.kind, GRASP_KINDS)
        fingers = {link.split("_")[0] for link in HUMAN_LINKS}
        for name in (*self.contacts, *self.places):
            if name not in HUMAN_LINKS:
                raise UnknownNameError("human link", name, HUMAN_LINKS)
        for name in self.parts:
            if name not in fingers and name not in HUMAN_LINKS:
                raise UnknownNameError("finger or human link", name, (*sorted(fingers), *HUMAN_LINKS))
        x, z = np.array(self.palm, float), np.array(self.fingers, float)
        if not np.linalg.norm(np.cross(x, z)) > 0.1 * np.linalg.norm(x) * np.linalg.norm(z) > 0:
            raise FungraspError(
                f"a grasp of '{self.object}' has the palm along {self.palm} and the fingers along "
                f"{self.fingers}; they must not be parallel or zero"
            )

    @property
    def links(self) -> tuple[str, ...]:
        """Human links that must touch the object."""
        return self.contacts or GRASP_KINDS[self.kind].contacts

    @property
    def part_of_link(self) -> dict[str, str]:
        """Part that each of ``links`` must touch."""
        return {
            link: self.parts.get(link, self.parts.get(link.split("_")[0], self.part)) for link in self.links
        }

    def rest_pose(self, model: ObjectModel) -> np.ndarray:
        """Return the pose on the table with ``up`` up and the origin above the world's, world frame, shape
        [7]."""
        up = np.array(self.up, float) / np.linalg.norm(self.up)
        axis = np.array([up[1], -up[0], 0.0])
        sine = np.linalg.norm(axis)
        turn = (
            axis / sine * np.arctan2(sine, up[2])
            if sine > 1e-9
            else np.array([np.pi * (up[2] < 0), 0.0, 0.0])
        )
        return np.array([0.0, 0.0, -(model.vertices @ up).min(), *quaternion_from_rotation_vector(turn)])

    @property
    def all_parts(self) -> frozenset[str]:
        """All parts that the hand must touch."""
        return frozenset((self.part, *self.parts.values()))

    def turned(self, angle: float, about: Sequence[float] = (0.0, 0.0)) -> GraspSpecification:
        """Rotate the specification about an object's axis of symmetry, parallel to z.

        Args:
            angle: [rad], from x towards y.
            about: intersection of the axis with the plane z = 0 [m].
        """
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        center = np.array([*about, 0.0])

        def direction(v: Vector3) -> Vector3:
            x, y, z = turn @ v
            return (float(x), float(y), float(z))

        def point(p: Vector3) -> Vector3:
            x, y, z = turn @ (np.array(p) - center) + center
            return (float(x), float(y), float(z))

        return replace(
            self,
            at=point(self.at),
            palm=direction(self.palm),
            fingers=direction(self.fingers),
            places={link: point(p) for link, p in self.places.items()},
        )


def _joints(
    fingers: Sequence[tuple[float, float, float]],
    thumb: Sequence[float],
    spread: Sequence[float] = (0, 0, 0, 0),
) -> tuple[float, ...]:
    """Return 21 angles from (mcp, pip, dip) of one or four fingers, five of the thumb, and spreads."""
    four = list(fingers) * (4 // len(fingers))
    rows = [(mcp, side, pip, dip) for (mcp, pip, dip), side in zip(four, spread, strict=True)]
    return (*(angle for row in rows for angle in row), *thumb)


_FIST = (1.35, 1.65, 0.9)

GRASP_KINDS: dict[str, GraspKind] = {
    "wrap": GraspKind(
        open=_joints([(0.1, 0.3, 0.15)], (0.45, -0.45, -0.2, 0.0, 0.0)),
        closed=_joints([_FIST], (0.45, 0.6, 0.7, 0.0, 0.8)),
        center=(0.035, 0.0, 0.085),
        contacts=(
            "palm",
            "index_middle",
            "middle_middle",
            "ring_middle",
            "middle_distal",
            "index_distal",
            "thumb_distal",
        ),
        palm=True,
    ),
    "cover": GraspKind(
        open=_joints([(0.3, 0.3, 0.15)], (0.5, 0.3, 0.0, 0.0, 0.1)),
        closed=_joints([_FIST], (-0.1, 0.55, 0.4, 0.0, 0.6)),
        center=(0.035, 0.0, 0.09),
        contacts=("index_distal", "middle_distal", "ring_distal", "thumb_distal"),
        palm=True,
    ),
    "handle": GraspKind(
        open=_joints(
            [(0.25, 1.35, 0.7), (0.25, 1.35, 0.7), (0.6, 1.3, 0.6), (1.0, 1.2, 0.4)],
            (-0.4, -0.1, 0.0, 0.0, 0.0),
        ),
        closed=_joints(
            [(0.6, 1.6, 1.0)] * 2 + [(0.9, 1.5, 0.9), (1.25, 1.3, 0.6)], (-0.5, 0.5, 0.5, 0.0, 0.6)
        ),
        center=(0.024, 0.009, 0.106),
        contacts=("index_middle", "middle_middle", "index_distal", "middle_distal", "thumb_distal"),
    ),
    "fist": GraspKind(
        open=_joints([(0.3, 1.2, 0.6)] * 3 + [(0.6, 1.1, 0.4)], (-0.3, -0.2, 0.0, 0.0, 0.0)),
        closed=_joints([(0.9, 1.6, 0.9)] * 3 + [(1.1, 1.3, 0.6)], (-0.3, 0.6, 0.6, 0.0, 0.7)),
        center=(0.029, -0.008, 0.104),
        contacts=(
            "index_middle",
            "middle_middle",
            "ring_middle",
            "index_distal",
            "middle_distal",
            "thumb_distal",
        ),
    ),
    "pistol": GraspKind(
        open=_joints([(0.15, 0.45, 0.2)] + [(0.3, 0.6, 0.3)] * 3, (0.1, -0.3, -0.1, 0.0, 0.0)),
        closed=_joints([(0.7, 1.1, 0.5)] + [_FIST] * 3, (0.1, 0.6, 0.7, 0.0, 0.8)),
        center=(0.035, 0.0, 0.085),
        contacts=("palm", "middle_middle", "ring_middle", "middle_distal", "index_distal", "thumb_distal"),
        palm=True,
    ),
    "tripod": GraspKind(
        open=_joints(
            [(0.65, 0.45, 0.2), (0.75, 0.7, 0.3), (0.9, 1.0, 0.4), (0.95, 1.1, 0.4)],
            (0.0, 0.05, 0.0, 0.0, 0.1),
        ),
        closed=_joints(
            [(1.2, 0.8, 0.4), (1.2, 1.0, 0.5), (1.0, 1.2, 0.5), (1.0, 1.2, 0.5)], (0.0, 0.6, 0.5, 0.0, 0.6)
        ),
        center=(0.082, 0.02, 0.105),
        contacts=("index_distal", "middle_distal", "thumb_distal"),
        radial=("middle_distal",),
    ),
    "pinch": GraspKind(
        open=_joints(
            [(0.65, 0.35, 0.15)] * 2 + [(0.85, 0.9, 0.4), (0.9, 1.0, 0.4)], (0.5, 0.35, 0.0, 0.0, 0.1)
        ),
        closed=_joints([(1.3, 0.7, 0.4)] * 2 + [(1.0, 1.2, 0.5)] * 2, (-0.1, 0.55, 0.4, 0.0, 0.6)),
        center=(0.085, 0.012, 0.108),
        contacts=("index_distal", "middle_distal", "thumb_distal"),
    ),
    "prism": GraspKind(
        open=_joints([(0.6, 0.4, 0.2)], (0.5, 0.35, 0.0, 0.0, 0.1)),
        closed=_joints([(1.35, 0.7, 0.4)], (-0.1, 0.55, 0.4, 0.0, 0.6)),
        center=(0.085, 0.0, 0.105),
        contacts=("index_distal", "middle_distal", "ring_distal", "thumb_distal"),
    ),
    "disk": GraspKind(
        open=_joints([(0.35, 0.35, 0.2)], (0.2, 0.0, -0.2, 0.0, 0.0), (0.2, 0.05, -0.1, -0.25)),
        closed=_joints([(1.1, 1.0, 0.6)], (0.2, 0.6, 0.6, 0.0, 0.7), (0.2, 0.05, -0.1, -0.25)),
        center=(0.075, 0.0, 0.10),
        contacts=("index_distal", "middle_distal", "ring_distal", "thumb_distal"),
    ),
}
"""Kinds of grasps by name."""
