"""Claws made for tests: fingers alike around a center."""

from __future__ import annotations

import numpy as np

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
