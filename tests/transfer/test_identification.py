"""Identification: logs, excitation, and parameters found again that a simulated finger was given."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.transfer.identification.excitation import Excitation, excitation_commands
from fungrasp.transfer.identification.finger_chains import place_in_finger
from fungrasp.transfer.identification.fit import FitSettings, fit_dynamics
from fungrasp.transfer.identification.log_simulation import DriveErrors, play_operator, simulate_log
from fungrasp.transfer.identification.motion_log import (
    MotionLog,
    load_motion_log,
    read_step_csv,
    save_motion_log,
)
from fungrasp.transfer.joint_dynamics import (
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
    np.savez(tmp_path / "log.npz", times=log.times)
    with pytest.raises(FungraspError, match="missing"):
        load_motion_log(tmp_path / "log.npz")
    (tmp_path / "steps.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FungraspError, match="step response"):
        read_step_csv(tmp_path / "steps.csv", "x", 0.0, 1.0)


def test_files_keep_what_they_hold(log: MotionLog, tmp_path):
    save_motion_log(tmp_path / "log.npz", log)
    again = load_motion_log(tmp_path / "log.npz")
    assert again.joints == log.joints and np.array_equal(again.positions, log.positions)
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
