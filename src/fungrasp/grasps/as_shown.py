"""Whether a robot hand holds an object where and how the person held it (docs/evaluate.md, "Held as shown").

The same fingers touch at the same places from the same side. Wanted are the finger links that stand for
human links in contact; the palm is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import compose, inverse_transform_points, invert
from fungrasp.geometry.signed_distance import SignedDistanceBank, project_to_surface
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.robot_grasp import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres
from fungrasp.hands.correspondence import Correspondence, correspond
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import nearest_surface_points

NEAR = 0.02
"""Largest distance between contacts of link and person that counts as the same place [m]."""

TOUCH = 0.005
"""Clearance below which a link touches, in static grasps [m]."""

STRAY = 0.03
"""A contact farther than this from all contacts of the person is a stray [m]."""

ENOUGH = 2 / 3
"""Share of the wanted links that must be as shown."""


class ShownGrasps(Protocol):
    """What robot grasps and plans have in common."""

    @property
    def object_name(self) -> np.ndarray:
        """Shape [N] str."""
        ...

    @property
    def link_contacts(self) -> np.ndarray:
        """Shape [N, L] bool."""
        ...

    @property
    def shown_places(self) -> np.ndarray | None:
        """Shape [N, L - 1, 3]."""
        ...

    @property
    def shown_normals(self) -> np.ndarray | None:
        """Shape [N, L - 1, 3]."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class AsShown(BatchRecord):
    """Agreement of N grasps with the person's, for S finger links. NaN if no link is wanted."""

    holds: np.ndarray
    """Whether the thumb is as shown, where it is wanted, and at least ``ENOUGH`` of the wanted links are,
    shape [N] bool."""
    share: np.ndarray
    """Share of the wanted links that are as shown, shape [N]."""
    place_error: np.ndarray
    """Mean distance of the wanted links' places from the person's [m], shape [N]."""
    other_side: np.ndarray
    """Share of the wanted links on the other side of the surface, shape [N]."""
    strays: np.ndarray
    """Number of links that touch more than ``STRAY`` from every place of the person, shape [N]."""
    points: np.ndarray
    """Surface point nearest to the point of each link that is nearest to the object, object frame [m], shape
    [N, S, 3]."""
    errors: np.ndarray
    """Distance of each link's point from the person's place [m], shape [N, S]; meaningless where the link
    neither is wanted nor touches."""
    turned: np.ndarray
    """Links on the other side of the surface, shape [N, S] bool."""
    shown: np.ndarray
    """Wanted links that are as shown, shape [N, S] bool."""
    reason: np.ndarray
    """Why a grasp is not as shown, else "", shape [N] str."""


@dataclass(frozen=True, eq=False, repr=False)
class ShownContacts(BatchRecord):
    """Where the person touched in N grasps, by the robot's S finger links; object frame."""

    object_name: np.ndarray
    """Names of the objects, shape [N] str."""
    wanted: np.ndarray
    """Links that should touch, shape [N, S] bool."""
    places: np.ndarray
    """Surface points [m], shape [N, S, 3]."""
    normals: np.ndarray
    """Outward unit normals of the surface there, shape [N, S, 3]."""

    @classmethod
    def of(cls, grasps: ShownGrasps) -> ShownContacts | None:
        """Those of robot grasps or plans; None if they don't know them."""
        if grasps.shown_places is None or grasps.shown_normals is None:
            return None
        wanted = grasps.link_contacts[:, 1:]
        return cls(grasps.object_name, wanted, grasps.shown_places, grasps.shown_normals)


def shown_places(
    human: HumanGraspSet, objects: Mapping[str, ObjectModel], match: Correspondence
) -> tuple[np.ndarray, np.ndarray]:
    """Where the person would touch with what each of the robot's finger links stands for: the surface point
    nearest to the human joint at the link's far end, and the outward unit normal there.

    Args:
        human: N grasps.
        objects: by name, each object of the grasps.
        match: of the robot hand, S finger links.

    Returns:
        Places [m] and normals, object frame, shape [N, S, 3] each.
    """
    models, index, bank = _grouped(human.object_name.tolist(), objects)
    joints = inverse_transform_points(human.object_pose, human.hand_joints)[:, match.human_far]
    everywhere = np.ones(joints.shape[:2], dtype=bool)
    places = nearest_surface_points(models, index, joints, everywhere)
    return places, project_to_surface(bank, index, joints)[1]


def with_shown_places(
    robot: RobotGraspSet, human: HumanGraspSet, objects: Mapping[str, ObjectModel], hand: Hand | None = None
) -> RobotGraspSet:
    """Robot grasps that know where the person touched.

    Args:
        robot: N grasps.
        human: what they were retargeted from, in the same order.
        hand: theirs; it is loaded if None.
    """
    places, normals = shown_places(human, objects, correspond(hand or robot.load_hand()))
    return replace(robot, shown_places=places, shown_normals=normals)


class ShownJudge:
    """Compares grasps of one hand with the person's."""

    def __init__(self, hand: Hand, objects: Mapping[str, ObjectModel]):
        self.hand = hand
        """The hand."""
        self._objects = objects
        self._spheres, self._thumb = collision_spheres(hand), correspond(hand).is_thumb

    def __call__(
        self,
        palm_pose: np.ndarray,
        joint_positions: np.ndarray,
        shown: ShownContacts,
        touching: np.ndarray | None = None,
    ) -> AsShown:
        """Compare N grasps with the person's.

        Args:
            palm_pose: object frame, shape [N, 7].
            joint_positions: of all joints [rad], shape [N, M].
            shown: where the person touched, N rows.
            touching: links that touch the object, shape [N, S] bool; those nearer than ``TOUCH`` if None.
        """
        wanted, places, normals = shown.wanted, shown.places, shown.normals
        models, index, bank = _grouped(shown.object_name.tolist(), self._objects)
        kinematics = HandKinematics(self.hand, len(index))
        independent = (joint_positions - kinematics.offset) @ np.linalg.pinv(kinematics.matrix).T
        kinematics.update(palm_pose, independent)
        centers = kinematics.points(self._spheres.points)
        clearance = bank.query(index, centers)[0] - self._spheres.radius
        # The palm, link 0, is left out.
        nearest = np.stack(
            [
                np.where(self._spheres.link == link, clearance, np.inf).argmin(axis=1)
                for link in range(1, len(self.hand.links))
            ],
            axis=1,
        )
        found = np.take_along_axis(centers, nearest[..., None], axis=1)
        if touching is None:
            touching = np.take_along_axis(clearance, nearest, axis=1) < TOUCH
        points = nearest_surface_points(models, index, found, wanted | touching)
        outward = project_to_surface(bank, index, found)[1]
        error = np.linalg.norm(points - places, axis=-1)
        turned = (normals * outward).sum(axis=-1) < 0.0
        agree = wanted & touching & (error <= NEAR) & ~turned
        by_thumb = wanted & self._thumb
        thumb = ~by_thumb.any(axis=1) | (agree & self._thumb).any(axis=1)
        lost = np.select([~touching, error > NEAR, turned], [0, 1, 2], 3)
        number = np.where(wanted.any(axis=1), wanted.sum(axis=1), np.nan)
        share = agree.sum(axis=1) / number
        apart = np.linalg.norm(points[:, :, None] - places[:, None], axis=-1)
        apart = np.where(wanted[:, None, :], apart, np.inf).min(axis=-1)
        holds = thumb & (np.nan_to_num(share) >= ENOUGH - 1e-9)
        reason = np.select(
            [holds, ~wanted.any(axis=1), ~thumb],
            ["", "no link is wanted", _most("the thumb", lost, by_thumb)],
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
    """The K wanted links of one grasp, to be drawn; object frame."""

    places: np.ndarray
    """Where the person touched [m], shape [K, 3]."""
    points: np.ndarray
    """Where the robot does, or is nearest to the surface [m], shape [K, 3]."""
    shown: np.ndarray
    """Links that are as shown, shape [K] bool."""

    @property
    def words(self) -> str:
        """ "5 of 6 links, 8 mm"."""
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
    """What to draw of one grasp; None if it does not know where the person touched.

    Args:
        row: of the grasp in the set.
        touching: links that touch the object, shape [S] bool; those nearer than ``TOUCH`` if None.
        hand: theirs; it is loaded if None.
    """
    grasp = robot.select(np.array([row]))
    shown = ShownContacts.of(grasp)
    if shown is None:
        return None
    palm = compose(invert(grasp.object_pose), grasp.wrist_pose)
    judge = ShownJudge(hand or robot.load_hand(), objects)
    found = judge(palm, grasp.joint_positions, shown, None if touching is None else touching[None])
    wanted = shown.wanted[0]
    return PlaceMarks(shown.places[0, wanted], found.points[0, wanted], found.shown[0, wanted])


def _most(links: str, lost: np.ndarray, which: np.ndarray) -> np.ndarray:
    """What is wrong with most of some links, in words, shape [N] str.

    Args:
        links: what to call them.
        lost: 0 for a link that does not touch, 1 for one that is too far from the person's place, 2 for one
            on the other side, 3 for one as shown; shape [N, S].
        which: of the links, shape [N, S] bool.
    """
    number = [(which & (lost == kind)).sum(axis=1) for kind in range(3)]
    off = "is" if links.startswith("the ") else "are"
    apart = f"{off} more than {1e3 * NEAR:.0f} mm off"
    words = [f"do{'es' if off == 'is' else ''} not touch", apart, f"{off} on the other side"]
    return np.array([f"{links} {each}" for each in words])[np.argmax(number, axis=0)]


def _grouped(
    names: Sequence[str], objects: Mapping[str, ObjectModel]
) -> tuple[list[ObjectModel], np.ndarray, SignedDistanceBank]:
    """The objects that are named, the index of each name, and the bank of their distances."""
    known = sorted(set(names))
    models = [objects[name] for name in known]
    return models, np.searchsorted(known, names), SignedDistanceBank([m.signed_distance for m in models])
