"""Faults of the parts named in a hand's TOML: finger chains, tips, the palm's frame."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import mujoco
import numpy as np

from fungrasp.hands.checking.findings import Finding, HandParts, error, warning
from fungrasp.hands.kinematic_tree import ancestors, body_name, coupled_positions
from fungrasp.hands.kinematics import FARTHEST, palm_offset

FAR_ORIGIN = 0.02
"""A palm's origin this much too far from the fingers is mentioned [m]."""

STRAIGHTER = 1.1
"""A finger that is this much longer at an end of its joints' range than at zero is bent at zero."""

LEAST_BEND = 5e-3
"""Motion of fingertips from the straight to the middle pose that tells where they bend to [m]."""

SHORTEST_LINK = 1e-3
"""Key points of a finger nearer than this are one and the same [m]."""


def check_fingers(model: mujoco.MjModel, parts: HandParts) -> Iterator[Finding]:
    """Is each finger one chain from the palm to its tip, in that order?"""
    owners: dict[str, str] = {}
    for finger, links in parts.fingers.items():
        for link in links:
            if owners.setdefault(link, finger) != finger or links.count(link) > 1:
                yield error(f"the body '{link}' is named twice: in finger '{owners[link]}' and in '{finger}'")
        yield from _chain(model, parts.palm, finger, links)
        tip = parts.tips.get(finger)
        if tip is None or not links:
            continue
        carrier = carrier_of(model, tip)
        last = model.body(links[-1]).id
        if last not in ancestors(model, carrier):
            yield error(
                f"finger '{finger}': the tip '{tip}' is on the body '{body_name(model, carrier)}', not "
                f"on the last link '{links[-1]}'"
            )
        elif model.body_weldid[carrier] != model.body_weldid[last]:
            yield error(
                f"finger '{finger}': a joint moves the tip '{tip}' against the last link '{links[-1]}'"
            )
        else:
            yield from _lengths(model, finger, (*parts.joints.get(finger, links), tip))


def is_site(model: mujoco.MjModel, name: str) -> bool:
    """Whether a key point is a site; else it is a body."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0


def carrier_of(model: mujoco.MjModel, name: str) -> int:
    """Id of the body on which a site or body lies."""
    return int(model.site(name).bodyid[0]) if is_site(model, name) else int(model.body(name).id)


def check_palm_origin(model: mujoco.MjModel, parts: HandParts) -> Iterator[Finding]:
    """Is the palm's origin, whose poses grasps hold, near the hand?"""
    fingers = [name for name in parts.fingers if name != "thumb"]
    if parts.palm is None or not fingers:
        return
    bases = [parts.joints.get(name, parts.fingers[name])[0] for name in fingers]
    excess = float(np.linalg.norm(palm_offset(model, parts.palm, bases)))
    if excess > FAR_ORIGIN:
        yield warning(
            f"the origin of the palm '{parts.palm}' lies {excess + FARTHEST:.2f} m from the bases of the "
            "fingers: grasps hold the poses of a place outside the hand, as of a flange; hands start as far "
            "from objects as others do"
        )


def check_palm_frame(
    model: mujoco.MjModel, parts: HandParts, along: np.ndarray, normal: np.ndarray
) -> Iterator[Finding]:
    """Do the fingers point where the palm's frame says, and close to where it says?

    Args:
        parts: with palm, fingers and tips.
        along: ``palm_frame.fingers``, shape [3].
        normal: ``palm_frame.normal``, shape [3].
    """
    if abs(float(along @ normal)) > 0.1:
        yield warning("palm_frame: 'fingers' and 'normal' must be perpendicular")
    fingers = [name for name in parts.fingers if name != "thumb" and name in parts.tips]
    if parts.palm is None or not fingers:
        return
    lower, upper = _limits(model)
    open_poses = [
        coupled_positions(model, p) for p in (np.clip(np.zeros(model.nq), lower, upper), lower, upper)
    ]
    bent = coupled_positions(model, 0.5 * (lower + upper))
    directions, motions = [], []
    for finger in fingers:
        spans = np.array(
            [tip - base for base, tip in (_key_points(model, parts, finger, pose) for pose in open_poses)]
        )
        lengths = np.linalg.norm(spans, axis=1)
        # Where zero is a bent pose, the finger is straight at an end of its range.
        straight = int(np.argmax(lengths)) if lengths.max() > STRAIGHTER * lengths[0] else 0
        tip = _key_points(model, parts, finger, open_poses[straight])[1]
        directions.append(spans / np.maximum(lengths, 1e-9)[:, None])
        motions.append(_key_points(model, parts, finger, bent)[1] - tip)
    direction, motion = np.mean(directions, axis=0), np.mean(motions, axis=0)
    length = np.maximum(np.linalg.norm(direction, axis=1), 1e-9)
    angles = np.degrees(np.arccos(np.clip(direction @ along / length, -1, 1)))
    if angles.min() > 60.0:
        yield error(
            f"palm_frame.fingers is {angles[0]:.0f} degrees off the direction of the fingers at the zero "
            f"pose, {_numbers(direction[0])}"
        )
    across = motion - (motion @ along) * along
    if across @ normal < -0.3 * np.linalg.norm(across) - LEAST_BEND:
        yield error(
            f"palm_frame.normal points out of the back of the hand: fingers bend along {_numbers(motion)}"
        )


def _chain(model: mujoco.MjModel, palm: str | None, finger: str, links: tuple[str, ...]) -> Iterator[Finding]:
    chain = (() if palm is None else (palm,)) + links
    for near, far in pairwise(chain):
        inner, outer = model.body(near).id, model.body(far).id
        up = ancestors(model, outer)
        if inner in up:
            if model.body_weldid[inner] == model.body_weldid[outer]:
                yield error(f"finger '{finger}': no joint between '{near}' and '{far}', so they are one link")
        elif outer in ancestors(model, inner):
            yield error(
                f"finger '{finger}': '{far}' is nearer to the palm than '{near}'; list links from base to tip"
            )
        else:
            yield error(f"finger '{finger}' is not one chain: '{far}' does not hang on '{near}'")


def _lengths(model: mujoco.MjModel, finger: str, names: tuple[str, ...]) -> Iterator[Finding]:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = [data.site(name).xpos if is_site(model, name) else data.body(name).xpos for name in names]
    for (near, a), (far, b) in pairwise(zip(names, points, strict=True)):
        if np.linalg.norm(b - a) < SHORTEST_LINK:
            yield error(
                f"finger '{finger}': '{near}' and '{far}' begin at the same point; leave out '{near}', or "
                "move the tip to the link's end"
            )


def _key_points(
    model: mujoco.MjModel, parts: HandParts, finger: str, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Base and tip of a finger in the palm's frame [m], each of shape [3]."""
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    palm = model.body(parts.palm).id
    rotation = data.xmat[palm].reshape(3, 3)
    base = data.xpos[model.body(parts.fingers[finger][0]).id]
    name = parts.tips[finger]
    tip = data.site(name).xpos if is_site(model, name) else data.body(name).xpos
    return (base - data.xpos[palm]) @ rotation, (tip - data.xpos[palm]) @ rotation


def _limits(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Limits of all coordinates, 0 where there are none; each of shape [nq]."""
    lower, upper = np.zeros(model.nq), np.zeros(model.nq)
    joints = np.flatnonzero(model.jnt_limited)
    lower[model.jnt_qposadr[joints]], upper[model.jnt_qposadr[joints]] = model.jnt_range[joints].T
    return lower, upper


def _numbers(vector: np.ndarray) -> str:
    unit = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return "(" + ", ".join(f"{value:.2f}" for value in unit) + ")"
