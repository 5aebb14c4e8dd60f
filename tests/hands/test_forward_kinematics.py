"""Our hand models move as the makers' own models do."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hand_references import (
    CONFIGURATIONS,
    REFERENCES,
    Posed,
    Reference,
    ReferenceNumbers,
    random_angles,
    reference_numbers,
)

from fungrasp.geometry.poses import compose, invert, rotation_vector
from fungrasp.hands import Hand, hand_files, load_hand

POSITION_TOLERANCE = 1e-4
"""[m]"""
ANGLE_TOLERANCE = 5e-4
"""[rad]"""

CASES = [
    pytest.param(name, reference, id=f"{name}-{reference.file}")
    for name in hand_files()
    for reference in REFERENCES.get(name, ())
]


def joints_of(hand: Hand, body: str) -> list[str]:
    """Names of the joints that move a body against its parent."""
    model = hand.model
    return [model.joint(i).name for i in np.flatnonzero(model.jnt_bodyid == model.body(body).id)]


def assert_same_pose(ours: np.ndarray, theirs: np.ndarray, what: str) -> None:
    distance = np.linalg.norm(ours[:3] - theirs[:3])
    angle = np.linalg.norm(rotation_vector(compose(invert(theirs), ours)[3:]))
    assert distance < POSITION_TOLERANCE, f"{what}: {1e3 * distance:.3f} mm away"
    assert angle < ANGLE_TOLERANCE, f"{what}: turned by {angle:.5f} rad"


def shared_bodies(hand: Hand, reference: Reference, numbers: ReferenceNumbers) -> dict[str, str]:
    """Their name of each of our bodies that the reference has, palm first."""
    ours = [hand.model.body(i).name for i in range(1, hand.model.nbody)]
    found = {body: reference.bodies.get(body, body) for body in ours}
    return {body: their for body, their in found.items() if their in numbers.bodies}


def our_angles(hand: Hand, reference: Reference, numbers: ReferenceNumbers, row: int) -> dict[str, float]:
    """Our joint angles [rad] in the reference's configuration ``row``."""
    return {name: numbers.angles[reference.joints.get(name, name)][row] for name in hand.joint_names}


@pytest.mark.parametrize(("name", "reference"), CASES)
def test_frames_equal_the_reference(name: str, reference: Reference):
    hand, numbers = load_hand(name), reference_numbers(name, reference)
    ours = Posed(hand.model, hand.palm)
    bodies = shared_bodies(hand, reference, numbers)
    beyond = np.array([0.0, 0.0, reference.sites_beyond, 1.0, 0.0, 0.0, 0.0])
    for row in range(CONFIGURATIONS):
        ours.set(our_angles(hand, reference, numbers, row))
        for body, their_body in bodies.items():
            assert_same_pose(ours.body(body), numbers.bodies[their_body][row], f"body {body}")
        for joint in hand.joint_names:
            point, axis = ours.joint(joint)
            theirs = numbers.axes[reference.joints.get(joint, joint)][row]
            gap = np.linalg.norm(np.cross(axis, point - theirs[:3]))
            assert gap < POSITION_TOLERANCE, f"axis of {joint}: {1e3 * gap:.3f} mm away"
            np.testing.assert_allclose(axis, theirs[3:], atol=ANGLE_TOLERANCE, err_msg=f"axis of {joint}")
        for site, their_body in reference.sites.items():
            their_tip = numbers.bodies[their_body][row]
            assert_same_pose(compose(ours.site(site), beyond), their_tip, f"site {site}")


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_every_body_has_a_reference(name: str):
    hand = load_hand(name)
    compared = [set(shared_bodies(hand, r, reference_numbers(name, r))) for r in REFERENCES[name]]
    assert set().union(*compared) == {hand.model.body(i).name for i in range(1, hand.model.nbody)}


def test_every_robot_hand_has_a_reference():
    assert set(hand_files()) - set(REFERENCES) == {"human"}


@pytest.mark.parametrize(("name", "reference"), CASES)
def test_finger_joints_lie_on_their_axes(name: str, reference: Reference):
    hand, numbers = load_hand(name), reference_numbers(name, reference)
    ours, row = Posed(hand.model, hand.palm), CONFIGURATIONS - 1
    ours.set(our_angles(hand, reference, numbers, row))
    for finger in hand.fingers.values():
        for link, center in zip(finger.links, finger.joints, strict=True):
            for joint in joints_of(hand, link):
                theirs = numbers.axes[reference.joints.get(joint, joint)][row]
                gap = np.linalg.norm(np.cross(theirs[3:], ours.point(center) - theirs[:3]))
                assert gap < POSITION_TOLERANCE, f"{center} is {1e3 * gap:.2f} mm off the axis of {joint}"


@pytest.mark.parametrize("name", sorted(hand_files()))
def test_finger_joints_and_tips_ride_on_their_links(name: str):
    hand = load_hand(name)
    model = hand.model
    sites = {model.site(i).name: model.body(int(model.site_bodyid[i])).name for i in range(model.nsite)}
    for finger in hand.fingers.values():
        assert [sites.get(joint, joint) for joint in finger.joints] == list(finger.links)
        assert sites[finger.tip] == finger.links[-1]


@pytest.mark.parametrize("name", sorted(hand_files()))
def test_finger_joints_lie_in_the_middle_of_the_finger(name: str):
    hand = load_hand(name)
    model, posed = hand.model, Posed(hand.model, hand.palm)
    posed.set({})
    for finger in hand.fingers.values():
        for link, center in zip(finger.links, finger.joints, strict=True):
            geom = int(model.body(link).geomadr[0])
            assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
            middle, axis = posed.capsule(geom)
            off = np.linalg.norm(np.cross(axis, posed.point(center) - middle))
            assert off < 0.5 * model.geom_size[geom, 0], (
                f"{center} is {1e3 * off:.1f} mm off the axis of {link}"
            )


@pytest.mark.parametrize(("name", "reference"), CASES)
def test_limits_equal_the_reference(name: str, reference: Reference):
    hand, numbers = load_hand(name), reference_numbers(name, reference)
    for joint, limits in zip(hand.joint_names, hand.joint_limits, strict=True):
        theirs = numbers.limits[reference.joints.get(joint, joint)]
        np.testing.assert_allclose(limits, theirs, atol=1e-4, err_msg=f"limits of {joint}")


@pytest.mark.parametrize(("name", "reference"), CASES)
def test_couplings_hold_as_in_the_reference(name: str, reference: Reference):
    hand = load_hand(name)
    ours = {reference.joints.get(joint, joint): i for i, joint in enumerate(hand.joint_names)}
    for angles in random_angles(hand, 20):
        for terms, constant in reference_numbers(name, reference).couplings:
            value = sum(coefficient * angles[ours[joint]] for joint, coefficient in terms.items())
            assert value == pytest.approx(constant, abs=1e-4), f"{terms} = {constant}"
