"""Every hand folder is a sound physical model: shapes that don't touch, true masses, servos that hold."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
import pytest
from hand_references import REFERENCES, Reference, reference_numbers

from fungrasp.hands import Hand, hand_files, load_hand

HANDS = sorted(hand_files())
TIME_STEP = 0.005
REST: Mapping[str, Mapping[str, float]] = {
    # The little finger's metacarpal swings its finger into the ring finger, in the reference too.
    "shadow": {"rh_LFJ5": 0.0},
}
"""Joints that don't flex a finger, by hand, and their angle [rad] in the middle pose."""


def independent_limits(hand: Hand) -> np.ndarray:
    """[rad], shape [U, 2]."""
    return hand.joint_limits[[hand.joint_names.index(name) for name in hand.actuators]]


def zero_pose(hand: Hand) -> np.ndarray:
    """Independent joint angles nearest to zero [rad], shape [U]."""
    return np.clip(0.0, *independent_limits(hand).T)


def middle_pose(hand: Hand) -> np.ndarray:
    """Independent joints in the middle of their ranges [rad], shape [U]."""
    middle = independent_limits(hand).mean(axis=1)
    for joint, angle in REST.get(hand.name, {}).items():
        middle[list(hand.actuators).index(joint)] = angle
    return middle


def with_coupled(hand: Hand, independent: np.ndarray) -> np.ndarray:
    """All joint angles [rad], shape [M]."""
    matrix, offset = hand.coupling
    return matrix @ independent + offset


def finger_joints(hand: Hand, finger: str) -> list[int]:
    """Indices of the independent joints between the palm and a fingertip."""
    model = hand.model
    body, palm = model.body(hand.fingers[finger].links[-1]).id, model.body(hand.palm).id
    names = []
    while body not in (0, palm):
        names += [model.joint(i).name for i in range(model.njnt) if model.jnt_bodyid[i] == body]
        body = int(model.body_parentid[body])
    return [i for i, joint in enumerate(hand.actuators) if joint in names]


class Touching:
    """Which shapes of a hand touch, with its palm free in the air."""

    def __init__(self, hand: Hand):
        spec = hand.spec()
        spec.body(hand.palm).add_freejoint()
        self.hand, self.model = hand, spec.compile()
        self.data = mujoco.MjData(self.model)

    def at(self, independent: np.ndarray) -> set[tuple[str, str]]:
        self.data.qpos[7:] = with_coupled(self.hand, independent)
        mujoco.mj_fwdPosition(self.model, self.data)
        return {(self.model.geom(c.geom1).name, self.model.geom(c.geom2).name) for c in self.data.contact}


@pytest.mark.parametrize("name", HANDS)
def test_the_palm_is_the_root_and_shapes_and_masses_are_sound(name: str):
    hand = load_hand(name)
    assert hand.name == name
    model = hand.model
    assert model.body(hand.palm).parentid[0] == 0, "the palm must be the root body"
    np.testing.assert_array_equal(model.body(hand.palm).pos, 0.0)
    np.testing.assert_array_equal(model.body(hand.palm).quat, [1.0, 0.0, 0.0, 0.0])
    assert hand.palm_fingers @ hand.palm_normal == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", HANDS)
def test_mass_is_the_references(name: str):
    hand = load_hand(name)
    mass = hand.model.body_mass.sum()
    known = [
        m for m in (_hand_mass(name, reference) for reference in REFERENCES.get(name, ())) if m is not None
    ]
    if not known:
        pytest.skip(f"no reference gives the mass of '{name}'")
    for expected in known:
        assert mass == pytest.approx(expected, rel=0.05)


def test_shadow_link_masses_are_the_references():
    hand, masses = load_hand("shadow"), reference_numbers("shadow", REFERENCES["shadow"][0]).masses
    ours = {hand.model.body(i).name: hand.model.body_mass[i] for i in range(1, hand.model.nbody)}
    assert ours == pytest.approx(masses, abs=1e-9)


def _hand_mass(name: str, reference: Reference) -> float | None:
    if reference.mass is None and reference.true_masses:
        return sum(reference_numbers(name, reference).masses.values())
    return reference.mass


@pytest.mark.parametrize("name", HANDS)
def test_one_actuator_per_independent_joint(name: str):
    hand = load_hand(name)
    model = hand.model
    assert [model.actuator(i).name for i in range(model.nu)] == list(hand.actuators)
    assert model.nu == hand.coupling[0].shape[1] == model.njnt - model.neq
    joints = model.actuator_trnid[:, 0]
    assert [model.joint(int(j)).name for j in joints] == list(hand.actuators)
    np.testing.assert_array_equal(model.actuator_ctrlrange, model.jnt_range[joints])
    limits = [servo.force_limit for servo in hand.actuators.values()]
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], limits)


@pytest.mark.parametrize("name", HANDS)
def test_nothing_touches_when_open_or_half_closed(name: str):
    hand = load_hand(name)
    touching = Touching(hand)
    assert touching.at(zero_pose(hand)) == set()
    assert touching.at(middle_pose(hand)) == set()
    # Nor where the palm is a part of the world.
    data = mujoco.MjData(hand.model)
    data.qpos[:] = with_coupled(hand, middle_pose(hand))
    mujoco.mj_fwdPosition(hand.model, data)
    assert data.ncon == 0


@pytest.mark.parametrize("name", HANDS)
def test_a_finger_closes_without_touching(name: str):
    """One finger after the other closes to 0.6 of its range, the others open: beyond lies the fist."""
    hand = load_hand(name)
    touching, zero = Touching(hand), zero_pose(hand)
    closed = zero + 0.6 * (independent_limits(hand)[:, 1] - zero)
    for finger in hand.fingers:
        joints = finger_joints(hand, finger)
        for fraction in np.linspace(0.0, 1.0, 13):
            angles = zero.copy()
            angles[joints] += fraction * (closed - zero)[joints]
            assert touching.at(angles) == set(), f"{finger} at {fraction:.2f} of its way"


@pytest.mark.parametrize("name", HANDS)
def test_fingers_can_touch_each_other_and_the_thumb(name: str):
    hand = load_hand(name)
    touching = Touching(hand)
    limits = independent_limits(hand)
    owner = {body: finger.name for finger in hand.fingers.values() for body in finger.links}
    geom_owner = {
        touching.model.geom(i).name: owner.get(
            touching.model.body(int(touching.model.geom_bodyid[i])).name, ""
        )
        for i in range(touching.model.ngeom)
    }
    draws = np.random.default_rng(0).uniform(*limits.T, size=(300, len(limits)))
    pairs = {frozenset((geom_owner[a], geom_owner[b])) for angles in draws for a, b in touching.at(angles)}
    assert any("thumb" in pair and len(pair - {""}) == 2 for pair in pairs)


@pytest.mark.parametrize("gravity", [(0, 0, -9.81), (0, 9.81, 0), (9.81, 0, 0)])
@pytest.mark.parametrize("name", HANDS)
def test_servos_hold_the_middle_pose(name: str, gravity: tuple[float, float, float]):
    hand = load_hand(name)
    spec = hand.spec()
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = gravity
    model = spec.compile()
    data = mujoco.MjData(model)
    goal = with_coupled(hand, middle_pose(hand))
    data.qpos[:] = with_coupled(hand, zero_pose(hand))
    data.ctrl[:] = middle_pose(hand)
    fastest = 0.0
    for step in range(round(2.0 / TIME_STEP)):
        mujoco.mj_step(model, data)
        if step > round(1.5 / TIME_STEP):
            fastest = max(fastest, np.abs(data.qvel).max())
    independent = data.qpos[[hand.joint_names.index(joint) for joint in hand.actuators]]
    assert np.abs(data.qpos - goal).max() < 0.1
    assert np.abs(data.qpos - with_coupled(hand, independent)).max() < 0.02
    assert fastest < 0.05, "still moving"
