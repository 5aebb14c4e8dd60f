"""Check whether size, mass and kinematics of a loaded hand are plausible."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import mujoco
import numpy as np

from fungrasp.hands.findings import Finding, error, finger_of, listed, warning
from fungrasp.hands.hand import Hand
from fungrasp.hands.kinematic_tree import ancestors, body_name, coupled_positions, joint_name, place_of

LARGEST = 0.5
"""Largest diagonal of the bounding box of a straight hand [m]; the largest robot hands have 0.45."""

MASSES = (0.01, 5.0)
"""Range of hand masses [kg], from small printed hands to steel hands with motors."""

FINGER_LENGTHS = (0.03, 0.25)
"""Range of finger lengths from the first joint to the tip [m]."""

SHAPE_RATIO = 3.0
"""Largest radius of the bounding sphere of a link's geom, as a multiple of the finger's length."""

ASIDE = 0.03
"""Largest distance of a link's nearest geom from its joint [m]."""

FAR_MASS = 0.05
"""Largest distance of a center of mass from the body's geoms [m]."""

WIDEST = np.pi + 0.1
"""Largest range of a finger's joint [rad]; wider limits are placeholders."""

STILL = 0.05
"""A finger moves if one of its joints has at least this range [rad]."""

LEAST_BEND = 5e-3
"""Motion of the fingertips to the middle pose that shows to which side they bend [m]."""

STRAIGHTER = 1.1
"""A finger that is longer by this factor at a limit of its joints than at zero is bent at zero."""


def check_plausibility(hand: Hand) -> Iterator[Finding]:
    """Yield implausible properties of a hand, with their values."""
    model, data = hand.model, mujoco.MjData(hand.model)
    low, high = (model.jnt_range[:, end].copy() for end in (0, 1))
    straight = coupled_positions(model, np.clip(np.zeros(model.nq), low, high))
    data.qpos[:] = straight
    mujoco.mj_kinematics(model, data)
    solid = np.flatnonzero(
        ((model.geom_contype > 0) | (model.geom_conaffinity > 0)) & (model.geom_bodyid > 0)
    )
    misplaced = list(_misplaced_shapes(hand, data, solid))
    yield from misplaced
    if any(finding.severity == "error" for finding in misplaced):
        # The further checks depend on the geoms.
        return
    reach = model.geom_rbound[solid]
    if len(solid):
        extent = float(np.linalg.norm(_boxes(model, data, solid)))
        if extent > LARGEST:
            yield error(
                f"the hand is {extent:.2f} m large, more than {LARGEST:g} m: are its shapes in meters?"
            )
    mass = float(model.body_mass.sum())
    if not MASSES[0] <= mass <= MASSES[1]:
        yield error(
            f"the hand weighs {mass:.4g} kg, not {MASSES[0]:g} to {MASSES[1]:g} kg: are the file's masses in "
            "kilograms, and those of the hand alone?"
        )
    heavy = [
        f"{body_name(model, body)} ({1e3 * far:.0f} mm)"
        for body in np.unique(model.geom_bodyid[solid])
        if (far := _outside(model, solid, int(body), model.body_ipos[body])) > FAR_MASS
    ]
    if heavy:
        yield error(
            f"the center of mass lies far outside the shapes of {listed(heavy)}: is the origin of the "
            "inertial in meters, and in the body's frame?"
        )
    long = []
    for name, finger in hand.fingers.items():
        bodies = {model.body(link).id for link in finger.links}
        turns = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in bodies]
        if turns and (high - low)[turns].max() < STILL:
            yield warning(f"the {name} does not move: its joints are fixed, or held still by couplings")
        places = [place_of(data, key) for key in (*finger.joints, finger.tip)]
        length = float(sum(np.linalg.norm(b - a) for a, b in pairwise(places)))
        if not FINGER_LENGTHS[0] <= length <= FINGER_LENGTHS[1]:
            yield error(
                f"the {name} is {1e3 * length:.0f} mm long, not {1e3 * FINGER_LENGTHS[0]:.0f} to "
                f"{1e3 * FINGER_LENGTHS[1]:.0f} mm: is it in meters, and is '{finger.links[0]}' its base?"
            )
        sizes = [float(r) for g, r in zip(solid, reach, strict=True) if int(model.geom_bodyid[g]) in bodies]
        if max(sizes, default=0.0) > SHAPE_RATIO * length:
            long.append(f"{name} ({max(sizes):.2f} m)")
    if long:
        yield error(
            f"shapes of the {listed(long)} are much larger than the finger: are the meshes in meters?"
        )
    wide = []
    for joint in range(model.njnt):
        in_finger = any(
            model.body(link).id in ancestors(model, int(model.jnt_bodyid[joint]))
            or int(model.jnt_bodyid[joint]) == model.body(link).id
            for finger in hand.fingers.values()
            for link in finger.links
        )
        if in_finger and high[joint] - low[joint] > WIDEST:
            wide.append(f"{joint_name(model, joint)} by {high[joint] - low[joint]:.2f} rad")
    if wide:
        yield error(f"{listed(wide)}: no joint of a finger turns so far; write its true limits into the file")
    yield from _palm_frame(hand, data, straight)
    named = {name: finger_of(finger.links[0]) for name, finger in hand.fingers.items()}
    wrong = [
        f"{hand.fingers[name].links[0]} as {name}" for name, said in named.items() if said not in (None, name)
    ]
    if wrong and len(set(named.values())) == len(named) and None not in named.values():
        yield error(
            f"fingers are not what their bodies are named after: {listed(wrong)}; say which is which with "
            "'hands add --finger index=BODY ... --thumb BODY', or rename them"
        )


def _misplaced_shapes(hand: Hand, data: mujoco.MjData, solid: np.ndarray) -> Iterator[Finding]:
    """Find links whose geoms are far from their joints."""
    model, far, count = hand.model, [], 0
    for finger in hand.fingers.values():
        for link, joint in zip(finger.links, finger.joints, strict=True):
            body = data.body(link)
            at = (place_of(data, joint) - body.xpos) @ body.xmat.reshape(3, 3)
            gap = _outside(model, solid, body.id, at)
            count += np.isfinite(gap)
            if np.isfinite(gap) and gap > ASIDE:
                far.append(f"{link} ({1e3 * gap:.0f} mm)")
    if far:
        say = error if 2 * len(far) > count else warning
        yield say(
            f"shapes are far from the joint of their link: {listed(far)}; are their meshes in the frame of "
            "the whole hand, with no origin that moves them to the link's?"
        )


def _outside(model: mujoco.MjModel, solid: np.ndarray, body: int, point: np.ndarray) -> float:
    """Return the distance of a point, body frame, from the nearest bounding box of the body's geoms [m];
    infinite without geoms."""
    best = np.inf
    for geom in solid[model.geom_bodyid[solid] == body]:
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        local = (point - model.geom_pos[geom]) @ turn.reshape(3, 3) - model.geom_aabb[geom, :3]
        best = min(best, float(np.linalg.norm(np.maximum(np.abs(local) - model.geom_aabb[geom, 3:], 0.0))))
    return best


def _boxes(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Return the extents of the geoms' common bounding box, palm frame [m], shape [3]."""
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T
    points = []
    for geom in geoms:
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        points.append(data.geom_xpos[geom] + (center + corners * half) @ data.geom_xmat[geom].reshape(3, 3).T)
    return np.ptp(np.concatenate(points), axis=0)


def _palm_frame(hand: Hand, data: mujoco.MjData, straight: np.ndarray) -> Iterator[Finding]:
    """Check whether the fingers point and bend in the directions of the palm frame."""
    model, along, normal = hand.model, hand.palm_fingers, hand.palm_normal
    if abs(float(along @ normal)) > 0.1:
        yield warning("palm_frame: 'fingers' and 'normal' must be perpendicular")
    fingers = [finger for name, finger in hand.fingers.items() if name != "thumb"]
    turn = data.body(hand.palm).xmat.reshape(3, 3).copy()

    def spans(positions: np.ndarray) -> np.ndarray:
        """Return the vector from base to tip of each finger, palm frame [m], shape [F, 3]."""
        data.qpos[:] = coupled_positions(model, positions)
        mujoco.mj_kinematics(model, data)
        return np.array([place_of(data, f.tip) - place_of(data, f.links[0]) for f in fingers]) @ turn

    lower, upper = model.jnt_range.T
    poses = np.stack([spans(positions) for positions in (straight, lower, upper)])
    lengths = np.linalg.norm(poses, axis=-1)
    # A finger that is bent at zero is straight at one of its limits.
    best = np.where(lengths.max(axis=0) > STRAIGHTER * lengths[0], lengths.argmax(axis=0), 0)
    motion = (spans(0.5 * (lower + upper)) - poses[best, np.arange(len(fingers))]).mean(axis=0)
    direction = (poses / np.maximum(lengths, 1e-9)[..., None]).mean(axis=1)
    cosines = direction @ along / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    if angles.min() > 60.0:
        yield error(
            f"palm_frame.fingers is {angles[0]:.0f} degrees off the direction of the fingers at the zero "
            f"pose, {_numbers(direction[0])}"
        )
    across = motion - (motion @ along) * along
    if across @ normal < -0.3 * np.linalg.norm(across) - LEAST_BEND:
        yield error(
            f"palm_frame.normal (--normal) points out of the back of the hand: fingers bend along "
            f"{_numbers(motion)}"
        )


def _numbers(vector: np.ndarray) -> str:
    unit = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return "(" + ", ".join(f"{value:.2f}" for value in unit) + ")"
