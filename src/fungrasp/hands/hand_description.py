"""A hand in plain words and numbers: what ``fungrasp hands show`` prints."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.hands.hand import Finger, Hand
from fungrasp.hands.kinematic_tree import drives


def contact_points(finger: Finger) -> tuple[str, ...]:
    """The key point that carries each link's contact flag: the one at the link's far end.

    Returns:
        A name per link of ``finger``: the next link's joint (its body, or a site where the TOML gives one),
        for the last link the tip site.
    """
    return (*finger.joints[1:], finger.tip)


def hand_mass(hand: Hand) -> float:
    """Mass of the palm and all that hangs on it [kg]."""
    return float(hand.model.body(hand.palm).subtreemass[0])


def describe_hand(hand: Hand) -> dict[str, Any]:
    """A hand as a JSON-able dictionary.

    Lengths in meters, angles in radians, masses in kilograms. A finger's ``joints`` are the points at the
    near ends of its links, its ``contact_points`` those at the far ends: each the name of a body, or of a
    site where the model has a site of that name. A coupled joint is ``constant + slope * driver``. ``limits``
    is null for an unlimited joint.
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
