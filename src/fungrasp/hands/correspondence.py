"""Correspondence of robot links and key points to human ones, by finger name and from the base outwards.

Human fingers that the robot lacks are ignored. If a robot finger has fewer links, its last link corresponds
to the rest of the human finger (section IV.A of the paper).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.hands import FINGERS, Hand

HUMAN_FINGER_JOINTS = {name: tuple(range(1 + 4 * i, 5 + 4 * i)) for i, name in enumerate(FINGERS)}
"""Indices of MCP, PIP, DIP and tip (thumb: CMC, MCP, IP, tip) among the 21 human joints."""
HUMAN_FINGER_LINKS = {name: tuple(range(1 + 3 * i, 4 + 3 * i)) for i, name in enumerate(FINGERS)}
"""Indices of the proximal, middle and distal link among the 16 human links; link 0 is the palm."""


@dataclass(frozen=True)
class Correspondence:
    """Indices of corresponding key points, joints and links; S is the number of the robot's finger links."""

    near: np.ndarray
    """Robot key point at the near end of each finger link (index into ``Hand.keypoint_names``), shape [S]."""
    far: np.ndarray
    """Robot key point at the far end of each finger link, shape [S]."""
    human_near: np.ndarray
    """Human joint that corresponds to ``near``, shape [S]."""
    human_far: np.ndarray
    """Human joint that corresponds to ``far``, shape [S]."""
    is_last: np.ndarray
    """Whether the link ends in the fingertip, shape [S] bool."""
    is_thumb: np.ndarray
    """Whether the link belongs to the thumb, shape [S] bool."""
    human_links: tuple[tuple[int, ...], ...]
    """Human links that correspond to each finger link, length S."""

    def link_contacts(self, human_contacts: np.ndarray) -> np.ndarray:
        """Map ``human_contacts``, shape [N, 16] bool, to the robot's links, palm first, shape [N, 1 + S]."""
        columns = [
            human_contacts[:, 0],
            *(human_contacts[:, list(links)].any(axis=1) for links in self.human_links),
        ]
        return np.stack(columns, axis=1)


def correspond(hand: Hand) -> Correspondence:
    """Return the correspondence of a robot hand's links and key points to human ones."""
    near, far, human_near, human_far, is_last, is_thumb, human_links = [], [], [], [], [], [], []
    keypoint = 1
    for finger in hand.fingers.values():
        count = len(finger.links)
        joints, links = HUMAN_FINGER_JOINTS[finger.name], HUMAN_FINGER_LINKS[finger.name]
        for i in range(count):
            last = i == count - 1
            near.append(keypoint + i)
            far.append(keypoint + i + 1)
            human_near.append(joints[i])
            human_far.append(joints[3] if last else joints[i + 1])
            is_last.append(last)
            is_thumb.append(finger.name == "thumb")
            human_links.append(links[i:] if last else links[i : i + 1])
        keypoint += count + 1
    return Correspondence(
        *(np.array(x) for x in (near, far, human_near, human_far, is_last, is_thumb)),
        human_links=tuple(human_links),
    )
