"""Every function of a control step on tensors: the same numbers as on NumPy arrays, and nothing that asks the
device for a number. Torch's *meta* device has shapes and no numbers: what asks it for one fails anywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from measured_states import measured_state, plan_target, privileged
from tensor_engine import TensorEngine, meta

from fungrasp.geometry.poses import interpolate_pose
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import ArrayKinematics, HandKinematics
from fungrasp.objects import builtin_object
from fungrasp.policies.plan_tracking import TrackingState, link_directions_of
from fungrasp.policies.residual_action import ResidualSettings, add_residual, smoothed
from fungrasp.sim2real import offset_pose
from fungrasp.simulation import MujocoCpuEngine, build_scene
from fungrasp.simulation.mujoco_engine import controls_of
from fungrasp.task import Action, LiftProtocol, LiftTask
from fungrasp.task.actuation import Actuation
from fungrasp.task.features import contact_features, value_features
from fungrasp.task.policy import Privileged
from fungrasp.task.setpoints import SetpointGenerator, WristSetpoint
from fungrasp.training.rewards import LiftReward

torch = pytest.importorskip("torch", reason="torch is not installed")

HAND, WORLDS = load_hand("inspire"), 5
SERVOS, LINKS, KEYPOINTS = len(HAND.actuators), len(HAND.links), len(HAND.keypoint_names)
RNG = np.random.default_rng(0)


def poses(*shape: int) -> np.ndarray:
    turn = RNG.normal(size=(*shape, 4))
    place = 0.1 * RNG.normal(size=(*shape, 3))
    return np.concatenate([place, turn / np.linalg.norm(turn, axis=-1, keepdims=True)], axis=-1)


def joints() -> np.ndarray:
    return RNG.uniform(0.0, 1.0, (WORLDS, SERVOS))


NOW, BEFORE = (measured_state(RNG, HAND, WORLDS) for _ in range(2))
TARGET, PRIVILEGED = plan_target(RNG, HAND, WORLDS), privileged(RNG, HAND, WORLDS)
ACTION, LAST = RNG.normal(size=(2, WORLDS, 6 + SERVOS))
PALM, GOAL, OFFSET = poses(WORLDS), poses(WORLDS), 0.01 * RNG.normal(size=(WORLDS, 6))
FINGERS, DELAY = joints(), np.array([0.0, 0.02, 0.05, 0.1, 0.0])
POINTS = 0.2 * RNG.normal(size=(WORLDS, KEYPOINTS, 3))
BANK = SignedDistanceBank([builtin_object(name).signed_distance for name in ("can", "mug")])
HELD = np.array([0, 1, 0, 1, 1])
POINTS_ON_BODIES = HandKinematics(HAND, 1).body_points(HAND.keypoint_names)
Convert = Callable[[np.ndarray], Any]


def tensor(values: np.ndarray) -> Any:
    return torch.as_tensor(np.array(values))


def converted(record: Any, c: Convert) -> Any:
    return replace(record, **{f.name: c(getattr(record, f.name)) for f in fields(record)})


def state_of(c: Convert) -> TrackingState:
    return TrackingState(converted(NOW, c), converted(BEFORE, c), converted(TARGET, c), c(ACTION))


def privileged_of(c: Convert) -> Privileged:
    return converted(PRIVILEGED, c)


def wrist(c: Convert, acceleration: float | None) -> Any:
    setpoint = WristSetpoint(c(PALM), LiftProtocol(wrist_rotation_acceleration=acceleration))
    setpoint.advance(c(GOAL), 0.02, 5)
    return setpoint.advance(c(GOAL), 0.02, 5)


def setpoints(c: Convert) -> Any:
    limits = np.tile([0.1, 0.7], (SERVOS, 1))
    made = SetpointGenerator(limits, WORLDS, LiftProtocol(), on=c(PALM))
    made.wrist.pose, made.delay = c(PALM), c(DELAY)
    made.advance(c(GOAL), c(FINGERS))
    sequence = made.advance(c(PALM), c(0.5 * FINGERS))
    return [getattr(sequence, field.name) for field in fields(sequence)] + made.state()


def servos(c: Convert) -> Any:
    made = SetpointGenerator(np.tile([0.1, 0.7], (SERVOS, 1)), WORLDS, LiftProtocol(), on=c(PALM))
    sequence = made.advance(c(GOAL), c(FINGERS))
    actuation = Actuation(WORLDS, SERVOS, on=c(PALM))
    actuation.wrist_lag, actuation.wrist_offset = c(0.05 + np.abs(OFFSET[:, 0])), c(OFFSET)
    actuation.encoder_bias, actuation.backlash = c(0.01 * FINGERS), c(0.02 * FINGERS)
    followed = actuation.follow(sequence, 0.02)
    return [followed.palm, followed.palm_velocity, followed.fingers, actuation.seen_palm(c(PALM))]


STEP: dict[str, Callable[[Convert], Any]] = {
    "controls": lambda c: controls_of(c(PALM), 0.06, c(GOAL), c(PALM[:, :3]), c(FINGERS)),
    "wrist": lambda c: wrist(c, None),
    "wrist that turns with a ramp": lambda c: wrist(c, 2.0),
    "setpoints": setpoints,
    "servos": servos,
    "robot features": lambda c: list(state_of(c).robot_features().values()),
    "contact features": lambda c: list(
        contact_features(privileged_of(c).contacts, privileged_of(c).forces, c(TARGET.contacts)).values()
    ),
    "value features": lambda c: list(value_features(privileged_of(c), c(PALM)).values()),
    "reward": lambda c: list(
        LiftReward(HAND, 0.1, 0.14, 0.3).terms(state_of(c), privileged_of(c), c(LAST)).values()
    ),
    "smoothed action": lambda c: smoothed(c(ACTION), c(LAST), ResidualSettings()),
    "residual action": lambda c: list(add_residual(c(PALM), c(FINGERS), c(ACTION), ResidualSettings())),
    "sensor errors": lambda c: offset_pose(c(PALM), c(OFFSET), c(PALM[:, :3])),
    "plan's origin": lambda c: interpolate_pose(c(PALM), c(GOAL), c(np.full((WORLDS, 1), 0.2))),
    "directions of links": lambda c: link_directions_of(HAND, c(NOW.keypoints)),
    "joints": lambda c: [HAND.all_joints(c(FINGERS)), HAND.independent(HAND.all_joints(c(FINGERS)))],
    "key points": lambda c: ArrayKinematics(HAND, POINTS_ON_BODIES).points(c(FINGERS)),
    "distances": lambda c: list(BANK.query(c(HELD), c(POINTS))),
}


def flat(result: Any) -> list[Any]:
    return list(result) if isinstance(result, list | tuple) else [result]


@pytest.mark.parametrize("name", STEP)
def test_a_function_of_the_step_gives_the_same_on_tensors_and_asks_no_device(name):
    expected, found, shapes = (flat(STEP[name](c)) for c in (np.array, tensor, meta))
    for a, b, c in zip(expected, found, shapes, strict=True):
        np.testing.assert_allclose(b.numpy(), a, atol=1e-6)
        assert tuple(c.shape) == a.shape and c.device.type == "meta", name


def test_key_points_are_those_of_mujoco():
    for name in ("allegro", "inspire", "shadow"):
        hand = load_hand(name)
        independent = np.random.default_rng(1).uniform(0.0, 0.5, (4, len(hand.actuators)))
        kinematics = HandKinematics(hand, 4)
        kinematics.update(None, independent)
        points = kinematics.body_points(hand.keypoint_names)
        found = ArrayKinematics(hand, points).points(independent)
        np.testing.assert_allclose(found, kinematics.points(points), atol=1e-9)


def test_points_far_away_and_none_have_distances_too():
    points = np.array([[[0.0, 0.0, 0.0], [3.0, -2.0, 1.0], [np.nan, 0.0, 0.0], [0.0, 0.0, -0.4]]])
    for a, b in zip(
        BANK.query(np.array([1]), points), BANK.query(tensor(np.array([1])), tensor(points)), strict=True
    ):
        np.testing.assert_allclose(b.numpy(), a, atol=1e-5)
    single = BANK.query(tensor(HELD), tensor(POINTS).float())[0]
    np.testing.assert_allclose(single.numpy(), BANK.query(HELD, POINTS)[0], atol=1e-5)


def test_a_control_step_of_the_lift_test_asks_no_device():
    """And gives on tensors what it gives on arrays, of an object and a hand that stay where they are."""
    scene = build_scene(HAND, {"can": builtin_object("can")})
    cpu = MujocoCpuEngine(scene, WORLDS, 1)
    cpu.set_state(object_pose=poses(WORLDS), wrist_frame=PALM)
    ends = []
    for convert in (np.array, tensor, meta):
        engine = TensorEngine(cpu, convert)
        task = LiftTask(engine)
        task.setpoints.wrist.pose = convert(PALM)
        for lift in (False, True, True):
            lifts = convert(np.full(WORLDS, lift))
            task.step(Action(convert(PALM), convert(FINGERS), lifts))
        ends.append([task.time, task.controls, task.lift_time, task.hold_time, task.lost, engine.link_forces])
    for a, b, c in zip(*ends, strict=True):
        np.testing.assert_allclose(b.numpy(), a, atol=1e-6)
        assert tuple(c.shape) == a.shape and c.device.type == "meta"
