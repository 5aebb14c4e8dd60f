"""Hands made for the tests of ``hands add``, with what foreign models lack or have too much of; claws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.hands import Hand, load_hand
from fungrasp.hands.adding.add_hand import Answers, add_hand


def added(folder: Path, text: str, suffix: str = ".xml", **answers: Any) -> tuple[Hand, list[str]]:
    """The hand that becomes of a description, and what adding and the check said; no errors among it."""
    folder.mkdir(exist_ok=True)
    (folder / f"odd{suffix}").write_text(text)
    path, findings = add_hand(folder / f"odd{suffix}", folder / "out", answers=Answers(**answers), force=True)
    assert not [finding.message for finding in findings if finding.severity == "error"]
    return load_hand(path), [finding.message for finding in findings]


FINGERS = {
    "index": (0.035, 0.09),
    "middle": (0.012, 0.095),
    "ring": (-0.012, 0.09),
    "pinky": (-0.035, 0.08),
}
"""Place of each finger's base across and along the palm of a right hand [m]."""

LINKS = (0.045, 0.03, 0.025)
"""Lengths of a finger's links [m]."""


def odd_hand(
    fingers: int = 4,
    *,
    left: bool = False,
    collision: bool = True,
    ball: bool = False,
    arm: bool = False,
    palm_place: str = "",
    first_sibling: bool = False,
    limits: bool = True,
    coupled: str = "",
    mass: bool = True,
) -> str:
    """MJCF of a hand with ``fingers`` fingers and a thumb; fingers along z, the palm faces x. Names tell
    nothing: the links of the third finger are "c1", "c2", "c3", those of the thumb "z1", "z2", "z3".

    Args:
        fingers: one to four.
        left: the mirror image.
        collision: shapes on the links.
        ball: a ball joint at each finger's base instead of two hinges.
        arm: two hinges with links before the palm.
        palm_place: attributes of the palm body, as ``pos="..." quat="..."``.
        first_sibling: a fixed body hangs on the palm before the fingers.
        limits: ranges of the joints.
        coupled: "equality" or "tendon" ties the last two joints of each finger.
        mass: inertials of the links.
    """
    side = -1.0 if left else 1.0
    parts = []
    for letter, (across, along) in list(zip("abcd", FINGERS.values(), strict=True))[:fingers]:
        parts.append(_finger(letter, f'pos="0 {side * across} {along}"', collision, ball, limits, mass))
    along = np.array([0.3, 0.7 * side, 0.65])
    along /= np.linalg.norm(along)
    bend = np.array([0.7, -0.6 * side, 0.2])
    bend -= (bend @ along) * along
    axes = " ".join(f"{value:.6f}" for value in [*bend, *np.cross(along, bend)])
    place = f'pos="0.015 {side * 0.04} 0.03" xyaxes="{axes}"'
    parts.append(_finger("z", place, collision, False, limits, mass))
    sibling = '<body name="cover" pos="-0.01 0 0.04"><geom type="box" size="0.003 0.03 0.03"/></body>'
    palm = f"""<body name="p" {palm_place}>
      {'<geom type="box" size="0.012 0.045 0.04" pos="0 0 0.04" mass="0.3"/>' if collision else ""}
      {sibling if first_sibling else ""}{"".join(parts)}</body>"""
    if arm:
        palm = f"""<body name="u"><joint name="shoulder" axis="0 0 1" range="-3 3"/>
          <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.3"/>
          <body name="v" pos="0 0 0.3"><joint name="elbow" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.2"/>
          <body name="w" pos="0 0 0.25">{palm}</body></body></body>"""
    ties = ""
    letters = "abcd"[:fingers] + "z"
    if coupled == "equality":
        rows = [f'<joint joint1="{k}3_j" joint2="{k}2_j" polycoef="0.1 0.8 0 0 0"/>' for k in letters]
        ties = f"<equality>{''.join(rows)}</equality>"
    elif coupled == "tendon":
        rows = [
            f'<fixed name="{k}_t"><joint joint="{k}2_j" coef="1"/><joint joint="{k}3_j" coef="1"/></fixed>'
            for k in letters
        ]
        ties = f"<tendon>{''.join(rows)}</tendon>"
    return f"""<mujoco><compiler angle="radian" autolimits="true" boundmass="1e-6" boundinertia="1e-9"/>
      <default><geom type="capsule" size="0.008"/></default>
      <worldbody>{palm}</worldbody>{ties}</mujoco>"""


def _finger(letter: str, place: str, collision: bool, ball: bool, limits: bool, mass: bool) -> str:
    text = ""
    for i in reversed(range(3)):
        length = LINKS[i]
        at = place if i == 0 else f'pos="0 0 {LINKS[i - 1]}"'
        wide = ' range="-0.1 1.5"' if limits else ""
        joint = f'<joint name="{letter}{i + 1}_j" axis="0 1 0"{wide}/>'
        if i == 0 and ball:
            joint = f'<joint name="{letter}_ball" type="ball"/>'
        elif i == 0:
            joint = f'<joint name="{letter}_s" axis="1 0 0" range="-0.3 0.3"/>{joint}'
        shape = f'<geom fromto="0 0 0.004 0 0 {length - 0.002}"/>' if collision else ""
        weight = (
            f'<inertial pos="0 0 {length / 2}" mass="0.03" diaginertia="6e-6 6e-6 1e-6"/>' if mass else ""
        )
        text = f'<body name="{letter}{i + 1}" {at}>{joint}{weight}{shape}{text}</body>'
    return text


RADIUS = 0.05
"""Distance of the fingers' bases from the center [m]."""


def claw(
    count: int = 3, low: float = -1.5, high: float = 1.5, turns: str = "1 -1 1", degrees: bool = False
) -> str:
    """MJCF of ``count`` fingers of two links along z around the body "base".

    Args:
        count: of fingers.
        low, high: limits of every joint [rad].
        turns: sign of each finger's axis; 1 bends to the center with growing angles.
        degrees: leave out the compiler's settings, so that angles count as degrees.
    """
    parts = []
    for k, sign in enumerate(turns.split()[:count]):
        angle = 2 * np.pi * k / count
        outward = np.array([np.cos(angle), np.sin(angle)])
        # About this axis a finger along z bends to the center.
        axis = float(sign) * np.array([outward[1], -outward[0]])
        hinge = f'axis="{axis[0]:.6f} {axis[1]:.6f} 0" range="{low} {high}"'
        parts.append(
            f"""<body name="f{k}a" pos="{RADIUS * outward[0]:.6f} {RADIUS * outward[1]:.6f} 0.02">
            <joint name="f{k}a_j" {hinge}/><geom fromto="0 0 0 0 0 0.05" mass="0.03"/>
            <body name="f{k}b" pos="0 0 0.05"><joint name="f{k}b_j" {hinge}/>
            <geom fromto="0 0 0 0 0 0.04" mass="0.03"/></body></body>"""
        )
    compiler = "" if degrees else '<compiler angle="radian"/>'
    return f"""<mujoco>{compiler}<default><geom type="capsule" size="0.009"/></default><worldbody>
      <body name="base"><geom type="box" size="0.04 0.04 0.01" mass="0.3"/>{"".join(parts)}</body>
      </worldbody></mujoco>"""
