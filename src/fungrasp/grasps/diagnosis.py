"""What is probably wrong with the numbers of human grasps: units, joint order, side, quaternions, table.

The joints of a hand tell most of it, as bones have known lengths and fingers bend one way; that an object at
rest stands on the table tells the rest.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import (
    ADULT_BONES,
    BONE_VARIATION,
    BONES,
    DEVIATION_LIMIT,
    FLEXION_RANGE,
    HUMAN_JOINTS,
    JOINT_RANGE_SLACK,
    ORDERS,
    bone_lengths,
    hand_sides,
    joint_bends,
    mirror_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_variants import MIRRORED

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres per unit."""

SPAN = (0.08, 0.28)
"""Distance between the two joints of a hand that are furthest apart [m]."""

BONE_MISFIT = 0.3
"""A hand's bones differ from an adult's by no more than this share of their length, root mean square."""

CLEARLY = 0.6
"""Another order of joints is recognised if the misfit is less than this share of that in ours."""

BENT = 0.6
"""Sum of the bends of a hand's four fingers that tells its side [rad]."""

BELOW_TABLE = -0.01
"""A joint further below the table top is an error of measurement [m]."""

REST_ERROR = 0.02
"""An object at rest is no further above or below the table [m]."""

TIPS = [4, 8, 20]
"""Tips of index, middle finger and thumb in ``HUMAN_JOINTS``."""

HELD, GAP_ERROR = 0.05, 0.015
"""Fingertips are on average no further from what they hold, and a wrong pose moves them by more [m]."""

XYZW = [0, 1, 2, 6, 3, 4, 5]
"""A pose read as if its quaternion were written xyzw."""

SURFACE_SAMPLES = 3000


@dataclass(frozen=True)
class Remark:
    """Something wrong with some of the grasps."""

    words: str
    """What is wrong."""
    rows: np.ndarray
    """Grasps that it is said of, shape [R]."""
    fatal: bool
    """Whether results would mean nothing."""
    remedy: str = ""
    """Options of ``fungrasp grasps convert`` that mend it."""

    def __str__(self) -> str:
        return f"{rows_in_words(self.rows)}: {self.words}"


def rows_in_words(rows: np.ndarray, most: int = 6) -> str:
    """ "grasp 3" or "grasps 1, 4, 5 and 20 more"."""
    if len(rows) == 1:
        return f"grasp {rows[0]}"
    shown = ", ".join(str(row) for row in rows[:most])
    return f"grasps {shown}" + (f" and {len(rows) - most} more" if len(rows) > most else "")


def hand_remarks(hand_joints: np.ndarray, object_name: np.ndarray | None = None) -> list[Remark]:
    """Wrong units, another order of joints, left hands.

    Args:
        hand_joints: as a file has them, finite, shape [N, 21, 3].
        object_name: shape [N]; left hands on objects that are mirror images are meant to be. None: no object
            is one.
    """
    if not len(hand_joints):
        return []
    remarks = []
    unit = likely_unit(hand_joints)
    joints = hand_joints * UNITS[unit]
    if unit != "m":
        remarks.append(
            Remark(f"the joints are in {unit}, not m", np.arange(len(joints)), True, f"--unit {unit}")
        )
    misfit = np.stack([_bone_misfit(joints[:, order]) for order in ORDERS.values()])
    ours = misfit[list(ORDERS).index("fungrasp")]
    clear = (misfit.min(axis=0) < BONE_MISFIT) & (misfit.min(axis=0) < CLEARLY * ours)
    best = np.where(clear, misfit.argmin(axis=0), -1)
    for index, (name, order) in enumerate(ORDERS.items()):
        rows = np.flatnonzero(best == index)
        if len(rows):
            joints[rows] = joints[rows][:, order]
            words = f"the joints are in the order of {name} (by the lengths of the bones)"
            remarks.append(Remark(words, rows, True, f"--joint-order {name}"))
    known = np.flatnonzero(misfit.min(axis=0) < BONE_MISFIT)
    bends = joint_bends(joints[known])[0][:, :4].sum(axis=(1, 2))
    left = known[bends < -BENT]
    if object_name is not None and object_name.shape == (len(joints),) and object_name.dtype.kind == "U":
        left = left[~np.char.endswith(object_name[left], MIRRORED)]
    if len(left):
        words = "the fingers bend backwards: a left hand, or a mirrored frame"
        remarks.append(Remark(words, left, True, "--side left"))
    return remarks


def likely_unit(hand_joints: np.ndarray) -> str:
    """The unit in which hands have a hand's size, "m" if none; hand_joints: shape [N, 21, 3]."""
    apart = np.linalg.norm(hand_joints[:, :, None] - hand_joints[:, None], axis=-1).max(axis=(1, 2))
    span = float(np.median(apart))
    return next((unit for unit, size in UNITS.items() if SPAN[0] <= span * size <= SPAN[1]), "m")


def table_remarks(hand_joints: np.ndarray) -> list[Remark]:
    """Hands that reach below the table top. hand_joints: [m], shape [N, 21, 3], world frame."""
    depth = hand_joints[..., 2].min(axis=1, initial=np.inf)
    rows = np.flatnonzero(depth < BELOW_TABLE)
    if not len(rows):
        return []
    return [Remark(f"the hand reaches {-1000 * depth[rows].min():.0f} mm below the table", rows, False)]


def pose_remarks(fields: Mapping[str, np.ndarray], objects: Mapping[str, ObjectModel]) -> list[Remark]:
    """Objects that are not where the fingers are, or don't stand on the table at rest, and whether another
    order of quaternions explains it.

    Args:
        fields: "object_name", "object_pose", "object_rest_pose" and "hand_joints" of N grasps.
        objects: those that are known, by name.
    """
    rows = np.flatnonzero(np.isin(fields["object_name"], list(objects)))
    name, joints = fields["object_name"][rows], fields["hand_joints"][rows]
    pose, rest = fields["object_pose"][rows], fields["object_rest_pose"][rows]
    gap, swapped_gap = (tip_gaps(name, joints, p, objects) for p in (pose, pose[:, XYZW]))
    height, swapped_height = (np.abs(rest_heights(name, p, objects)) for p in (rest, rest[:, XYZW]))
    swapped = (gap > swapped_gap + GAP_ERROR) | (height > swapped_height + REST_ERROR)
    apart = ~swapped & (gap > HELD)
    standing = swapped | (height <= REST_ERROR)
    remarks = []
    if swapped.any():
        words = "fingers and table meet the object only if quaternions are xyzw, not wxyz"
        remarks.append(Remark(words, rows[swapped], True, "--quaternion xyzw"))
    if apart.any():
        words = (
            f"the fingertips are on average {1000 * gap[apart].max():.0f} mm from the object that they hold"
        )
        remarks.append(Remark(words, rows[apart], False))
    if not standing.all():
        words = (
            f"at rest the object is up to {1000 * height[~standing].max():.0f} mm off the table: is z up, "
            "the table top z = 0, and the mesh the one that was held?"
        )
        remarks.append(Remark(words, rows[~standing], False))
    return remarks


def tip_gaps(
    object_name: np.ndarray,
    hand_joints: np.ndarray,
    object_pose: np.ndarray,
    objects: Mapping[str, ObjectModel],
) -> np.ndarray:
    """Mean distance of thumb, index and middle finger's tips from the object's surface [m], shape [N]."""
    import trimesh

    gaps = np.zeros(len(object_name))
    for name in np.unique(object_name):
        rows = np.flatnonzero(object_name == name)
        mesh = objects[str(name)].mesh
        tree = KDTree(trimesh.sample.sample_surface(mesh, SURFACE_SAMPLES, seed=0)[0])
        local = inverse_transform_points(
            _with_unit_quaternions(object_pose[rows]), hand_joints[rows][:, TIPS]
        )
        gaps[rows] = tree.query(local)[0].mean(axis=1)
    return gaps


def rest_heights(
    object_name: np.ndarray, object_rest_pose: np.ndarray, objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """Height of each object's lowest point above the table [m], shape [N]."""
    heights = np.zeros(len(object_name))
    for row, (name, pose) in enumerate(zip(object_name, object_rest_pose, strict=True)):
        corners = objects[str(name)].mesh.convex_hull.vertices
        heights[row] = transform_points(_with_unit_quaternions(pose), corners)[:, 2].min()
    return heights


def _with_unit_quaternions(pose: np.ndarray) -> np.ndarray:
    norm = np.maximum(np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True), 1e-9)
    return np.concatenate([pose[..., :3], pose[..., 3:] / norm], axis=-1)


def refuse_or_list(remarks: list[Remark], count: int, where: str) -> list[Remark]:
    """The remarks, if no fatal one is made of more than half of ``count`` grasps.

    Raises:
        FungraspError: one is; it names the remedy.
    """
    for remark in remarks:
        if remark.fatal and 2 * len(remark.rows) > count:
            raise FungraspError(
                f"{where}: {remark}; 'fungrasp grasps convert {where} {remark.remedy} --out NEW.npz' mends it"
            )
    return remarks


def _bone_misfit(hand_joints: np.ndarray) -> np.ndarray:
    """Root mean square deviation of the bones' lengths from an adult's hand of the same size, as a share of
    them, shape [N]."""
    ratio = np.log(np.maximum(bone_lengths(hand_joints), 1e-6) * 1000 / ADULT_BONES.mean(axis=-1).ravel())
    return np.sqrt(np.mean((ratio - ratio.mean(axis=1, keepdims=True)) ** 2, axis=1))


def check_anatomy(grasps: HumanGraspSet) -> list[str]:
    """Bones and joints of a grasp set outside adults' ranges, one sentence each; empty if there are none."""
    lengths = bone_lengths(grasps.hand_joints) * 1000
    shortest = ADULT_BONES[..., 0].ravel() * (1 - BONE_VARIATION)
    longest = ADULT_BONES[..., 1].ravel() * (1 + BONE_VARIATION)
    left = (hand_sides(grasps.hand_joints) == "left")[:, None, None]
    flexion, deviation = joint_bends(np.where(left, mirror_points(grasps.hand_joints), grasps.hand_joints))
    low, high = FLEXION_RANGE[..., 0] - JOINT_RANGE_SLACK, FLEXION_RANGE[..., 1] + JOINT_RANGE_SLACK
    findings = []
    for row, name in enumerate(grasps.object_name):
        grasp = f"grasp {row} ({name})"
        for bone in np.flatnonzero((lengths[row] < shortest) | (lengths[row] > longest)):
            near, far = (HUMAN_JOINTS[joint] for joint in BONES[bone])
            allowed = f"{shortest[bone]:.0f} to {longest[bone]:.0f} mm"
            findings.append(
                f"{grasp}: the bone from {near} to {far} is {lengths[row, bone]:.0f} mm long, not {allowed}"
            )
        for finger, joint in np.argwhere((flexion[row] < low) | (flexion[row] > high)):
            angle, least, most = np.degrees(
                [flexion[row, finger, joint], low[finger, joint], high[finger, joint]]
            )
            allowed = f"{least:.0f} to {most:.0f} degrees"
            findings.append(f"{grasp}: {_joint(finger, joint)} is bent {angle:.0f} degrees, not {allowed}")
        for finger, joint in np.argwhere(np.abs(deviation[row]) > DEVIATION_LIMIT + JOINT_RANGE_SLACK):
            angle, most = np.degrees(
                [deviation[row, finger, joint], DEVIATION_LIMIT[joint] + JOINT_RANGE_SLACK]
            )
            findings.append(
                f"{grasp}: {_joint(finger, joint)} is bent {angle:.0f} degrees sideways, not {most:.0f}"
            )
    return findings


def grouped(findings: list[str]) -> list[str]:
    """Findings of ``check_anatomy`` that differ in grasp and number only, in one sentence each."""
    groups: dict[str, list[str]] = {}
    for finding in findings:
        words = finding.partition(": ")[2]
        groups.setdefault(re.sub(r"-?\d+", "#", words.partition(", not ")[0]), []).append(finding)
    lines = []
    for first, *others in groups.values():
        also = ", ".join(finding.split()[1] for finding in others[:6])
        more = f" and {len(others) - 6} more" if len(others) > 6 else ""
        lines.append(f"{first}; likewise in grasps {also}{more}" if others else first)
    return lines


def _joint(finger: int, joint: int) -> str:
    return HUMAN_JOINTS[1 + 4 * finger + joint]
