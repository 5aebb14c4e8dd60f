"""Description of a hand, as printed by ``fungrasp hands show``."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.hands.hand import Finger, Hand
from fungrasp.hands.kinematic_tree import drives


def contact_points(finger: Finger) -> tuple[str, ...]:
    """Return the key point at the far end of each link, which carries its contact flag.

    Returns:
        Site or body by link: the joint of the next link, or the tip for the last link.
    """
    return (*finger.joints[1:], finger.tip)


def hand_mass(hand: Hand) -> float:
    """Return the mass of the palm and all bodies below it [kg]."""
    return float(hand.model.body(hand.palm).subtreemass[0])


def describe_hand(hand: Hand) -> dict[str, Any]:
    """Return a description of a hand for JSON.

    Lengths are in meters, angles in radians, masses in kilograms. A finger's ``joints`` are the points at the
    near ends of its links and its ``contact_points`` those at the far ends, each by the name of a site or, if
    there is none, of a body. A coupled joint is ``constant + slope * driver``. ``limits`` is null for an
    unlimited joint.
    """
    model = hand.model
    joints = hand.joint_names
    return {
        "name": hand.name,
        "title": hand.title,
        "model": str(hand.model_path),
        "source": hand.source,
        "mass": hand_mass(hand),
        "palm": hand.palm,
        "palm_frame": {"fingers": hand.palm_fingers.tolist(), "normal": hand.palm_normal.tolist()},
        "fingers": {
            finger.name: {
                "links": list(finger.links),
                "joints": list(finger.joints),
                "tip": finger.tip,
                "contact_points": list(contact_points(finger)),
            }
            for finger in hand.fingers.values()
        },
        "links": {name: list(bodies) for name, bodies in zip(hand.link_names, hand.links, strict=True)},
        "keypoints": list(hand.keypoint_names),
        "joints": [
            {
                "name": name,
                "body": model.body(int(model.jnt_bodyid[i])).name,
                "limits": limits.tolist() if np.isfinite(limits).all() else None,
                "independent": name in hand.actuators,
            }
            for i, (name, limits) in enumerate(zip(joints, hand.joint_limits, strict=True))
        ],
        "couplings": [
            {
                "joint": joints[joint],
                "driver": joints[drive.driver],
                "constant": drive.constant,
                "slope": drive.slope,
            }
            for joint, drive in drives(model).items()
        ],
        "actuators": [
            {"joint": a.joint, "kp": a.kp, "kd": a.kd, "force_limit": a.force_limit}
            for a in hand.actuators.values()
        ],
    }
