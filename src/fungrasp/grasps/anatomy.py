"""Check bones and joints of human grasps against adults' ranges."""

from __future__ import annotations

import re

import numpy as np

from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import (
    ADULT_BONES,
    BONE_VARIATION,
    BONES,
    DEVIATION_LIMIT,
    FLEXION_RANGE,
    HUMAN_JOINTS,
    JOINT_RANGE_SLACK,
    bone_lengths,
    hand_sides,
    joint_bends,
    mirror_points,
)


def check_anatomy(grasps: HumanGraspSet) -> list[str]:
    """Return a message for each bone length and joint angle outside adults' ranges."""
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
    """Join messages of ``check_anatomy`` that differ only in grasp and numbers."""
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
