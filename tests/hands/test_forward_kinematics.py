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


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_frames_equal_the_reference(name: str, reference: Reference):
    hand = load_hand(name)
    ours, theirs = Posed(hand.model, hand.palm), Posed(reference_model(reference), reference.palm)
    names = [hand.model.body(i).name for i in range(1, hand.model.nbody)]
    bodies = {body: reference.bodies.get(body, body) for body in names}
    joints = {joint: reference.joints.get(joint, joint) for joint in hand.joint_names}
    ours.set({})
    theirs.set({})
    offsets = {body: compose(invert(theirs.body(their)), ours.body(body)) for body, their in bodies.items()}
    identity = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    beyond = np.array([0.0, 0.0, reference.sites_beyond, 1.0, 0.0, 0.0, 0.0])
    if not reference.moved_frames:
        for body, offset in offsets.items():
            assert_same_pose(offset, identity, f"frame of {body}")
            offsets[body] = identity

    for angles in random_angles(hand, 40):
        ours.set(dict(zip(hand.joint_names, angles, strict=True)))
        theirs.set({joints[joint]: angle for joint, angle in zip(hand.joint_names, angles, strict=True)})
        for body, their_body in bodies.items():
            assert_same_pose(ours.body(body), compose(theirs.body(their_body), offsets[body]), f"body {body}")
        for joint, their_joint in joints.items():
            (point, axis), (their_point, their_axis) = ours.joint(joint), theirs.joint(their_joint)
            assert np.linalg.norm(np.cross(axis, point - their_point)) < POSITION_TOLERANCE, (
                f"axis of {joint}"
            )
            np.testing.assert_allclose(axis, their_axis, atol=ANGLE_TOLERANCE, err_msg=f"axis of {joint}")
        for site, their_body in reference.sites.items():
            assert_same_pose(compose(ours.site(site), beyond), theirs.body(their_body), f"site {site}")


@needs_files
@pytest.mark.parametrize(("name", "reference"), CASES)
def test_link_origins_lie_on_their_joint_axes(name: str, reference: Reference):
    hand = load_hand(name)
    ours, theirs = Posed(hand.model, hand.palm), Posed(reference_model(reference), reference.palm)
    angles = random_angles(hand, 5)[-1]
    ours.set(dict(zip(hand.joint_names, angles, strict=True)))
    theirs.set(
        {reference.joints.get(joint, joint): a for joint, a in zip(hand.joint_names, angles, strict=True)}
    )
    for finger in hand.fingers.values():
        for link in finger.links:
            for i in range(hand.model.njnt):
                if hand.model.body(int(hand.model.jnt_bodyid[i])).name == link:
                    joint = hand.joint_names[i]
                    point, axis = theirs.joint(reference.joints.get(joint, joint))
                    gap = np.linalg.norm(np.cross(axis, ours.body(link)[:3] - point))
                    assert gap < POSITION_TOLERANCE, f"{link} is {1e3 * gap:.2f} mm off the axis of {joint}"


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
