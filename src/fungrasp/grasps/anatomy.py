"""Anatomical checks of human grasps, from the 21 joints alone: bone lengths and joint angles."""

from __future__ import annotations

import re

import numpy as np

from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import (
    BONES,
    HUMAN_JOINTS,
    bone_lengths,
    finger_link_directions,
    hand_sides,
    mirror_points,
)

ADULT_BONES = np.array(
    [
        [(68.1, 90.6), (33.0, 39.8), (22.2, 22.4), (15.8, 23.6)],
        [(64.6, 94.7), (31.7, 44.6), (23.3, 26.3), (17.4, 31.7)],
        [(58.0, 86.1), (28.8, 41.4), (24.8, 25.7), (17.3, 30.5)],
        [(53.7, 81.8), (21.1, 32.7), (18.1, 18.9), (16.0, 22.8)],
        [(38.6, 38.6), (30.8, 46.2), (27.1, 31.6), (21.7, 38.2)],
    ]
)
"""Mean lengths of adults' bones [mm], shape [5, 4, 2]: finger, bone from the wrist out, lower and upper of
two sources: radiographs (Buryanov and Kotiuk, "Proportions of hand segments", 2010) and the hand of the
tracked grasps in D-Grasp's labels. They differ as the second counts the first bone from the wrist and the
last to the skin."""

BONE_VARIATION = 0.3
"""Fraction by which a bone may be shorter or longer than the means: three standard deviations of the
radiographs."""

HAND_SIZE_SPREAD = 0.11
"""Standard deviation of the logarithm of adults' hand sizes, errors of an estimated shape included."""

FLEXION_RANGE = np.radians([[(-45, 90), (0, 100), (0, 80)]] * 4 + [[(-180, 180), (-10, 55), (-15, 80)]])
"""Normal range of active motion [rad], shape [5, 3, 2] (Electronic Textbook of Hand Surgery, eatonhand.com):
MCP, PIP, DIP; the thumb's CMC (no limit), MCP, IP."""

DEVIATION_LIMIT = np.radians([20.0, 0.0, 0.0])
"""Motion to either side of a finger's MCP, PIP, DIP [rad]."""

JOINT_RANGE_SLACK = np.radians(25.0)
"""Allowed beyond the ranges [rad]: joint centers lie off the bones' lines, and objects bend fingers further
than the hand alone does."""


def bone_ratios(hand_joints: np.ndarray) -> np.ndarray:
    """Length of each of ``BONES`` over an adult's, shape [..., 20]. hand_joints: [m], shape [..., 21, 3]."""
    return bone_lengths(hand_joints) / (ADULT_BONES.mean(axis=-1).ravel() * 1e-3)


def hand_size(joints: np.ndarray) -> float:
    """Size as a part of an adult's hand: median over the bones. joints: [m], shape [21, 3]."""
    return float(np.median(bone_ratios(joints)))


def joint_bends(hand_joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each finger joint is bent.

    A finger bends about the line from the little finger's base to the index finger's, made perpendicular to
    the bone before the joint; flexion is positive. The thumb's axes can't be told from the joints: its bends
    are the unsigned angles between bones.

    Args:
        hand_joints: of right hands [m], shape [..., 21, 3], any frame.

    Returns:
        flexion: [rad], shape [..., 5, 3]: finger, joint (MCP, PIP, DIP; thumb CMC, MCP, IP).
        deviation: to the side of the index finger [rad], same shape; zero for the thumb.
    """
    base = hand_joints[..., 1::4, :] - hand_joints[..., :1, :]
    base = base / np.linalg.norm(base, axis=-1, keepdims=True)
    links = finger_link_directions(hand_joints)
    before = np.concatenate([base[..., None, :], links[..., :-1, :]], axis=-2)
    across = (hand_joints[..., 1, :] - hand_joints[..., 13, :])[..., None, None, :]
    axis = across - np.sum(across * before, axis=-1, keepdims=True) * before
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    turn, straight = np.cross(before, links), np.sum(before * links, axis=-1)
    flexion = np.arctan2(np.sum(turn * axis, axis=-1), straight)
    deviation = np.arcsin(np.clip(np.sum(links * axis, axis=-1), -1.0, 1.0))
    flexion[..., 4, :] = np.arctan2(np.linalg.norm(turn[..., 4, :, :], axis=-1), straight[..., 4, :])
    deviation[..., 4, :] = 0.0
    return flexion, deviation


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
