"""The safety filter: nothing that it lets through is beyond a limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import (
    DeviceStatus,
    JointLimits,
    JointState,
    RobotCommand,
    RobotState,
    SafetyStop,
    StopKind,
    TrackedPose,
    TrackingStatus,
)
from fungrasp.robots.kinematics.arm_model import Clearance
from fungrasp.robots.safety import TOLERANCE, SafetyGuard, check_pose

CELL = RobotCell("allegro")
ARM = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.full(6, 1.5), np.full(6, 100.0))
HAND = JointLimits(np.full(4, -0.5), np.full(4, 1.5), np.full(4, 6.0), np.full(4, 1.0))
FREE = Clearance(0.03, 0.03, 0.03)
PERIOD = 0.02

numbers = st.floats(-10, 10) | st.sampled_from([np.nan, np.inf, -np.inf, 1e300])
arms = arrays.arrays(float, 6, elements=numbers)
hands = arrays.arrays(float, 4, elements=numbers)
palms = arrays.arrays(float, 7, elements=st.floats(-1, 1) | st.sampled_from([np.nan, np.inf]))
near = arrays.arrays(float, 6, elements=st.floats(-0.05, 0.05))
gaps = st.builds(Clearance, *[st.floats(-0.05, 0.03)] * 3)


def joints(count: int, **changes) -> JointState:
    zeros = np.zeros(count)
    return replace(JointState(zeros, zeros, zeros, 1.0, 1.0, DeviceStatus.READY), **changes)


def state(**changes) -> RobotState:
    return replace(RobotState(1.0, joints(6), joints(4), None), **changes)


def command(arm=None, hand=None, palm=None) -> RobotCommand:
    return RobotCommand(
        np.zeros(6) if arm is None else arm,
        np.zeros(4) if hand is None else hand,
        np.zeros(4),
        np.array([0.0, 0.0, 0.3, 1.0, 0, 0, 0]) if palm is None else palm,
    )


def sent_after(
    asked: RobotCommand,
    *before: RobotCommand,
    at: RobotState | None = None,
    gap: Clearance = FREE,
    silent: str = "",
    silence: float = 0.0,
    cell: RobotCell = CELL,
) -> RobotCommand:
    """What the guard lets through of a setpoint after others, the devices at rest where these are.

    Args:
        silent: "arm" or "hand", whose time stamp has stood still for ``silence`` [s].
    """
    gaps = [FREE] * len(before) + [gap]
    guard = SafetyGuard(cell, {"arm": ARM, "hand": HAND}, lambda arm, fingers: gaps.pop(0), PERIOD)

    def stamped(seen: RobotState, now: float, **stamps: float) -> RobotState:
        parts = {part: getattr(seen, part) for part in ("arm", "hand")}
        given = {"arm": now, "hand": now, **stamps}
        return replace(
            seen,
            time=now,
            **{part: replace(q, device_time=q.device_time + given[part]) for part, q in parts.items()},
        )

    now = 1.0
    for one in before:
        here = state(arm=joints(6, positions=one.arm), hand=joints(4))
        guard(stamped(here, now), one)
        now += silence or PERIOD
    stamps = {silent: now - silence} if silent else {}
    return guard(stamped(at or state(), now, **stamps), asked)


@settings(max_examples=300, deadline=None)
@given(arms | near, hands, palms, near, gaps, st.booleans())
def test_what_is_let_through_is_within_every_limit(arm, hand, palm, previous, gap, first) -> None:
    asked = command(arm, hand, palm)
    last = None if first else command(previous)
    try:
        sent = sent_after(asked, *[] if last is None else [last, last], gap=gap)
    except SafetyStop as stop:
        assert stop.reason
        return
    assert np.isfinite(sent.arm).all() and np.isfinite(sent.hand).all()
    assert (sent.palm[:3] >= CELL.workspace.lower).all() and (sent.palm[:3] <= CELL.workspace.upper).all()
    assert gap.table >= CELL.workspace.table_clearance and gap.itself >= 0
    assert gap.hand >= -CELL.workspace.hand_depth
    assert np.abs(sent.arm - state().arm.positions).max() <= CELL.limits.setpoint_lead + 0.1
    if last is None:
        assert (sent.arm >= ARM.lower).all() and (sent.arm <= ARM.upper).all()
        assert (sent.hand >= HAND.lower).all() and (sent.hand <= HAND.upper).all()
    else:
        assert np.abs(sent.arm - last.arm).max() <= ARM.velocity[0] * PERIOD * TOLERANCE + 1e-12
        assert np.abs(sent.hand - last.hand).max() <= HAND.velocity[0] * PERIOD * TOLERANCE + 1e-12
        step = np.linalg.norm(sent.palm[:3] - last.palm[:3])
        assert step <= CELL.limits.palm_speed * PERIOD * TOLERANCE + 1e-12


def stopped(asked: RobotCommand, *before: RobotCommand, **rest) -> SafetyStop | None:
    try:
        sent_after(asked, *before, **rest)
    except SafetyStop as stop:
        return stop
    return None


BESIDE, AHEAD = (np.array([0.0, y, 0.3, 1, 0, 0, 0]) for y in (0.6, 0.006))
CASES = {
    "finite": {"asked": command(arm=np.array([np.nan, 0, 0, 0, 0, 0]))},
    "arm does not follow": {"at": state(arm=joints(6, status=DeviceStatus.PROTECTIVE_STOP))},
    "hand does not follow": {"at": state(hand=joints(4, status=DeviceStatus.FAULT))},
    "arm has been silent": {"silent": "arm", "silence": 0.041},
    "hand has been silent": {"silent": "hand", "silence": 0.11},
    "torque of a hand": {"at": state(hand=joints(4, torques=np.full(4, -3.1)))},
    "far from where": {"at": state(arm=joints(6, positions=np.full(6, 0.36)))},
    "workspace": {"asked": command(palm=BESIDE), "before": ()},
    "arm would touch the table": {"gap": Clearance(0.004, 0.03, 0.03)},
    "press into the table": {"gap": Clearance(0.03, -0.013, 0.03)},
    "touch the arm": {"gap": Clearance(0.03, 0.03, -0.001)},
    "palm would move": {"asked": command(palm=AHEAD)},
    "accelerate": {
        "asked": command(arm=np.full(6, 0.13)),
        "before": (command(arm=np.full(6, 0.13)), command(arm=np.full(6, 0.16))),
        "cell": replace(CELL, limits=replace(CELL.limits, setpoint_acceleration=100.0)),
    },
}


@pytest.mark.parametrize("name", CASES)
def test_each_check_has_its_reaction(name: str) -> None:
    changes = dict(CASES[name])
    asked, before = changes.pop("asked", command()), changes.pop("before", (command(), command()))
    assert stopped(command(), command(), command()) is None
    stop = stopped(asked, *before, **changes)
    assert stop is not None and stop.kind is (StopKind.OPEN if "torque" in name else StopKind.HOLD)
    assert name.split()[-1] in stop.reason and name.split()[0] in stop.reason


def test_goals_beyond_limits_are_clipped() -> None:
    asked = command(arm=np.full(6, 0.1), hand=np.full(4, 2.0))
    sent = sent_after(asked, command(), command())
    np.testing.assert_allclose(sent.arm, 1.5 * PERIOD * TOLERANCE)
    np.testing.assert_allclose(sent.hand, 6.0 * PERIOD * TOLERANCE)
    inside = command(arm=np.full(6, 0.01))
    np.testing.assert_array_equal(sent_after(inside, command(), command()).arm, inside.arm)


def test_what_is_checked_is_what_is_sent() -> None:
    """A joint that is clipped has its palm and its clearance elsewhere than what was asked for."""
    seen: list[np.ndarray] = []

    def clearance(arm: np.ndarray, fingers: np.ndarray) -> Clearance:
        seen.append(arm)
        return FREE

    def palm(arm: np.ndarray) -> np.ndarray:
        return np.array([0.1 * arm[0], 0.0, 0.3, 1, 0, 0, 0])

    guard = SafetyGuard(CELL, {"arm": ARM, "hand": HAND}, clearance, PERIOD, palm=palm)
    guard(state(time=1.0), command())
    wanted = np.full(6, 0.1)
    sent = guard(state(time=1.02), command(arm=wanted, palm=palm(wanted)))
    assert sent.arm[0] == pytest.approx(1.5 * PERIOD * TOLERANCE) and seen[-1][0] == sent.arm[0]
    np.testing.assert_allclose(sent.palm, palm(sent.arm))


def test_setpoints_in_a_burst_are_refused() -> None:
    guard = SafetyGuard(CELL, {"arm": ARM, "hand": HAND}, lambda arm, fingers: FREE, PERIOD)

    def send(now: float) -> None:
        guard(state(time=now, arm=joints(6, device_time=now), hand=joints(4, device_time=now)), command())

    for now in (0.0, 0.0199, 0.04, 0.079, 0.08, 0.1):
        send(now)
    with pytest.raises(SafetyStop, match="in less than 20 ms"):
        for _ in range(3):
            send(0.3)


@pytest.mark.parametrize(
    ("pose", "age", "said"),
    [
        (None, 0.0, "not seen"),
        (np.array([0.0, 0, 0.1, 1, 0, 0, 0]), 0.6, "600 ms old"),
        (np.array([0.06, 0, 0.1, 1, 0, 0, 0]), 0.1, "jumped by 6.0 cm"),
        (np.array([np.nan, 0, 0.1, 1, 0, 0, 0]), 0.1, "not finite"),
        (np.array([0.03, 0, 0.1, 1, 0, 0, 0]), 0.1, "jumped by 3.0 cm"),
        (np.array([0.015, 0, 0.1, 1, 0, 0, 0]), 0.4, ""),
        (np.array([0.0, 0, 0.1, 1, 0, 0, 0]), -3.0, "3000 ms ahead"),
        (np.array([0.0, 0, 0.1, 0, 0, 0, 1]), 0.1, "turned by 180 degrees"),
    ],
)
def test_poses(pose, age, said) -> None:
    reference = np.array([0.0, 0, 0.1, 1, 0, 0, 0])
    tracked = None if pose is None else TrackedPose(pose, 2.0 - age, 1.0, TrackingStatus.TRACKING)
    found = check_pose(tracked, reference, 2.0, CELL)
    assert said in found and bool(said) == bool(found)


@pytest.mark.parametrize("device", ["arm", "hand"])
@pytest.mark.parametrize("what", ["positions", "torques", "device_time"])
def test_a_measured_value_that_is_no_number_stops_the_robot(device: str, what: str) -> None:
    count = 6 if device == "arm" else 4
    value = np.nan if what == "device_time" else np.full(count, np.nan)
    said = state(**{device: joints(count, **{what: value})})
    stop = stopped(command(), command(), at=said)
    assert stop is not None and stop.reason == f"a reading of the {device} is not finite"


@pytest.mark.parametrize("change", [{"score": np.nan}, {"score": 0.05}, {"captured": np.nan}])
def test_a_pose_with_a_low_score_or_without_one_or_a_time_is_not_used(change: dict[str, float]) -> None:
    pose = np.array([0.0, 0, 0, 1, 0, 0, 0])
    tracked = replace(TrackedPose(pose, 1.0, 1.0, TrackingStatus.TRACKING), **change)
    assert check_pose(tracked, pose, 1.0, CELL)
