"""Specifications of the built-in grasps: how people hold the built-in objects.

Directions are in the objects' frames, with z up as they stand on the table. In overhand grasps (palm down),
the thumb is on the +x side if the fingers point to -y. Upright objects are held from the side, thumb up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fungrasp.synthesis.grasp_specification import GraspSpecification as Spec
from fungrasp.synthesis.grasp_specification import Vector3

DOWN: Vector3 = (0, 0, -1)
LEFT: Vector3 = (0, 1, 0)
RIGHT: Vector3 = (0, -1, 0)
AHEAD: Vector3 = (1, 0, 0)
BACK: Vector3 = (-1, 0, 0)


def _around(spec: Spec, *degrees: float, about: tuple[float, float] = (0, 0)) -> list[Spec]:
    return [spec.turned(np.deg2rad(angle), about) for angle in degrees]


def _along(spec: Spec, *places: float, axis: int = 0) -> list[Spec]:
    """Repeat a specification with other coordinates of ``at`` along an axis."""
    result = []
    for place in places:
        at = list(spec.at)
        at[axis] = place
        result.append(replace(spec, at=(at[0], at[1], at[2])))
    return result


def _drinking() -> list[Spec]:
    mug = Spec("mug", "drink", "handle", "handle", at=(0.053, 0, 0.0), palm=BACK, fingers=LEFT)
    mug_body = Spec("mug", "hand over", "body", "wrap", at=(-0.016, 0, 0.008), palm=AHEAD, fingers=RIGHT)
    mug_rim = Spec("mug", "place", "rim", "disk", at=(-0.016, 0, 0.04), palm=DOWN, fingers=AHEAD)
    stem = Spec("wine_glass", "drink", "stem", "pinch", at=(0, 0, -0.045), palm=LEFT, fingers=AHEAD)
    bowl = Spec("wine_glass", "toast", "bowl", "wrap", at=(0, 0, 0.035), palm=LEFT, fingers=AHEAD)
    top = Spec("wine_glass", "place", "bowl", "disk", at=(0, 0, 0.08), palm=DOWN, fingers=AHEAD)
    pour = Spec("pitcher", "pour", "handle", "fist", at=(0.094, 0, 0.0), palm=BACK, fingers=LEFT)
    wall = Spec("pitcher", "hand over", "body", "pinch", at=(0, 0.064, 0.1), palm=DOWN, fingers=LEFT)
    tea = Spec("teapot", "pour", "handle", "fist", at=(0.109, 0, -0.005), palm=BACK, fingers=LEFT)
    lid = Spec("teapot", "open", "lid", "pinch", at=(0.009, 0, 0.049), palm=DOWN, fingers=BACK)
    return [
        replace(mug, palm=(-1, 0, -0.3)),
        replace(mug, palm=(-1, -0.2, -0.3)),
        replace(mug, palm=(-1, 0.2, -0.3)),
        replace(mug, palm=(-1, 0, -0.5), at=(0.053, 0, 0.004)),
        *_around(mug_body, 0, 30, -20, about=(-0.016, 0)),
        *_around(mug_rim, 0, 90, about=(-0.016, 0)),
        *_around(stem, 0, 60, 120),
        *_around(bowl, 0, 50),
        *_around(top, 0),
        *_along(pour, 0.0, 0.02, axis=2),
        replace(pour, palm=(-1, 0, -0.3), at=(0.094, 0, 0.015)),
        *_around(wall, 0, 180),
        *_along(tea, -0.005, 0.0, axis=2),
        replace(tea, palm=(-1, 0, -0.4)),
        *_around(lid, 0, 120, about=(0.009, 0)),
    ]


def _kitchen() -> list[Spec]:
    cook = Spec("pan", "cook", "handle", "wrap", at=(0.07, 0, 0.012), palm=DOWN, fingers=LEFT)
    pan_rim = Spec("pan", "wash", "body", "pinch", at=(-0.09, 0.117, 0.008), palm=DOWN, fingers=LEFT)
    cut = Spec("knife", "cut", "handle", "cover", at=(-0.08, 0.008, 0), palm=DOWN, fingers=RIGHT)
    chop = Spec("knife", "chop", "handle", "pinch", at=(-0.045, 0.008, 0), palm=DOWN, fingers=RIGHT)
    eat = Spec(
        "bowl",
        "eat",
        "rim",
        "prism",
        at=(0.071, 0, 0.012),
        palm=(-1, 0, -1),
        fingers=(1, 0, -1),
        parts=dict.fromkeys(("index", "middle", "ring"), "body"),
    )
    flip = Spec("spatula", "flip", "handle", "cover", at=(-0.08, 0, 0.002), palm=DOWN, fingers=RIGHT)
    shaft = Spec("spatula", "hand over", "shaft", "pinch", at=(-0.01, 0, 0.004), palm=DOWN, fingers=RIGHT)
    scrub = Spec("brush", "scrub", "handle", "cover", at=(-0.03, 0, 0.008), palm=DOWN, fingers=RIGHT)
    head = Spec("brush", "hand over", "head", "prism", at=(0.085, 0, 0.015), palm=DOWN, fingers=LEFT)
    return [
        *_along(cook, 0.06, 0.075, 0.09),
        pan_rim,
        replace(pan_rim, at=(-0.09, -0.117, 0.008), fingers=RIGHT),
        *_along(cut, -0.09, -0.07),
        *_along(replace(cut, kind="prism"), -0.075, -0.06),
        chop,
        *_around(eat, 0, 90, 200),
        *_around(replace(eat, task="hand over", palm=(-0.6, 0, -1), fingers=(1, 0, -0.6)), 140, 270),
        *_along(flip, -0.09, -0.07),
        *_along(replace(flip, kind="prism"), -0.06),
        *_along(shaft, -0.01, 0.02),
        *_along(scrub, -0.05, -0.02),
        *_along(replace(scrub, kind="prism"), 0.01, 0.03),
        *_around(head, 0, 180, about=(0.085, 0)),
    ]


def _containers() -> list[Spec]:
    can = Spec("can", "drink", "body", "wrap", at=(0, 0, 0), palm=LEFT, fingers=AHEAD)
    can_top = Spec("can", "place", "body", "disk", at=(0, 0, 0.04), palm=DOWN, fingers=AHEAD)
    box = Spec("box", "hand over", "body", "prism", at=(0, -0.015, 0), palm=LEFT, fingers=AHEAD)
    box_top = Spec("box", "place", "body", "prism", at=(0, 0, 0.065), palm=DOWN, fingers=AHEAD)
    bottle = Spec("bottle", "drink", "body", "wrap", at=(0, 0, -0.01), palm=LEFT, fingers=AHEAD)
    cap = Spec("bottle", "open", "cap", "pinch", at=(0, 0, 0.095), palm=DOWN, fingers=AHEAD)
    neck = Spec("bottle", "hand over", "body", "disk", at=(0, 0, 0.055), palm=DOWN, fingers=AHEAD)
    spray = Spec(
        "spray_bottle",
        "spray",
        "neck",
        "pistol",
        at=(-0.008, 0, 0.065),
        palm=(0.5, 1, 0),
        fingers=(1, -0.5, 0),
        parts={"index": "trigger"},
        contacts=("index_distal", "middle_middle", "middle_distal", "thumb_distal"),
    )
    body = Spec("spray_bottle", "hand over", "body", "wrap", at=(-0.008, 0, -0.04), palm=AHEAD, fingers=RIGHT)
    return [
        *_around(can, 0, 90, 180, 270),
        *_around(can_top, 0, 120),
        *_around(replace(can, task="pour", at=(0, 0, 0.02)), 45),
        *_around(box, 0, 180),
        *_around(replace(box, task="pour", at=(0, -0.015, 0.03)), 0, 180),
        *_around(box_top, 0, 180),
        *_around(bottle, 0, 90, 180),
        *_around(replace(bottle, task="pour", at=(0, 0, 0.02)), 45, 225),
        *_around(cap, 0),
        *_around(neck, 0, 120),
        spray,
        replace(spray, palm=(0.3, 1, 0), fingers=(1, -0.3, 0)),
        replace(spray, palm=(0.8, 1, 0), fingers=(1, -0.8, 0)),
        *_around(body, 0, 180, about=(-0.008, 0)),
    ]


def _tools() -> list[Spec]:
    hammer = Spec("hammer", "hammer", "grip", "cover", at=(-0.05, -0.006, 0), palm=DOWN, fingers=RIGHT)
    shaft = Spec("hammer", "hand over", "shaft", "prism", at=(0.03, -0.006, 0), palm=DOWN, fingers=RIGHT)
    drive = Spec("screwdriver", "drive", "handle", "cover", at=(-0.06, 0, 0), palm=DOWN, fingers=RIGHT)
    rod = Spec("screwdriver", "hand over", "shaft", "pinch", at=(0.015, 0, -0.006), palm=DOWN, fingers=RIGHT)
    drill = Spec(
        "drill",
        "drill",
        "grip",
        "pistol",
        at=(-0.03, 0, 0.005),
        palm=(0.4, 1, 0),
        fingers=(1, -0.4, 0),
        parts={"index": "trigger"},
    )
    motor = Spec("drill", "hand over", "body", "wrap", at=(-0.03, 0, 0.079), palm=DOWN, fingers=RIGHT)
    clamp = Spec(
        "clamp",
        "clamp",
        "handles",
        "prism",
        at=(-0.045, 0, 0),
        palm=DOWN,
        fingers=RIGHT,
        places={
            "thumb_distal": (-0.045, 0.036, 0),
            "index_distal": (-0.03, -0.031, 0),
            "middle_distal": (-0.05, -0.037, 0),
        },
    )
    jaws = Spec("clamp", "hand over", "jaws", "prism", at=(0.035, 0, 0), palm=DOWN, fingers=LEFT)
    torch = Spec("flashlight", "light", "body", "cover", at=(-0.02, 0, -0.004), palm=DOWN, fingers=RIGHT)
    glass = Spec("flashlight", "hand over", "head", "pinch", at=(0.05, 0, 0), palm=DOWN, fingers=LEFT)
    return [
        *_along(hammer, -0.06, -0.04),
        *_along(replace(hammer, kind="prism"), -0.05, -0.035),
        *_along(shaft, 0.0, 0.025),
        *_along(drive, -0.075, -0.06),
        *_along(replace(drive, kind="prism"), -0.065, -0.045),
        rod,
        drill,
        replace(drill, palm=(0.2, 1, 0), fingers=(1, -0.2, 0)),
        replace(drill, palm=(0.6, 1, 0), fingers=(1, -0.6, 0.2)),
        *_around(motor, 0, 180, about=(-0.03, 0)),
        clamp,
        replace(clamp, fingers=(-0.3, -1, 0)),
        replace(clamp, fingers=(0.3, -1, 0)),
        *_along(jaws, 0.03, 0.05),
        *_along(torch, -0.035, -0.015),
        *_along(replace(torch, kind="prism"), -0.01),
        *_along(glass, 0.045, 0.06),
    ]


def _desk() -> list[Spec]:
    snip = Spec(
        "scissors",
        "cut",
        "loops",
        "pinch",
        at=(-0.07, 0, 0),
        palm=DOWN,
        fingers=RIGHT,
        places={
            "thumb_distal": (-0.07, 0.008, 0),
            "index_distal": (-0.065, -0.008, 0),
            "middle_distal": (-0.08, -0.01, 0),
        },
    )
    blades = Spec("scissors", "hand over", "blades", "pinch", at=(0.0, 0, 0), palm=DOWN, fingers=LEFT)
    write = Spec(
        "marker", "write", "barrel", "tripod", at=(-0.01, 0, 0), palm=(0, 0.3, -1), fingers=(0.3, -1, -0.3)
    )
    cap = Spec("marker", "open", "cap", "pinch", at=(0.03, 0, 0), palm=DOWN, fingers=LEFT)
    read = Spec(
        "book", "read", "cover", "prism", at=(0.035, 0, 0), palm=BACK, fingers=(0, 0, 1), up=(1, 0, 0)
    )
    throw = Spec("tennis_ball", "throw", "ball", "disk", at=(0, 0, 0), palm=DOWN, fingers=AHEAD)
    return [
        snip,
        replace(snip, fingers=(-0.4, -1, 0)),
        replace(snip, fingers=(0.4, -1, 0)),
        *_along(blades, 0.0, 0.02),
        *_along(write, -0.02, -0.005),
        replace(write, kind="pinch", at=(-0.015, 0, 0)),
        cap,
        *_along(replace(cap, part="barrel", task="hand over"), -0.01),
        *_along(read, -0.02, 0.02, axis=1),
        *_along(replace(read, task="hand over", fingers=(0, 0, -1)), -0.02, 0.02, axis=1),
        *_around(throw, 0, 120, 240),
        *_around(replace(throw, kind="prism", task="hand over"), 60),
        *_around(replace(throw, palm=(0.5, 0, -1)), 0),
    ]


BUILTIN_SPECIFICATIONS: tuple[Spec, ...] = (*_drinking(), *_kitchen(), *_containers(), *_tools(), *_desk())
"""Specifications solved by ``fungrasp grasps make``."""
