"""Check human grasps and find their convention.

Joint order, unit and side follow from bone lengths and from the direction in which fingers bend. The rest
follows from fingertips that touch the object and objects that rest on the table (``scene_checks``).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_conjugate, rotate
from fungrasp.grasps.contacts import link_contacts
from fungrasp.grasps.conversion import BELOW_TABLE, POSES, UNITS, Convention, Unit, settled_pose
from fungrasp.grasps.grasp_set import given_bounds
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import HUMAN_LINKS, ORDERS, bone_ratios, joint_bends, order_misfit
from fungrasp.grasps.scene_checks import GraspScene, Remark, scene_is_sound
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_variants import MIRRORED

ORDER_MISFIT = 0.35
"""Largest ``order_misfit`` of a hand with the right joint order: it is 0.16 for DexYCB's tracking, 0.3 with
errors of 5 mm at each joint."""

CLEARLY = 0.75
"""Largest ratio between the misfit of another joint order and that of fungrasp to recognize the other."""

HAND_SIZES = (0.5, 1.6)
"""Range of hand sizes relative to an adult's, for children and tracking errors."""

BENT = 0.6
"""Smallest sum of the bends of a hand's four fingers that determines its side [rad]."""

MUCH_TILTED = 30.0
"""Largest usual angle between an object's pose at the beginning of a grasp and at rest [degrees]."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GraspDiagnosis:
    """Diagnosis of human grasps."""

    count: int
    """Number of grasps."""
    remarks: tuple[Remark, ...]
    """Faults of the grasps."""
    convention: Convention
    """Convention of most grasps."""
    untested: tuple[str, ...] = ()
    """Messages about omitted tests."""

    @property
    def fatal(self) -> Remark | None:
        """First remark that makes more than half of the grasps unusable, or None."""
        return next((r for r in self.remarks if r.fatal and 2 * len(r.rows) > self.count), None)

    def require_usable(self, where: str, file: bool, mend: str) -> None:
        """Check that most grasps can be used.

        Args:
            where: beginning of the message.
            file: whether ``where`` is a file, for the remedy ``fungrasp grasps convert``.
            mend: remedy otherwise, with {} for the arguments of ``Convention``.

        Raises:
            FungraspError: most grasps cannot be used; the message names the remedy, if there is one.
        """
        if self.fatal is None:
            return
        remedy = ""
        if self.convention.changes and file:
            options = self.convention.as_options()
            remedy = f"; 'fungrasp grasps convert {where} {options} --out NEW.npz' converts it"
        elif self.convention.changes:
            remedy = f"; {mend.format(self.convention.as_arguments())}"
        raise FungraspError(f"{where}: {self.fatal}{remedy}")


def checked_grasps(
    arrays: Mapping[str, np.ndarray],
    objects: Mapping[str, ObjectModel],
    where: str = "the grasps",
    *,
    file: bool = False,
    read: bool = False,
    mend: str = "converted(fields, Convention({})) converts it",
) -> HumanGraspSet:
    """Create human grasps from their fields, with the checks of readers and of ``retarget``.

    If contacts are missing or all false, they are computed from the distance of hand and object. Missing rest
    poses are computed by ``settled_pose``.

    Args:
        arrays: fields of ``HumanGraspSet`` by name; "link_contacts" and "object_rest_pose" may be missing.
        objects: known objects by name.
        where: beginning of messages.
        file: whether ``where`` is a file.
        read: whether the grasps were checked before their objects were known. Then warnings about the joints
            are not repeated, and left hands are accepted.
        mend: remedy for another convention, with {} for the arguments of ``Convention``.

    Raises:
        FungraspError: the content is invalid, most grasps cannot be used, or a missing field cannot be
            computed because the object's mesh is unknown.
    """
    found = diagnosis(arrays, objects, sides=not read)
    found.require_usable(where, file, mend)
    for remark in found.remarks:
        if remark.scene or not read:
            _log.warning("%s: %s", where, remark)
    complete = completed(arrays, objects)
    if "object_rest_pose" not in arrays:
        _doubt_the_vertical(complete, where)
    missing = [n for n, f in HumanGraspSet.FIELDS.items() if n not in complete and not f.optional]
    if missing:
        given = ", ".join(sorted(arrays)) or "nothing"
        mesh = " ('grasps convert --objects FOLDER' computes it)" if missing[0] == "object_rest_pose" else ""
        raise FungraspError(f"{where}: field '{missing[0]}' is missing{mesh}; found: {given}")
    try:
        rows: dict[str, Any] = {n: a for n, a in complete.items() if n in HumanGraspSet.FIELDS}
        return HumanGraspSet(**rows, object_bounds=given_bounds(arrays))
    except FungraspError as error:
        raise FungraspError(f"{where}: {error}") from error


def _doubt_the_vertical(complete: Mapping[str, np.ndarray], where: str) -> None:
    """Warn if most objects tilt when they are put down, as they do if the world is a camera frame."""
    if "object_rest_pose" not in complete or not scene_is_sound(complete):
        return
    vertical = np.array([0.0, 0.0, 1.0])
    up = [rotate(quaternion_conjugate(complete[name][:, 3:].astype(float)), vertical) for name in POSES]
    tilt = np.degrees(np.arccos(np.clip(np.sum(up[0] * up[1], axis=1), -1, 1)))
    if len(tilt) and np.median(tilt) > MUCH_TILTED:
        _log.warning(
            "%s: put down on the table, the object tilts by %.0f degrees: if it was not held so, the z axis "
            "of the world does not point up (in a camera's frame it never does)",
            where,
            np.median(tilt),
        )


def completed(arrays: Mapping[str, np.ndarray], objects: Mapping[str, ObjectModel]) -> dict[str, np.ndarray]:
    """Return the fields with missing contacts and rest poses, computed if the objects are known. Missing
    contacts with unknown objects are false."""
    result = dict(arrays)
    if not scene_is_sound(arrays):
        return result
    names, poses = arrays["object_name"].astype(str), arrays["object_pose"].astype(float)
    given = arrays.get("link_contacts", np.zeros((len(names), len(HUMAN_LINKS)), dtype=bool))
    if given.dtype == bool and given.shape == (len(names), len(HUMAN_LINKS)):
        contacts = given.copy()
        for name in set(names[~given.any(axis=1)].tolist()) & set(objects):
            rows = np.flatnonzero((names == name) & ~given.any(axis=1))
            mesh = objects[name]
            joints = arrays["hand_joints"][rows].astype(float)
            contacts[rows] = link_contacts(joints, poses[rows], mesh.vertices, mesh.faces)
        result["link_contacts"] = contacts
    if "object_rest_pose" not in arrays and set(names.tolist()) <= set(objects):
        settled = [settled_pose(p, objects[n]) for n, p in zip(names.tolist(), poses, strict=True)]
        result["object_rest_pose"] = np.array(settled)
    return result


def diagnosis(
    arrays: Mapping[str, np.ndarray], objects: Mapping[str, ObjectModel], sides: bool = True
) -> GraspDiagnosis:
    """Find the convention and faults of grasps.

    Args:
        arrays: fields of ``HumanGraspSet`` by name. Invalid arrays are ignored: the set itself checks them.
        objects: known objects by name.
        sides: whether left hands are errors if their objects are not mirrored.
    """
    joints = arrays.get("hand_joints", np.zeros(0))
    if not (joints.ndim == 3 and joints.shape[1:] == (21, 3) and joints.dtype.kind in "fiu" and len(joints)):
        return GraspDiagnosis(0, (), Convention())
    if not np.isfinite(joints).all():
        return GraspDiagnosis(len(joints), (), Convention())
    joints = joints.astype(float)
    remarks, convention = _hand_remarks(joints, len(joints) > 1)
    if any(r.fatal and 2 * len(r.rows) > len(joints) for r in remarks) and not convention.changes:
        return GraspDiagnosis(len(joints), tuple(remarks), convention)
    untested: list[str] = []
    if scene_is_sound(arrays):
        scene = GraspScene.of(arrays, objects)
        untested += scene.untested()
        if len(scene.rows):
            convention, found = scene.convention(convention)
            remarks += [*found, *scene.contact_remarks(convention, arrays.get("link_contacts"))]
    if sides:
        remarks += _side_remarks(joints[:, ORDERS[convention.joint_order]], arrays.get("object_name"))
        if remarks and remarks[-1].words is LEFT and 2 * len(remarks[-1].rows) > len(joints):
            convention = replace(convention, side="left")
    if set(convention.changes) <= {"side"}:
        remarks += table_remarks(joints)
        if remarks and remarks[-1].words is UNDER and 2 * len(remarks[-1].rows) > len(joints):
            convention = replace(convention, up="-z")
    return GraspDiagnosis(len(joints), tuple(remarks), convention, tuple(untested))


LEFT = "the fingers bend backwards: a left hand, or a mirrored frame"


def _hand_remarks(joints: np.ndarray, several: bool) -> tuple[list[Remark], Convention]:
    """Return remarks on joint order, unit and hand size, and the convention of most hands.

    Args:
        joints: joints in any order and unit, shape [N, 21, 3].
        several: whether there is more than one grasp.
    """
    remarks = []
    misfit = np.stack([order_misfit(joints[:, order]) for order in ORDERS.values()])
    names = list(ORDERS)
    ours, least = misfit[names.index("fungrasp")], misfit.min(axis=0)
    best = np.where(least < CLEARLY * ours, misfit.argmin(axis=0), names.index("fungrasp"))
    unknown = np.flatnonzero(least >= ORDER_MISFIT)
    best[unknown] = names.index("fungrasp")
    if len(unknown):
        words = (
            "the joints are in no known order, or no hand: whatever the order, bones and knuckles differ by "
            f"{100 * np.median(least[unknown]):.0f} % from an adult's; known orders: {', '.join(names)}"
        )
        remarks.append(Remark(words, unknown, True))
    order = names[np.bincount(best).argmax()]
    for index in set(best.tolist()) - {names.index("fungrasp")}:
        words = f"the joints are in the order of {names[index]} (by the lengths of bones)"
        remarks.append(Remark(words, np.flatnonzero(best == index), True))
    if 2 * len(unknown) > len(joints):
        return remarks, Convention()
    at_zero = np.flatnonzero(np.abs(joints[:, ORDERS[order][0]]).max(axis=1) < 1e-9)
    size = np.median(bone_ratios(joints[:, ORDERS[order]]), axis=1)
    unit = _unit(float(np.median(size)))
    if several and len(at_zero) == len(joints):
        scaled = "" if unit == "m" else ", and in no unit of length"
        words = f"the joints are relative to the wrist{scaled}: the wrist position in the world is missing"
        return [*remarks, Remark(words, at_zero, True)], Convention()
    if unit is None:
        words = f"the hands are {np.median(size):.3g} times as large as an adult's, in no known unit"
        return [*remarks, Remark(words, np.arange(len(joints)), True)], Convention()
    if unit != "m":
        remarks.append(Remark(f"the joints are in {unit}, not m", np.arange(len(joints)), True))
    odd = np.flatnonzero([_unit(float(s)) != unit for s in size])
    if len(odd):
        words = f"the hand is {np.median(size[odd]) * UNITS[unit]:.2g} times as large as an adult's"
        remarks.append(Remark(words, odd, True))
    return remarks, Convention(joint_order=order, unit=unit)


def _unit(size: float) -> Unit | None:
    """Return the unit in which the size of a hand is plausible, or None.

    size: size relative to an adult's hand if the joints were in meters.
    """
    if HAND_SIZES[0] <= size <= HAND_SIZES[1]:
        return "m"
    unit = min(UNITS, key=lambda name: abs(np.log(max(size, 1e-9) * UNITS[name])))
    return unit if HAND_SIZES[0] <= size * UNITS[unit] <= HAND_SIZES[1] else None


def _side_remarks(joints: np.ndarray, object_name: np.ndarray | None) -> list[Remark]:
    """Report left hands whose objects are not mirrored. joints: in the order of ``HUMAN_JOINTS``."""
    left = joint_bends(joints)[0][:, :4].sum(axis=(1, 2)) < -BENT
    left &= order_misfit(joints) < ORDER_MISFIT
    if object_name is not None and object_name.shape == (len(joints),) and object_name.dtype.kind == "U":
        left &= ~np.char.endswith(object_name, MIRRORED)
    rows = np.flatnonzero(left)
    return [Remark(LEFT, rows, True)] if len(rows) else []


UNDER = "the whole hand is below the table: z points down, or the table top is not at z = 0 (table height)"
"""Remark on hands below the table top; of most grasps it asks for another upward axis."""


def table_remarks(hand_joints: np.ndarray) -> list[Remark]:
    """Report hands partly and wholly below the table top. hand_joints: [m], world frame, shape [N, 21, 3]."""
    lowest, highest = hand_joints[..., 2].min(axis=1), hand_joints[..., 2].max(axis=1)
    under = highest < 0
    rows, whole = np.flatnonzero((lowest < BELOW_TABLE) & ~under), np.flatnonzero(under)
    words = (
        f"the hand reaches {-1000 * lowest[rows].min(initial=0):.0f} mm below the table; 'fungrasp grasps "
        "convert --below-table lift' or 'drop' fixes it, in Python grasps.conversion.mend_below_table"
    )
    partly = [Remark(words, rows)] if len(rows) else []
    return partly + ([Remark(UNDER, whole, True)] if len(whole) else [])
