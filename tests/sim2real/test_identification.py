"""Identification: logs, excitation, and parameters found again that a simulated finger was given."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.sim2real.identification.excitation import Excitation, excitation_commands
from fungrasp.sim2real.identification.finger_chains import place_in_finger
from fungrasp.sim2real.identification.fingertip_weights import hang_weights
from fungrasp.sim2real.identification.fit import FitSettings, fit_dynamics
from fungrasp.sim2real.identification.log_simulation import DriveErrors, play_operator, simulate_log
from fungrasp.sim2real.identification.motion_log import (
    MotionLog,
    load_motion_log,
    read_step_csv,
    save_motion_log,
)
from fungrasp.sim2real.joint_dynamics import (
    JointDynamics,
    identified_hand,
    load_dynamics,
    model_dynamics,
    save_dynamics,
    set_dynamics,
)

JOINTS = ("ffj1", "ffj2")
TRUTH = JointDynamics(
    JOINTS,
    np.array([4.0, 4.0]),
    np.array([0.3, 0.25]),
    np.array([0.02, 0.015]),
    np.array([0.003, 0.0012]),
    0.03,
)


@pytest.fixture(scope="module")
def log() -> MotionLog:
    hand = load_hand("allegro")
    rest = np.full(2, 0.7)
    lower, upper = np.full(2, 0.0), np.full(2, 1.5)
    excitation = Excitation(seconds=2.5)
    commands = excitation_commands(excitation, rest, lower, upper)
    times = np.arange(len(commands)) / excitation.rate
    empty = MotionLog(JOINTS, times, commands, np.tile(rest, (len(times), 1)), np.array([0, 0, -9.81]))
    positions = simulate_log(hand, empty, [TRUTH])[0]
    count = np.deg2rad(0.088)
    return MotionLog(JOINTS, times, commands, np.rint(positions / count) * count, empty.gravity)


def test_parameters_are_found_again(log: MotionLog):
    hand = load_hand("allegro")
    found = fit_dynamics(hand, log, FitSettings(fixed=("stiffness",)))
    assert found.dynamics.delay == pytest.approx(TRUTH.delay, abs=5e-4)
    assert np.allclose(found.dynamics.damping, TRUTH.damping, rtol=0.05)
    assert np.allclose(found.dynamics.friction, TRUTH.friction, rtol=0.2)
    assert np.allclose(found.dynamics.armature, TRUTH.armature, rtol=0.2)
    assert found.rms < 0.003
    assert set(found.relative_error) == {"damping", "friction", "armature", "delay"}


def test_a_command_takes_effect_after_the_delay(log: MotionLog):
    hand = load_hand("allegro")
    late = JointDynamics(JOINTS, TRUTH.stiffness, TRUTH.damping, TRUTH.friction, TRUTH.armature, 0.06)
    step = MotionLog(
        JOINTS,
        np.arange(100) * 0.01,
        np.full((100, 2), 1.0),
        np.tile([0.5, 0.5], (100, 1)),
        np.zeros(3),
    )
    early, later = simulate_log(hand, step, [TRUTH, late])
    assert np.abs(early[:3] - 0.5).max() < 1e-9 and np.abs(later[:6] - 0.5).max() < 1e-9
    assert np.allclose(early[10:90], later[13:93], atol=1e-6)


def test_excitation_stays_within_limits_and_begins_at_rest():
    lower, upper = np.array([-0.2, 0.3]), np.array([1.0, 1.4])
    rest = np.array([0.0, 1.35])
    commands = excitation_commands(Excitation(seconds=4.0), rest, lower, upper)
    assert (commands >= lower).all() and (commands <= upper).all()
    assert (commands[:20] == rest).all() and (commands[-1] == rest).all()
    assert (np.ptp(commands, axis=0) > 0.2 * (upper - lower)).all()
    assert np.array_equal(commands, excitation_commands(Excitation(seconds=4.0), rest, lower, upper))


def test_bad_logs_are_refused(log: MotionLog, tmp_path):
    hand = load_hand("allegro")
    still = MotionLog(JOINTS, log.times, log.commands, np.zeros_like(log.positions), log.gravity)
    with pytest.raises(FungraspError, match="moves less than"):
        fit_dynamics(hand, still)
    with pytest.raises(FungraspError, match="s at least"):
        fit_dynamics(hand, log.part(0.0, 0.1))
    with pytest.raises(FungraspError, match="no driven joint"):
        fit_dynamics(load_hand("inspire"), log)
    with pytest.raises(FungraspError, match="do not increase"):
        MotionLog(JOINTS, log.times[::-1], log.commands, log.positions, log.gravity)
    with pytest.raises(FungraspError, match="mass on each fingertip"):
        replace(log, weight=-0.1)
    np.savez(tmp_path / "log.npz", times=log.times)
    with pytest.raises(FungraspError, match="missing"):
        load_motion_log(tmp_path / "log.npz")
    (tmp_path / "steps.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FungraspError, match="step response"):
        read_step_csv(tmp_path / "steps.csv", "x", 0.0, 1.0)


def test_files_keep_what_they_hold(log: MotionLog, tmp_path):
    save_motion_log(tmp_path / "log.npz", replace(log, weight=0.2))
    again = load_motion_log(tmp_path / "log.npz")
    assert again.joints == log.joints and np.array_equal(again.positions, log.positions)
    assert again.weight == again.part(0.0, 0.5).weight == 0.2
    hand = load_hand("allegro")
    save_dynamics(tmp_path / "hand.toml", TRUTH)
    read = load_dynamics(tmp_path / "hand.toml", hand)
    assert read.delay == TRUTH.delay
    assert read.damping[read.joints.index("ffj2")] == TRUTH.damping[1]
    # Joints that were not identified keep the model's values.
    assert read.damping[read.joints.index("mfj1")] == model_dynamics(hand).damping[5]


@pytest.mark.parametrize(
    "text, match",
    [
        ("speed = 1", "unknown field 'speed'"),
        ("[joints.nose]\ndamping = 1", "no joint 'nose'"),
        ("[joints.ffj1]\nmass = 1", "not mass"),
        ("[joints.ffj1]\ndamping = -1", "not negative"),
        ("delay = 'long'", "a number of seconds"),
        ("delay = 5", "0 to 1 s"),
    ],
)
def test_bad_dynamics_are_refused(text: str, match: str, tmp_path):
    (tmp_path / "hand.toml").write_text(text)
    with pytest.raises(FungraspError, match=match):
        load_dynamics(tmp_path / "hand.toml", load_hand("allegro"))


def test_a_model_takes_dynamics():
    hand = load_hand("allegro")
    model = hand.spec().compile()
    set_dynamics(model, TRUTH)
    dof = model.joint("ffj1").dofadr[0]
    assert model.dof_damping[dof] == TRUTH.damping[0] and model.dof_armature[dof] == TRUTH.armature[0]
    assert model.actuator("ffj1").biasprm[1] == -TRUTH.stiffness[0]


def test_a_hand_takes_what_was_identified(tmp_path):
    hand = load_hand("allegro")
    model = model_dynamics(hand)
    found = JointDynamics(
        model.joints,
        0.5 * model.stiffness,
        0.8 * model.damping,
        model.friction + 0.02,
        2 * model.armature,
        0.03,
    )
    save_dynamics(tmp_path / "found.toml", found)
    identified = identified_hand(hand, tmp_path / "found.toml")
    now = model_dynamics(identified)
    for name in ("stiffness", "damping", "friction", "armature"):
        assert np.allclose(getattr(now, name), getattr(found, name), rtol=1e-4), name
    # The model that all hands share is as it was.
    assert np.array_equal(model_dynamics(load_hand("allegro")).stiffness, model.stiffness)


def test_lost_motion_keeps_what_moves_behind_the_command():
    commands = np.array([0.0, 0.1, 0.3, 0.25, 0.1])[:, None]
    moved = play_operator(commands, np.array([[0.0], [0.1]]))
    assert np.array_equal(moved[0], commands)
    assert np.allclose(moved[1, :, 0], [0.0, 0.0, 0.2, 0.2, 0.2])


def test_a_multi_sine_stays_within_limits_and_moves_fingers_alike():
    hand = load_hand("allegro")
    names = tuple(hand.actuators)
    limits = np.array([hand.joint_limits[hand.joint_names.index(name)] for name in names])
    rest, alike = limits.mean(axis=1), place_in_finger(hand, names)
    e = Excitation(kind="multi-sine", seconds=6.0, rate=100.0, reach=0.12)
    commands = excitation_commands(e, rest, *limits.T, alike)
    assert (commands >= limits[:, 0]).all() and (commands <= limits[:, 1]).all()
    assert np.allclose(commands[:40], rest) and np.allclose(commands[-1], rest)
    # The same joint of the index and of the middle finger, as shares of their ranges.
    share = (commands - rest) / (limits[:, 1] - limits[:, 0])
    assert np.allclose(share[:, 0], share[:, 4]) and np.ptp(share[:, 1]) > 0.15


@pytest.mark.slow
def test_logs_of_two_sides_of_gravity_tell_the_scale_of_a_joint():
    # Without weight, stiffness and all else of a joint may be scaled together; with it they may not.
    hand = load_hand("allegro")
    model = model_dynamics(hand)
    rows = [model.joints.index(joint) for joint in JOINTS]
    values = {name: getattr(model, name)[rows] for name in ("damping", "friction", "armature")}
    true = JointDynamics(JOINTS, 0.6 * model.stiffness[rows], **values, delay=0.02)
    rest, e = np.full(2, 0.7), Excitation(kind="multi-sine", seconds=3.0, reach=0.1, small_step=0.0)
    commands = excitation_commands(e, rest, np.zeros(2), np.full(2, 1.5))
    times = np.arange(len(commands)) / e.rate
    error = DriveErrors(np.array([0.008, -0.006]), np.zeros(2))
    logs = []
    for down in (-9.81, 9.81):
        log = MotionLog(JOINTS, times, commands, np.tile(rest, (len(times), 1)), np.array([0, down, 0.0]))
        log = MotionLog(
            JOINTS, times, commands, simulate_log(hand, log, [true], errors=[error])[0], log.gravity
        )
        logs.append(log)
    found = fit_dynamics(hand, logs, FitSettings(errors=("offset",), iterations=25))
    assert np.allclose(found.dynamics.stiffness, true.stiffness, rtol=0.05)
    assert np.allclose(found.errors.offset, error.offset, atol=5e-4)


def test_weights_on_fingertips_weigh_and_resist_as_points_do():
    hand, mass = load_hand("allegro"), 0.15
    bare, loaded = copy.copy(hand.model), copy.copy(hand.model)
    hang_weights(loaded, hand, mass)
    joints = hand.all_joints(np.full(16, 0.4))
    tips = [hand.model.site(finger.tip).id for finger in hand.fingers.values()]
    states = []
    for model in (bare, loaded):
        data = mujoco.MjData(model)
        data.qpos[:] = joints
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        states.append((data, inertia, data.qfrc_bias.copy()))
    weight, inertia = np.zeros(bare.nv), np.zeros((bare.nv, bare.nv))
    for site in tips:
        jacobian = np.zeros((3, bare.nv))
        mujoco.mj_jacSite(bare, states[0][0], jacobian, None, site)
        weight -= jacobian.T @ (mass * bare.opt.gravity)
        inertia += mass * jacobian.T @ jacobian
    np.testing.assert_allclose(states[1][2] - states[0][2], weight, atol=1e-9)
    np.testing.assert_allclose(states[1][1] - states[0][1], inertia, atol=1e-9)
    assert np.abs(inertia).max() > 1e-4


@pytest.mark.slow
def test_a_weight_tells_the_scale_of_a_geared_joint():
    # Of an Inspire's finger weight and inertia are next to nothing beside its drive's.
    hand, joints = load_hand("inspire"), ("index_proximal_joint",)
    model = model_dynamics(hand)
    row = [model.joints.index(joints[0])]
    scale = 0.6
    true = JointDynamics(
        joints,
        scale * model.stiffness[row],
        scale * model.damping[row],
        np.array([0.01]),
        scale * model.armature[row],
        0.02,
    )
    rest, e = np.full(1, 0.7), Excitation(kind="multi-sine", seconds=3.0, reach=0.1, small_step=0.01)
    commands = excitation_commands(e, rest, np.zeros(1), np.full(1, 1.4))
    times = np.arange(len(commands)) / e.rate
    logs = []
    for weight in (0.0, 0.2):
        at_rest = np.tile(rest, (len(times), 1))
        log = MotionLog(joints, times, commands, at_rest, np.array([0, -9.81, 0.0]), weight)
        moved = simulate_log(hand, log, [true])[0] + np.random.default_rng(0).normal(0, 4e-4, (len(times), 1))
        logs.append(replace(log, positions=moved))
    settings = FitSettings(prior=1.0, iterations=25)
    without, found = (fit_dynamics(hand, some, settings).dynamics for some in (logs[:1], logs))
    assert np.allclose(found.stiffness, true.stiffness, rtol=0.03)
    assert np.allclose(found.damping, true.damping, rtol=0.1)
    assert abs(without.stiffness[0] / true.stiffness[0] - 1) > 0.06


@pytest.mark.slow
def test_gains_far_from_the_model_are_found(log: MotionLog):
    hand = load_hand("allegro")
    soft = replace(TRUTH, stiffness=0.25 * TRUTH.stiffness, damping=0.25 * TRUTH.damping)
    positions = simulate_log(hand, log, [soft])[0]
    found = fit_dynamics(hand, replace(log, positions=positions), FitSettings(iterations=25))
    assert np.allclose(found.dynamics.stiffness, soft.stiffness, rtol=0.05)
