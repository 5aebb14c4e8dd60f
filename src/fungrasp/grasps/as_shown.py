"""Compare robot grasps with the human grasps they imitate (docs/evaluate.md, "Held as shown").

In a grasp as shown, the same fingers touch at the same places from the same side. Wanted links are the finger
links that correspond to human links in contact; the palm is ignored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, project_to_surface
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.robot_grasp import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.collisions import CollisionSpheres, collision_spheres
from fungrasp.hands.correspondence import Correspondence, correspond
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_surface_points

NEAR = 0.02
"""Largest distance between contacts of robot and human at the same place [m]."""

TOUCH = 0.005
"""Clearance below which a link touches, in static grasps [m]."""

STRAY = 0.03
"""Distance from all human contacts beyond which a robot contact is a stray [m]."""

ENOUGH = 2 / 3
"""Share of the wanted links that must be as shown."""


class ShownGrasps(Protocol):
    """Common fields of robot grasps and plans."""

    @property
    def object_name(self) -> np.ndarray:
        """Names of the objects, shape [N] str."""
        ...

    @property
    def link_contacts(self) -> np.ndarray:
        """Links that should touch, palm first, shape [N, L] bool."""
        ...

    @property
    def shown_places(self) -> np.ndarray | None:
        """Human contact points, object frame [m], shape [N, L - 1, 3]."""
        ...

    @property
    def shown_normals(self) -> np.ndarray | None:
        """Outward unit normals at these points, object frame, shape [N, L - 1, 3]."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class AsShown(BatchRecord):
    """Comparison of N robot grasps with human ones, for S finger links. Shares and ``place_error`` are NaN if
    no link is wanted."""

    holds: np.ndarray
    """Whether at least ``ENOUGH`` of the wanted links are as shown, including the thumb if wanted, shape [N]
    bool."""
    share: np.ndarray
    """Share of the wanted links that are as shown, shape [N]."""
    place_error: np.ndarray
    """Mean distance of the wanted links from the human contacts [m], shape [N]."""
    other_side: np.ndarray
    """Share of the wanted links on the other side of the surface, shape [N]."""
    strays: np.ndarray
    """Number of touching links farther than ``STRAY`` from all human contacts, shape [N]."""
    points: np.ndarray
    """Surface point nearest to each link, object frame [m], shape [N, S, 3]."""
    errors: np.ndarray
    """Distance of each surface point from the link's human contact [m], shape [N, S]; meaningless for links
    that neither are wanted nor touch."""
    turned: np.ndarray
    """Links on the other side of the surface, shape [N, S] bool."""
    shown: np.ndarray
    """Wanted links that are as shown, shape [N, S] bool."""
    reason: np.ndarray
    """Reason for which a grasp is not as shown, or "", shape [N] str."""


@dataclass(frozen=True, eq=False, repr=False)
class ShownContacts(BatchRecord):
    """Human contacts in N grasps, for the robot's S finger links; object frame."""

    object_name: np.ndarray
    """Names of the objects, shape [N] str."""
    wanted: np.ndarray
    """Links that should touch, shape [N, S] bool."""
    places: np.ndarray
    """Points on the surface [m], shape [N, S, 3]."""
    normals: np.ndarray
    """Outward unit normals at these points, shape [N, S, 3]."""

    @classmethod
    def of(cls, grasps: ShownGrasps) -> ShownContacts | None:
        """Return the human contacts of robot grasps or plans; None if unknown."""
        if grasps.shown_places is None or grasps.shown_normals is None:
            return None
        wanted = grasps.link_contacts[:, 1:]
        return cls(grasps.object_name, wanted, grasps.shown_places, grasps.shown_normals)


def shown_places(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], match: Correspondence
) -> tuple[np.ndarray, np.ndarray]:
    """Return the human contact of each robot finger link: the surface point nearest to the human joint at the
    link's far end.

    Args:
        human: N grasps.
        objects: objects of the grasps by name.
        match: correspondence of a robot hand with S finger links.

    Returns:
        Points [m] and outward unit normals, object frame, shape [N, S, 3] each.
    """
    models, index, bank = _grouped(human.object_name.tolist(), objects)
    joints = inverse_transform_points(human.object_pose, human.hand_joints)[:, match.human_far]
    everywhere = np.ones(joints.shape[:2], dtype=bool)
    places = nearest_surface_points(models, index, joints, everywhere)
    return places, project_to_surface(bank, index, joints)[1]


def with_shown_places(
    robot: RobotGraspSet, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand | None = None
) -> RobotGraspSet:
    """Add human contacts to robot grasps.

    Args:
        robot: N grasps.
        human: the human grasps from which they were retargeted, in the same order.
        hand: hand of the robot grasps. None: loaded by name.
    """
    places, normals = shown_places(human, objects, correspond(hand or robot.load_hand()))
    return replace(robot, shown_places=places, shown_normals=normals)


class NearestPoints(NamedTuple):
    """Where the finger links of N hands are nearest to their objects, object frame."""

    centers: np.ndarray
    """Center of each link's nearest collision sphere [m], shape [N, S, 3]."""
    clearance: np.ndarray
    """Distance of this sphere from the surface [m], shape [N, S]."""
    points: np.ndarray
    """Surface point nearest to the center by the signed distances, up to 1 mm off [m], shape [N, S, 3]."""
    outward: np.ndarray
    """Outward unit normal at this point, shape [N, S, 3]."""


def nearest_points(
    kinematics: HandKinematics, spheres: CollisionSpheres, bank: SignedDistanceBank, index: np.ndarray
) -> NearestPoints:
    """Return where finger links are nearest to the object.

    Args:
        kinematics: N hands at their poses, object frame.
        spheres: ``collision_spheres(hand)``.
        bank, index: signed distances of objects, and each hand's object, shape [N].
    """
    centers = kinematics.points(spheres.points)
    clearance = bank.query(index, centers)[0] - spheres.radius
    nearest, gap = (each[:, 1:] for each in spheres.nearest(clearance, len(kinematics.hand.links)))
    found = np.take_along_axis(centers, nearest[..., None], axis=1)
    points, outward = project_to_surface(bank, index, found)
    return NearestPoints(found, gap, points, outward)


def holds_as_shown(
    shown: np.ndarray, wanted: np.ndarray, is_thumb: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whether N grasps are as shown, shape [N] bool, whether a thumb link is as shown or none is
    wanted, shape [N] bool, and the share of the wanted links that are as shown, shape [N], NaN without any.

    Args:
        shown, wanted: links that are as shown, and that should be, shape [N, S] bool.
        is_thumb: links of the thumb, shape [S] bool.
    """
    share = shown.sum(axis=1) / np.where(wanted.any(axis=1), wanted.sum(axis=1), np.nan)
    thumb = ~(wanted & is_thumb).any(axis=1) | (shown & is_thumb).any(axis=1)
    return thumb & (np.nan_to_num(share) >= ENOUGH - 1e-9), np.asarray(thumb), share


class ShownJudge:
    """Compares grasps of one robot hand with human grasps."""

    def __init__(self, hand: Hand, objects: Mapping[str, ObjectModel]):
        self.hand = hand
        """Robot hand."""
        self._objects = objects
        self._spheres, self._thumb = collision_spheres(hand), correspond(hand).is_thumb

    def __call__(
        self,
        palm_pose: np.ndarray,
        joint_positions: np.ndarray,
        shown: ShownContacts,
        touching: np.ndarray | None = None,
    ) -> AsShown:
        """Compare N robot grasps with human contacts.

        Args:
            palm_pose: pose of the palm body, object frame, shape [N, 7].
            joint_positions: all joints [rad], shape [N, M].
            shown: human contacts of N grasps.
            touching: links that touch the object, shape [N, S] bool. None: links nearer than ``TOUCH``.
        """
        wanted, places, normals = shown.wanted, shown.places, shown.normals
        models, index, bank = _grouped(shown.object_name.tolist(), self._objects)
        kinematics = HandKinematics(self.hand, len(index))
        kinematics.update(palm_pose, self.hand.independent(joint_positions))
        near = nearest_points(kinematics, self._spheres, bank, index)
        touching = near.clearance < TOUCH if touching is None else touching
        points = nearest_surface_points(models, index, near.centers, wanted | touching)
        error = np.linalg.norm(points - places, axis=-1)
        turned = (normals * near.outward).sum(axis=-1) < 0.0
        agree = wanted & touching & (error <= NEAR) & ~turned
        holds, thumb, share = holds_as_shown(agree, wanted, self._thumb)
        lost = np.select([~touching, error > NEAR, turned], [0, 1, 2], 3)
        number = np.where(wanted.any(axis=1), wanted.sum(axis=1), np.nan)
        apart = np.linalg.norm(points[:, :, None] - places[:, None], axis=-1)
        apart = np.where(wanted[:, None, :], apart, np.inf).min(axis=-1)
        reason = np.select(
            [holds, ~wanted.any(axis=1), ~thumb],
            ["", "no link is wanted", _most("the thumb", lost, wanted & self._thumb)],
            _most("fingers", lost, wanted & ~self._thumb),
        )
        return AsShown(
            holds=holds,
            share=share,
            place_error=(error * wanted).sum(axis=1) / number,
            other_side=(wanted & turned).sum(axis=1) / number,
            strays=(touching & (apart > STRAY)).sum(axis=1),
            points=points,
            errors=error,
            turned=turned,
            shown=agree,
            reason=reason,
        )


class PlaceMarks(NamedTuple):
    """Contacts of one grasp's K wanted links, for drawing; object frame."""

    places: np.ndarray
    """Human contacts [m], shape [K, 3]."""
    points: np.ndarray
    """Surface points nearest to the robot's links [m], shape [K, 3]."""
    shown: np.ndarray
    """Links that are as shown, shape [K] bool."""

    @property
    def words(self) -> str:
        """Summary, such as "5 of 6 links, 8 mm"."""
        if not len(self.shown):
            return "no link is wanted"
        error = 1e3 * np.linalg.norm(self.points - self.places, axis=1).mean()
        return f"{int(self.shown.sum())} of {len(self.shown)} links, {error:.0f} mm"


def place_marks(
    robot: RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    touching: np.ndarray | None = None,
    hand: Hand | None = None,
) -> PlaceMarks | None:
    """Return the contacts of one grasp for drawing; None if the human contacts are unknown.

    Args:
        row: index of the grasp.
        touching: links that touch the object, shape [S] bool. None: links nearer than ``TOUCH``.
        hand: hand of the grasps. None: loaded by name.
    """
    grasp = robot.select(np.array([row]))
    shown = ShownContacts.of(grasp)
    if shown is None:
        return None
    judge = ShownJudge(hand or robot.load_hand(), objects)
    found = judge(
        grasp.wrist_pose_object, grasp.joint_positions, shown, None if touching is None else touching[None]
    )
    wanted = shown.wanted[0]
    return PlaceMarks(shown.places[0, wanted], found.points[0, wanted], found.shown[0, wanted])


def _most(links: str, lost: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Return the most frequent fault of some links in words, shape [N] str.

    Args:
        links: name of these links.
        lost: 0 if a link does not touch, 1 if it is too far from the human contact, 2 if it is on the other
            side, 3 if it is as shown; shape [N, S].
        which: selected links, shape [N, S] bool.
    """
    number = [(which & (lost == kind)).sum(axis=1) for kind in range(3)]
    off = "is" if links.startswith("the ") else "are"
    apart = f"{off} more than {1e3 * NEAR:.0f} mm off"
    words = [f"do{'es' if off == 'is' else ''} not touch", apart, f"{off} on the other side"]
    return np.array([f"{links} {each}" for each in words])[np.argmax(number, axis=0)]


def _grouped(
    names: Sequence[str], objects: Mapping[str, ObjectModel]
) -> tuple[list[ObjectModel], np.ndarray, SignedDistanceBank]:
    """Return the named objects, the index of each name, and the objects' signed distances."""
    known = sorted(set(names))
    models = [objects[name] for name in known]
    return models, np.searchsorted(known, names), SignedDistanceBank([m.signed_distance for m in models])
