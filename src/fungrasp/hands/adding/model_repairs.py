"""Repair joints and inertias of a foreign model, and find its palm."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.findings import Finding, listed, warning
from fungrasp.hands.kinematic_tree import ancestors, body_name, subtree

FINGER_RANGE = (-0.2, 1.6)
"""Proposed range of a hinge without limits [rad]: that of a human finger's joint, with some extension."""

LARGEST_RADIANS = 3.5
"""If no limit in degrees is larger, the limits are in radians."""

BALL_RANGE = 0.5
"""Proposed limit of a ball joint without one [rad]."""

BALL_TWIST = 0.05
"""Largest twist of a ball joint about its link, which rods and tendons prevent [rad]."""


def name_bodies(spec: mujoco.MjSpec) -> None:
    """Give every body a name."""
    for i, body in enumerate(spec.bodies[1:], start=1):
        body.name = body.name or f"body_{i}"


def repair_joints(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    """Name joints and bodies, delete free joints, replace ball joints by hinges, and correct limits."""
    kinds = mujoco.mjtJoint
    hinges = [np.abs(j.range).max() for j in spec.joints if j.type == kinds.mjJNT_HINGE and np.any(j.range)]
    if spec.compiler.degree and hinges and max(hinges) < LARGEST_RADIANS:
        spec.compiler.degree = False
        findings.append(
            warning(
                f"no hinge turns further than {max(hinges):.3g} degrees as the file is written: its angles "
                'are taken as radians (a <compiler angle="radian"/> is missing)'
            )
        )
    name_bodies(spec)
    for joint in list(spec.joints):
        if joint.type == kinds.mjJNT_FREE:
            spec.delete(joint)
        elif joint.type == kinds.mjJNT_BALL:
            findings.append(_three_hinges(spec, joint))
    taken = {joint.name for joint in spec.joints}
    for joint in spec.joints:
        name = joint.name or f"{joint.parent.name}_joint"
        while not joint.name and name in taken:
            name += "_"
        joint.name = name
        taken.add(name)
    _unwind_wheels(spec, findings)
    _limits(spec, findings)


def _unwind_wheels(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    """Fix bodies that turn by more than one turn and carry nothing, such as wheels of motors."""
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    hinges = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    wide = [j for j in hinges if np.ptp(j.range) * unit > 2 * np.pi + 1e-6]
    tied = {name for equality in spec.equalities for name in (equality.name1, equality.name2)}
    wheels = [j for j in wide if not list(j.parent.bodies) and j.name not in tied and j.parent.parent.name]
    if not wheels or 2 * len(wide) > len(hinges):
        return
    names = [joint.name for joint in wheels]
    for actuator in [a for a in spec.actuators if a.target in names]:
        spec.delete(actuator)
    for joint in wheels:
        spec.delete(joint)
    findings.append(
        warning(
            f"the joint {listed(names)} turns by more than one revolution and carries no other body: fixed"
        )
    )


def _three_hinges(spec: mujoco.MjSpec, ball: mujoco.MjsJoint) -> Finding:
    body, name, place = ball.parent, ball.name or f"{ball.parent.name}_ball", np.array(ball.pos)
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    limit = float(ball.range[1]) * unit
    stated = limit > 0
    if not stated:
        limit = BALL_RANGE
    friction, damping, armature = ball.frictionloss, np.array(ball.damping), ball.armature
    spec.delete(ball)
    # The link points to the next body.
    ahead = [np.asarray(child.pos) - place for child in body.bodies]
    along = int(np.argmax(np.abs(ahead[0]))) if ahead else 2
    for axis, letter in enumerate("xyz"):
        reach = min(limit, BALL_TWIST) if axis == along else limit
        hinge = body.add_joint(name=f"{name}_{letter}", type=mujoco.mjtJoint.mjJNT_HINGE, pos=place)
        hinge.axis, hinge.range = np.eye(3)[axis], np.array([-reach, reach]) / unit
        hinge.frictionloss, hinge.damping, hinge.armature = friction, damping, armature
    said = "within its cone" if stated else f"within {BALL_RANGE:g} rad, as it has no limit"
    return warning(
        f"the ball joint '{name}' became three hinges, {said}; its twist about the link stays within "
        f"{BALL_TWIST:g} rad"
    )


def _limits(spec: mujoco.MjSpec, findings: list[Finding]) -> None:
    unit = np.pi / 180 if spec.compiler.degree else 1.0
    none, turned, degrees, cut = [], [], [], []
    driven = {equality.name1 for equality in spec.equalities if equality.name2}
    hinges = [np.abs(j.range).max() * unit for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    in_degrees = 2 * sum(widest > 2 * np.pi + 1e-6 for widest in hinges) > len(hinges)
    for joint in spec.joints:
        low, high = np.asarray(joint.range) * unit
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        stated = bool(np.isfinite([low, high]).all()) and low != high
        if not stated:
            # A driven joint is limited by its driver's range.
            if joint.name not in driven:
                none.append(joint.name)
            low, high = FINGER_RANGE if hinge else (0.0, 0.03)
            if joint.name in driven:
                low, high = -np.pi, np.pi
        if low > high:
            turned.append(joint.name)
            low, high = high, low
        if hinge and stated and in_degrees:
            degrees.append(joint.name)
            low, high = np.radians([low, high])
        if hinge and max(-low, high) > np.pi + 1e-6:
            cut.append(f"{joint.name} {low:.3g} to {high:.3g}")
            low, high = max(low, -np.pi), min(high, np.pi)
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = np.array([low, high]) / unit
    for names, text in (
        (none, f"has no limits; {FINGER_RANGE[0]:g} to {FINGER_RANGE[1]:g} rad are proposed"),
        (turned, "has its limits swapped; corrected"),
        (degrees, "has limits in degrees, as most turn beyond a full turn in radians; taken as degrees"),
        (cut, "has limits beyond -pi to pi rad; clipped"),
    ):
        if names:
            findings.append(warning(f"the joint {listed(names)} {text}"))


def drop_bad_inertias(spec: mujoco.MjSpec, findings: list[Finding]) -> set[str]:
    """Correct impossible inertias and drop impossible masses. Return the names of bodies without a mass or
    primitive collision shapes."""
    wrong, massless = [], set()
    for body in spec.bodies[1:]:
        if body.explicitinertial:
            moments = _principal_inertias(body)
            radius = np.sqrt(max(moments[2], 0) / body.mass) if body.mass > 0 else np.inf
            sound = moments[0] > 0 and moments[2] <= (moments[0] + moments[1]) * (1 + 1e-3)
            if body.mass > 1e-6 and sound and 3e-4 < radius < 0.3:
                continue
            # The mass may be right although the inertia is wrong.
            if body.mass > 1e-6:
                wrong.append(body.name)
                body.fullinertia = [np.nan, 0, 0, 0, 0, 0]
                body.inertia = [body.mass * 1e-4] * 3
                continue
            body.explicitinertial = False
        if not any(geom.contype or geom.conaffinity for geom in body.geoms):
            massless.add(body.name)
    if wrong:
        findings.append(
            warning(
                f"the inertia of {listed(wrong)} is physically impossible: replaced by that of a body with a "
                "radius of gyration of 10 mm"
            )
        )
    return massless


def _principal_inertias(body: mujoco.MjsBody) -> np.ndarray:
    """Return the principal moments of inertia in ascending order [kg m^2], shape [3]."""
    diagonal, full = np.asarray(body.inertia), np.asarray(body.fullinertia)
    return np.linalg.eigvalsh(np.diag(diagonal) if np.isnan(full[0]) else _symmetric(full))


def _symmetric(full: np.ndarray) -> np.ndarray:
    """Return the matrix for xx, yy, zz, xy, xz, yz, shape [3, 3]."""
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


PALM_SHARE = 0.8
"""The palm carries more than this share of the branches' ends."""

MIN_BRANCHES = 3
"""Smallest number of branches with which several bodies are the palms of several hands."""


def find_palm(model: mujoco.MjModel, answer: str | None) -> int:
    """Return the id of the palm: the given body, else the last body that carries nearly all branches.

    Raises:
        FungraspError: the given body is unknown, or there is no palm or more than one.
    """
    names = {model.body(b).name: b for b in range(1, model.nbody)}
    if answer is not None:
        if answer not in names:
            raise FungraspError(f"--palm: {UnknownNameError('body', answer, names)}")
        return names[answer]
    moving = set(np.flatnonzero(model.body_jntnum > 0).tolist())
    if not moving:
        raise FungraspError("the model has no joints: not a hand")
    hands = _palms(model, moving)
    if len(hands) > 1:
        raise FungraspError(
            f"several bodies carry fingers: {listed([body_name(model, body) for body in hands])}; choose the "
            "palm with --palm BODY"
        )
    ends = branch_ends(model, moving)
    if len(ends) == 1:
        raise FungraspError(
            f"there is only one chain of joints, up to '{body_name(model, ends[0])}': a gripper with one "
            "jaw, or an arm without a hand"
        )
    # A scene may contain other objects: the hand is the tree with most ends.
    roots = [ancestors(model, end)[-1] for end in ends]
    root = max(dict.fromkeys(roots), key=roots.count)
    ends = [end for end, top in zip(ends, roots, strict=True) if top == root]
    held = {body: sum(body in ancestors(model, end)[1:] for end in ends) for body in range(1, model.nbody)}
    candidates = [body for body, count in held.items() if count > PALM_SHARE * len(ends) and count > 1]
    if not candidates:
        raise FungraspError(
            f"the fingers {listed([body_name(model, end) for end in ends])} hang on no common body; name the "
            "palm with --palm BODY (if they hang on the world, put the palm into a body of its own)"
        )
    return max(candidates, key=lambda body: len(ancestors(model, body)))


def branch_ends(model: mujoco.MjModel, moving: set[int]) -> list[int]:
    """Return the moving bodies that carry no other."""
    return [body for body in sorted(moving) if not moving & (set(subtree(model, body)) - {body})]


def _palms(model: mujoco.MjModel, moving: set[int]) -> list[int]:
    """Return the bodies with ``MIN_BRANCHES`` moving branches and no such body below them."""
    branches = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        branches[model.body_parentid[body]] += bool(moving & set(subtree(model, body)))
    wide = {body for body in range(1, model.nbody) if branches[body] >= MIN_BRANCHES}
    return [body for body in sorted(wide) if not wide & (set(subtree(model, body)) - {body})]
