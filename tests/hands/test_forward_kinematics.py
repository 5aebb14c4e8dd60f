"""Our hand models move as the makers' own models do."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hand_references import FOLDER, REFERENCES, Reference, reference_couplings, reference_model

from fungrasp.geometry.poses import compose, invert, rotate, rotation_vector
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
WITHOUT_REFERENCE = sorted(set(hand_files()) - set(REFERENCES))

needs_files = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the reference hand models are not in {FOLDER}")


class Posed:
    """A model whose frames are read relative to its palm."""

    def __init__(self, model: mujoco.MjModel, palm: str):
        self.model, self.palm, self.data = model, palm, mujoco.MjData(model)

    def set(self, angles: dict[str, float]) -> None:
        """Joints not named stay at zero."""
        self.data.qpos[:] = 0.0
        for joint, angle in angles.items():
            self.data.qpos[self.model.joint(joint).qposadr[0]] = angle
        mujoco.mj_kinematics(self.model, self.data)

    def _pose_world(self, body: str) -> np.ndarray:
        frame = self.data.body(body)
        return np.concatenate([frame.xpos, frame.xquat])

    def body(self, name: str) -> np.ndarray:
        """Pose in the palm frame, shape [7]."""
        return compose(invert(self._pose_world(self.palm)), self._pose_world(name))

    def site(self, name: str) -> np.ndarray:
        """Pose in the palm frame, shape [7]."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self.data.site(name).xmat)
        return compose(
            invert(self._pose_world(self.palm)), np.concatenate([self.data.site(name).xpos, quaternion])
        )

    def joint(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """A point on the axis and the axis' direction in the palm frame, shapes [3]."""
        inverse = invert(self._pose_world(self.palm))
        joint = self.data.joint(name)
        return inverse[:3] + rotate(inverse[3:], joint.xanchor), rotate(inverse[3:], joint.xaxis)

    def point(self, name: str) -> np.ndarray:
        """A site's, or else a body's, position in the palm frame, shape [3]."""
        is_site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0
        return (self.site(name) if is_site else self.body(name))[:3]

    def capsule(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """A capsule's middle and the direction of its axis in the palm frame, shapes [3]."""
        inverse = invert(self._pose_world(self.palm))
        axis = self.data.geom_xmat[geom].reshape(3, 3)[:, 2]
        return inverse[:3] + rotate(inverse[3:], self.data.geom_xpos[geom]), rotate(inverse[3:], axis)


def joints_of(hand: Hand, body: str) -> list[str]:
    """Names of the joints that move a body against its parent."""
    model = hand.model
    return [model.joint(i).name for i in np.flatnonzero(model.jnt_bodyid == model.body(body).id)]


def random_angles(hand: Hand, count: int) -> np.ndarray:
    """Joint angles [rad] that keep the couplings, shape [count, M]: limits, zero, then uniform draws."""
    free = [hand.joint_names.index(name) for name in hand.actuators]
    low, high = hand.joint_limits[free].T
    draws = np.random.default_rng(0).uniform(low, high, size=(count - 3, len(free)))
    matrix, offset = hand.coupling
    return np.concatenate([[low, high, np.clip(0.0, low, high)], draws]) @ matrix.T + offset


def assert_same_pose(ours: np.ndarray, theirs: np.ndarray, what: str) -> None:
    distance = np.linalg.norm(ours[:3] - theirs[:3])
    angle = np.linalg.norm(rotation_vector(compose(invert(theirs), ours)[3:]))
    assert distance < POSITION_TOLERANCE, f"{what}: {1e3 * distance:.3f} mm away"
    assert angle < ANGLE_TOLERANCE, f"{what}: turned by {angle:.5f} rad"


def shared_bodies(hand: Hand, reference: Reference, model: mujoco.MjModel) -> dict[str, str]:
    """Their name of each of our bodies that the reference model has, palm first."""
    ours = [hand.model.body(i).name for i in range(1, hand.model.nbody)]
    theirs = {model.body(i).name for i in range(1, model.nbody)}
    found = {body: reference.bodies.get(body, body) for body in ours}
    return {body: their for body, their in found.items() if body in reference.bodies or their in theirs}


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_frames_equal_the_reference(name: str, reference: Reference):
    hand, model = load_hand(name), reference_model(reference)
    ours, theirs = Posed(hand.model, hand.palm), Posed(model, reference.palm)
    bodies = shared_bodies(hand, reference, model)
    joints = {joint: reference.joints.get(joint, joint) for joint in hand.joint_names}
    beyond = np.array([0.0, 0.0, reference.sites_beyond, 1.0, 0.0, 0.0, 0.0])
    for angles in random_angles(hand, 40):
        ours.set(dict(zip(hand.joint_names, angles, strict=True)))
        theirs.set({joints[joint]: angle for joint, angle in zip(hand.joint_names, angles, strict=True)})
        for body, their_body in bodies.items():
            assert_same_pose(ours.body(body), theirs.body(their_body), f"body {body}")
        for joint, their_joint in joints.items():
            (point, axis), (their_point, their_axis) = ours.joint(joint), theirs.joint(their_joint)
            gap = np.linalg.norm(np.cross(axis, point - their_point))
            assert gap < POSITION_TOLERANCE, f"axis of {joint}: {1e3 * gap:.3f} mm away"
            np.testing.assert_allclose(axis, their_axis, atol=ANGLE_TOLERANCE, err_msg=f"axis of {joint}")
        for site, their_body in reference.sites.items():
            assert_same_pose(compose(ours.site(site), beyond), theirs.body(their_body), f"site {site}")


@needs_files
@pytest.mark.parametrize("name", sorted({str(case.values[0]) for case in CASES}))
def test_every_body_has_a_reference(name: str):
    hand = load_hand(name)
    compared = [set(shared_bodies(hand, r, reference_model(r))) for r in REFERENCES[name]]
    assert set().union(*compared) == {hand.model.body(i).name for i in range(1, hand.model.nbody)}


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_finger_joints_lie_on_their_axes(name: str, reference: Reference):
    hand = load_hand(name)
    ours, theirs = Posed(hand.model, hand.palm), Posed(reference_model(reference), reference.palm)
    angles = random_angles(hand, 5)[-1]
    ours.set(dict(zip(hand.joint_names, angles, strict=True)))
    theirs.set(
        {reference.joints.get(joint, joint): a for joint, a in zip(hand.joint_names, angles, strict=True)}
    )
    for finger in hand.fingers.values():
        for link, centre in zip(finger.links, finger.joints, strict=True):
            for joint in joints_of(hand, link):
                point, axis = theirs.joint(reference.joints.get(joint, joint))
                gap = np.linalg.norm(np.cross(axis, ours.point(centre) - point))
                assert gap < POSITION_TOLERANCE, f"{centre} is {1e3 * gap:.2f} mm off the axis of {joint}"


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
        for link, centre in zip(finger.links, finger.joints, strict=True):
            geom = int(model.body(link).geomadr[0])
            assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
            middle, axis = posed.capsule(geom)
            off = np.linalg.norm(np.cross(axis, posed.point(centre) - middle))
            assert off < 0.5 * model.geom_size[geom, 0], (
                f"{centre} is {1e3 * off:.1f} mm off the axis of {link}"
            )


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_limits_equal_the_reference(name: str, reference: Reference):
    hand, model = load_hand(name), reference_model(reference)
    for joint, limits in zip(hand.joint_names, hand.joint_limits, strict=True):
        theirs = model.joint(reference.joints.get(joint, joint)).range
        np.testing.assert_allclose(limits, theirs, atol=1e-4, err_msg=f"limits of {joint}")


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_couplings_hold_as_in_the_reference(name: str, reference: Reference):
    hand = load_hand(name)
    ours = {reference.joints.get(joint, joint): i for i, joint in enumerate(hand.joint_names)}
    for angles in random_angles(hand, 20):
        for terms, constant in reference_couplings(reference):
            value = sum(coefficient * angles[ours[joint]] for joint, coefficient in terms.items())
            assert value == pytest.approx(constant, abs=1e-4), f"{terms} = {constant}"


@pytest.mark.parametrize("name", WITHOUT_REFERENCE)
def test_hand_without_a_reference(name: str):
    pytest.skip(f"the hand '{name}' has no entry in REFERENCES (tests/hands/hand_references.py)")
