"""Identification: logs, excitation, and parameters found again that a simulated finger was given."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.sim2real.identification.excitation import (
    Excitation,
    ExcitationLimits,
    excitation_motion,
    safe_motion,
)
from fungrasp.sim2real.identification.fit import FitSettings, fit_dynamics
from fungrasp.sim2real.identification.log_simulation import (
    DriveErrors,
    chain_of,
    driver_setpoints,
    hang_weights,
    play_operator,
    prediction_rms,
    simulate_log,
)
from fungrasp.sim2real.identification.motion_log import (
    MotionHeader,
    MotionLog,
    MotionLogWriter,
    MotionSample,
    joint_samples,
    load_motion_log,
    motion_log,
    read_step_csv,
)
from fungrasp.sim2real.joint_dynamics import (
    JointDynamics,
    identified_hand,
    load_dynamics,
    model_dynamics,
    save_dynamics,
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


def one_finger(e: Excitation, rest: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Commands of joints of one finger, at any speed."""
    return excitation_motion(e, rest, ExcitationLimits(lower, upper), np.zeros(len(rest))).commands


@pytest.fixture(scope="module")
def log() -> MotionLog:
    hand = load_hand("allegro")
    rest = np.full(2, 0.7)
    lower, upper = np.full(2, 0.0), np.full(2, 1.5)
    excitation = Excitation(seconds=4.0)
    commands = one_finger(excitation, rest, lower, upper)
    times = np.arange(len(commands)) / excitation.rate
    empty = MotionLog(JOINTS, times, commands, np.tile(rest, (len(times), 1)), np.array([0, 0, -9.81]))
    positions = simulate_log(hand, empty, [TRUTH])[0]
    count = np.deg2rad(0.088)
    return MotionLog(JOINTS, times, commands, np.rint(positions / count) * count, empty.gravity)


def test_parameters_are_found_again(log: MotionLog):
    hand = load_hand("allegro")
    found = fit_dynamics(hand, log, FitSettings(fixed=("stiffness",), bound=np.inf, iterations=12))
    assert found.dynamics.delay == pytest.approx(TRUTH.delay, abs=2e-3)
    assert np.allclose(found.dynamics.damping, TRUTH.damping, rtol=0.05)
    assert np.allclose(found.dynamics.friction, TRUTH.friction, rtol=0.2)
    assert np.allclose(found.dynamics.armature, TRUTH.armature, rtol=0.4)
    assert found.rms < 0.003
    assert set(found.relative_error) == {"damping", "friction", "armature", "delay"}


def test_a_command_takes_effect_after_the_delay(log: MotionLog):
    hand = load_hand("allegro")
    rest, goals = np.full((100, 2), 0.5), np.full((100, 2), 1.0)
    step = MotionLog(JOINTS, np.arange(100) * 0.01, goals, rest, np.zeros(3))
    early, later = simulate_log(hand, step, [TRUTH, replace(TRUTH, delay=0.06)])
    assert np.abs(early[:3] - 0.5).max() < 1e-9 and np.abs(later[:6] - 0.5).max() < 1e-9
    assert np.allclose(early[10:90], later[13:93], atol=1e-6)


def test_excitation_is_slow_small_and_begins_and_ends_at_rest():
    lower, upper = np.array([-0.2, 0.3, 0.0]), np.array([1.0, 1.4, 2.0])
    rest, speed = np.array([0.0, 1.35, 1.0]), np.array([4.0, 4.0, 1.0])
    e = Excitation()
    room = ExcitationLimits(lower, upper, speed)
    motion = excitation_motion(e, rest, room, np.array([0, 0, 1]))
    commands = motion.commands
    assert (commands >= lower).all() and (commands <= upper).all()
    assert (commands[[0, -1]] == rest).all()
    # No jump anywhere: a command is no farther from the last than half the driver's speed allows.
    assert (np.abs(np.diff(commands, axis=0)) <= 0.5 * speed / e.rate + 1e-9).all()
    assert (np.ptp(commands, axis=0) > [0.25, 0.2, 0.05]).all()
    # One finger after the other, the other one holds.
    half = len(commands) // 2
    assert motion.moving[:half].tolist() == [[True, True, False]] * half
    assert (commands[:half, 2] == rest[2]).all() and (commands[half:, :2] == rest[:2]).all()
    again = excitation_motion(e, rest, room, np.array([0, 0, 1]))
    assert np.array_equal(commands, again.commands)


def test_the_sines_of_a_finger_share_no_line_and_have_low_peaks():
    e = Excitation(seconds=13.0)
    commands = one_finger(e, np.full(2, 1.0), np.zeros(2), np.full(2, 2.0))
    # Two periods at full swing.
    waves = commands[150:1150] - commands[150:1150].mean(axis=0)
    power = np.abs(np.fft.rfft(waves, axis=0)) ** 2
    lines = power > 1e-4 * power.max(axis=0)
    frequencies = [np.flatnonzero(column) / 10.0 for column in lines.T]
    assert not (lines[:, 0] & lines[:, 1]).any()
    assert min(f.min() for f in frequencies) == 0.2 and max(f.max() for f in frequencies) > 7.0
    assert all(f.max() / f.min() > 8 for f in frequencies)
    # In phase they would reach three times and more.
    assert (np.abs(waves).max(axis=0) < 2.2 * waves.std(axis=0)).all()


def test_bad_excitations_are_refused():
    for bad in ({"seconds": 2.0}, {"reach": 0.0}, {"speed": 1.5}, {"fastest": 40.0}, {"slowest": 0.0}):
        with pytest.raises(FungraspError, match="excitation"):
            Excitation(**bad)


def test_a_hand_does_not_touch_itself_and_needs_no_more_torque_than_it_may():
    hand = load_hand("allegro")
    limits = np.array([hand.joint_limits[hand.joint_names.index(name)] for name in hand.actuators])
    # Fingers side by side, spread so that the next one is near.
    rest = np.clip(np.full(16, 0.3), *limits.T)
    rest[[0, 4, 8]] = [-0.1, 0.1, 0.1]
    wide = Excitation(seconds=4.0, reach=0.5, speed=1.0, torque=1.0)
    room = ExcitationLimits(*limits.T, np.full(16, 20.0))
    motion = safe_motion(wide, hand, rest, room, np.zeros(3))
    plain = excitation_motion(wide, rest, room, chain_of(hand, list(hand.actuators)))
    data = mujoco.MjData(hand.model)

    def touches(commands: np.ndarray) -> bool:
        for posture in hand.all_joints(commands[::2]):
            data.qpos[:] = posture
            mujoco.mj_fwdPosition(hand.model, data)
            if any(contact.dist < 0 for contact in data.contact):
                return True
        return False

    assert touches(plain.commands) and not touches(motion.commands)
    weak = room._replace(torque=np.full(16, 0.2))
    gentle = safe_motion(wide, hand, rest, weak, np.zeros(3))
    assert np.ptp(gentle.commands, axis=0).max() < 0.7 * np.ptp(motion.commands, axis=0).max()


def test_fingers_one_after_the_other_are_fitted_side_by_side(log: MotionLog):
    hand, rows = load_hand("allegro"), len(log.times)
    two = ("ffj1", "ffj2", "mfj1", "mfj2")
    rest = np.full((rows, 2), 0.7)
    commands = np.block([[log.commands, rest], [rest, log.commands]])
    positions = np.block([[log.positions, rest], [rest, log.positions]])
    moving = np.kron(np.eye(2, dtype=bool), np.ones((rows, 2), dtype=bool))
    times = np.arange(2 * rows) / 100.0
    both = MotionLog(two, times, commands, positions, log.gravity, moving=moving)
    samples = joint_samples(both)
    assert samples.positions.shape == (rows, 4)
    doubled = JointDynamics(two, *(np.tile(v, 2) for v in list(vars(TRUTH).values())[1:5]), TRUTH.delay)
    simulated = simulate_log(hand, both, [doubled])[0]
    assert np.abs(simulated[:, :2] - log.positions).max() < 1e-3
    assert np.abs(simulated[:, 2:] - simulated[:, :2]).max() < 5e-3
    half = both.part(0.0, 0.5)
    assert half.moving.all(axis=0).tolist() == [False] * 4 and half.moving.any(axis=0).all()


def test_samples_are_compared_when_the_device_measured_them(log: MotionLog):
    # A hand that is polled every 20 ms by a clock of its own, and commanded and looked at every 10 ms.
    hand, clock, poll = load_hand("allegro"), 4711.0, 0.02
    rest = np.full(2, 0.7)
    commands = one_finger(Excitation(seconds=6.0), rest, np.zeros(2), np.full(2, 1.5))
    times = np.arange(len(commands)) * 0.01
    stamps = 0.0031 + poll * np.arange(len(commands) // 2 + 1)
    # Commands are taken at the next poll.
    taken = commands[np.searchsorted(times, stamps, side="right") - 1]
    polled = MotionLog(JOINTS, stamps, taken, np.tile(rest, (len(stamps), 1)), np.zeros(3))
    measured = simulate_log(hand, polled, [TRUTH])[0]
    last = np.maximum(np.searchsorted(stamps, times, side="right") - 1, 0)
    samples = [
        MotionSample(t, clock + stamps[i], stamps[i], (0, 1), c, measured[i])
        for t, i, c in zip(times, last, commands, strict=True)
    ]
    log = motion_log(MotionHeader(JOINTS, np.zeros(3), 0.0, np.full(2, np.inf)), samples)
    assert np.abs(log.measured - stamps[last]).max() < 1e-9
    none = DriveErrors(np.zeros(2), np.zeros(2))
    as_commanded = replace(log, measured=times)
    assert prediction_rms(hand, [log], TRUTH, none, 0.0) < 6e-4
    assert prediction_rms(hand, [as_commanded], TRUTH, none, 0.0) > 3e-3


def test_setpoints_run_no_faster_than_the_driver_lets_them():
    hand = load_hand("allegro")
    commands = np.where(np.arange(100)[:, None] % 40 < 20, 0.7, 1.3) * np.ones(2)
    times = np.arange(100) * 0.02
    at_rest = np.tile(commands[0], (100, 1))
    limited = MotionLog(JOINTS, times, commands, at_rest, np.zeros(3), speed=np.full(2, 4.0))
    setpoints = driver_setpoints(joint_samples(limited), np.arange(0.0, 2.0, 0.002))
    assert np.abs(np.diff(setpoints, axis=0)).max() <= 4.0 * 0.002 + 1e-12
    assert setpoints[:200].min() == 0.7 and setpoints.max() == pytest.approx(1.3)
    # What a driver with such a limit makes of steps is no slower servo's.
    measured = simulate_log(hand, limited, [TRUTH])[0]
    logs = replace(limited, positions=measured), replace(limited, positions=measured, speed=np.zeros(0))
    none = DriveErrors(np.zeros(2), np.zeros(2))
    known, unknown = (prediction_rms(hand, [one], TRUTH, none, 0.0) for one in logs)
    assert known < 1e-6 and unknown > 0.02


def test_what_a_log_does_not_tell_keeps_the_models_value(tmp_path):
    # Of an Inspire's finger weight and inertia are next to nothing beside its drive's: ratios are seen only.
    hand, joints = load_hand("inspire"), ("index_proximal_joint",)
    model = model_dynamics(hand)
    row = [model.joints.index(joints[0])]
    values = {name: 0.7 * getattr(model, name)[row] for name in ("stiffness", "damping", "armature")}
    true = JointDynamics(joints, **values, friction=np.array([0.05]), delay=0.02)
    e = Excitation(seconds=4.0, reach=0.06, rate=50.0)
    commands = one_finger(e, np.full(1, 0.7), np.zeros(1), np.full(1, 1.4))
    times, rest = np.arange(len(commands)) / e.rate, np.full((len(commands), 1), 0.7)
    empty = MotionLog(joints, times, commands, rest, np.zeros(3))
    noise = np.random.default_rng(0).normal(0, 4e-4, rest.shape)
    log = replace(empty, positions=simulate_log(hand, empty, [true])[0] + noise)
    found = fit_dynamics(hand, log, FitSettings(iterations=10))
    assert not found.identified["stiffness"][0] and found.relative_error["stiffness"][0] > 0.5
    assert found.dynamics.stiffness[0] == model.stiffness[row[0]]
    assert found.identified["damping"][0]
    ratio = found.dynamics.damping / found.dynamics.stiffness
    assert ratio == pytest.approx(true.damping / true.stiffness, rel=0.1)


def test_bad_logs_are_refused(log: MotionLog, tmp_path):
    hand = load_hand("allegro")
    still = MotionLog(JOINTS, log.times, log.commands, np.zeros_like(log.positions), log.gravity)
    with pytest.raises(FungraspError, match="moves less than"):
        fit_dynamics(hand, still)
    with pytest.raises(FungraspError, match=r"excited for|moves less"):
        fit_dynamics(hand, log.part(0.0, 0.1))
    with pytest.raises(FungraspError, match="no driven joint"):
        fit_dynamics(load_hand("inspire"), log)
    with pytest.raises(FungraspError, match="do not increase"):
        MotionLog(JOINTS, log.times[::-1], log.commands, log.positions, log.gravity)
    with pytest.raises(FungraspError, match="mass on each fingertip"):
        replace(log, weight=-0.1)
    for text in ("", "{}", '{"kind": "other"}', '{"kind": "fungrasp motion log", "joints": 3}', "\x00"):
        (tmp_path / "log.jsonl").write_text(text)
        with pytest.raises(FungraspError, match="not a motion log"):
            load_motion_log(tmp_path / "log.jsonl")
    (tmp_path / "steps.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FungraspError, match="step response"):
        read_step_csv(tmp_path / "steps.csv", "x", 0.0, 1.0)


def written(path: Path, log: MotionLog, weight: float = 0.0) -> None:
    """A log in a file, as it is recorded."""
    header = MotionHeader(log.joints, log.gravity, weight, np.full(2, 4.0))
    with MotionLogWriter(path) as writer:
        for t, c, q in zip(log.times, log.commands, log.positions, strict=True):
            writer.add(header, MotionSample(t, t + 100.0, t, (0, 1), c, q))


def test_a_log_that_was_broken_off_can_be_read_and_fitted(log: MotionLog, tmp_path):
    path = tmp_path / "log.jsonl"
    written(path, log)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    left = load_motion_log(path)
    assert 0.6 * len(log.times) < len(left.times) < 0.8 * len(log.times)
    assert np.allclose(left.positions, log.positions[: len(left.times)], atol=1e-6)
    left.check_excitation()
    with pytest.raises(FungraspError, match="already exists"):
        MotionLogWriter(path)


def test_the_command_fits_and_writes(log: MotionLog, tmp_path, capsys):
    written(tmp_path / "log.jsonl", log)
    arguments = [
        "identify",
        "fit",
        str(tmp_path / "log.jsonl"),
        "--out",
        str(tmp_path / "found.toml"),
        "--json",
    ]
    assert main([*arguments, "--fixed", "stiffness", "--iterations", "4"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not said["joints"]["ffj1"]["stiffness"]["identified"] and said["methods"][0]["simulations"] > 16
    assert load_dynamics(tmp_path / "found.toml", load_hand("allegro")).delay == pytest.approx(0.03, abs=0.02)
    assert main([*arguments, "--fixed", "stifness"]) == 2


def test_joints_whose_turn_did_not_come_are_left_out(log: MotionLog):
    rows = len(log.times)
    moving = np.tile([True, False], (rows, 1))
    half = replace(log, positions=log.positions * [1.0, 0.0], moving=moving)
    assert half.excited().joints == ("ffj1",)
    with pytest.raises(FungraspError, match="excited for"):
        half.check_excitation()


def test_files_keep_what_they_hold(log: MotionLog, tmp_path):
    written(tmp_path / "log.jsonl", log, 0.2)
    again = load_motion_log(tmp_path / "log.jsonl")
    assert again.joints == log.joints and np.allclose(again.positions, log.positions, atol=1e-7)
    assert again.weight == again.part(0.0, 0.5).weight == 0.2
    assert (again.speed == 4.0).all() and np.allclose(again.measured, log.times)
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


def test_a_hand_takes_what_was_identified(tmp_path):
    hand = load_hand("allegro")
    model = model_dynamics(hand)
    found = replace(
        model,
        stiffness=0.5 * model.stiffness,
        damping=0.8 * model.damping,
        friction=model.friction + 0.02,
        armature=2 * model.armature,
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
    moved = play_operator(commands, np.array([[0.0], [0.1]]), np.zeros((2, 1)))
    assert np.array_equal(moved[0], commands)
    assert np.allclose(moved[1, :, 0], [0.0, 0.0, 0.2, 0.2, 0.2])
    # A joint that rests off its command, as far as the slack allows, is not pulled there.
    moved = play_operator(np.zeros((2, 1)), np.array([[0.1]]), np.array([[0.08]]))
    assert np.allclose(moved, 0.08)


@pytest.mark.slow
def test_logs_of_two_sides_of_gravity_tell_the_scale_of_a_joint():
    # Without weight, stiffness and all else of a joint may be scaled together; with it they may not.
    hand = load_hand("allegro")
    model = model_dynamics(hand)
    rows = [model.joints.index(joint) for joint in JOINTS]
    values = {name: getattr(model, name)[rows] for name in ("damping", "friction", "armature")}
    true = JointDynamics(JOINTS, 0.6 * model.stiffness[rows], **values, delay=0.02)
    rest, e = np.full(2, 0.7), Excitation(seconds=5.0, rate=50.0)
    commands = one_finger(e, rest, np.zeros(2), np.full(2, 1.5))
    times = np.arange(len(commands)) / e.rate
    error = DriveErrors(np.array([0.008, -0.006]), np.zeros(2))
    logs = []
    for down in (-9.81, 9.81):
        log = MotionLog(JOINTS, times, commands, np.tile(rest, (len(times), 1)), np.array([0, down, 0.0]))
        logs.append(replace(log, positions=simulate_log(hand, log, [true], errors=[error])[0]))
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
    values = {name: 0.6 * getattr(model, name)[row] for name in ("stiffness", "damping", "armature")}
    true = JointDynamics(joints, **values, friction=np.array([0.01]), delay=0.02)
    rest, e = np.full(1, 0.7), Excitation(seconds=5.0, rate=50.0, reach=0.05)
    commands = one_finger(e, rest, np.zeros(1), np.full(1, 1.4))
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
