"""Use tests of W worlds whose lift test has just ended: the wrist plays the motion of each grasp's task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    invert,
)
from fungrasp.grasps.as_shown import AsShown
from fungrasp.hands import Hand
from fungrasp.task.environment import LiftEnvironment
from fungrasp.task.outcome import DIVERGED
from fungrasp.task.use.geometry import turning_frame
from fungrasp.task.use.motion import UseMotion
from fungrasp.task.use.outcome import UseOutcomes, displacement, functional_contact, moved_too_far
from fungrasp.task.use.worlds import UseWorlds

HOLD_GAIN = 0.3
"""Share of a joint's displacement by which its setpoint goes against it, at each setpoint: with 0.1 fewer
objects stay in the hand, and much more overshoots, as a joint follows its setpoints late."""


class FingerHold:
    """Setpoints of the fingers of W hands that hold something.

    A servo alone is a spring: a finger of 4 N m/rad yields by a centimeter to 3 N. Integral control of the
    joint angles moves the setpoints until the joints are where they were, as far as the torque limits allow.
    It needs the encoders alone, and no bias of theirs matters.
    """

    def __init__(self, hand: Hand, setpoints: np.ndarray, joints: np.ndarray):
        """
        Args:
            setpoints: of the independent joints in the hold [rad], shape [W, U].
            joints: where these are [rad], shape [W, U].
        """
        servos = hand.actuators.values()
        self._most = np.array([servo.force_limit / servo.kp for servo in servos])
        self._reference, self._setpoints = joints.copy(), setpoints.copy()

    def keep(self, joints: np.ndarray) -> np.ndarray:
        """The next setpoints [rad], shape [W, U]. joints: where they are [rad], shape [W, U]."""
        moved = self._setpoints + HOLD_GAIN * (self._reference - joints)
        # A setpoint beyond the torque limit would only make the joint come back late.
        self._setpoints = np.clip(moved, joints - self._most, joints + self._most)
        return self._setpoints


TABLE_AWAY = -0.2
"""Height of the table top during the motion [m]: a robot would move away from it."""

LOST = 0.1
"""An object that has moved by more in the palm is lost, or was let go, and its test is over [m]."""


def play_use(
    environment: LiftEnvironment,
    motions: Sequence[UseMotion | None],
    held: np.ndarray,
    watch: Callable[[np.ndarray], None] = lambda controls: None,
) -> UseOutcomes:
    """Let the wrist play the motions of W grasps' tasks after the hold, while the fingers hold on
    (``FingerHold``).

    Args:
        motions: of each world; None where the task has none.
        held: worlds that passed the lift test, shape [W] bool; the others are not tested.
        watch: called after each setpoint with what the servos were told, to record
            (``fungrasp.evaluation.UseRecorder``).
    """
    engine, task, hand = environment.engine, environment.task, environment.scene.hand
    shown = task.as_shown()
    contact, touched = functional_contact(environment)
    outcomes = UseOutcomes(
        motion=np.array(
            [m.name if m is not None and h else "" for m, h in zip(motions, held, strict=True)], dtype=str
        ),
        success=np.zeros(len(environment), dtype=bool),
        shift_m=np.full(len(environment), np.nan),
        turn_rad=np.full(len(environment), np.nan),
        trigger_force_n=np.full(len(environment), np.nan),
        functional_contact=np.where(held, contact, np.nan),
        reason=np.full(len(environment), "", dtype=object),
    )
    tested = [(w, m) for w, m in enumerate(motions) if m is not None and held[w]]
    if not tested:
        return _with_texts(outcomes)
    worlds, played = np.array([w for w, _ in tested]), [m for _, m in tested]
    uses = UseWorlds.begin(environment, worlds, played)
    frames, palm_before = engine.wrist_frame, engine.palm_pose
    for i, (w, motion) in enumerate(tested):
        if motion.turn:
            frames[w] = turning_frame(uses.axis[i], uses.palm[i])
    engine.set_parameters(worlds, table_height=np.full(len(worlds), TABLE_AWAY))
    engine.set_state(worlds, wrist_frame=frames[worlds], palm_pose=palm_before[worlds])

    palms, velocity = task.setpoints.wrist.pose.copy(), np.zeros((len(engine), 3))
    fingers = task.setpoints.fingers.copy()
    hold = FingerHold(hand, fingers, hand.independent(engine.joint_positions))
    limits = environment.scene.servo_limits.T
    opened = np.clip(0.0, *limits)
    period, substeps = task.setpoints.period, task.setpoints.substeps
    durations = np.array([motion.duration for motion in played])
    ends = np.array([motion.whole_duration for motion in played])
    shift, turn, moved = (np.zeros(len(worlds)) for _ in range(3))
    force, torque = np.zeros((len(engine), 3)), np.zeros((len(engine), 3))
    weight = environment.scene.settings.gravity * environment.privileged().object_mass[worlds]
    start = _in_palm(environment, worlds)
    first = fingers[worlds]
    for step in range(round(ends.max() / period)):
        time = step * period
        # What is lost, or was let go and taken away, is over: a light object that is pulled on by its far end
        # spins until the simulation breaks down.
        active = (time < ends - 1e-9) & (moved < LOST)
        poses, centers, palm = (
            values[worlds] for values in (engine.object_pose, engine.center_of_mass, engine.palm_pose)
        )
        joints = hand.independent(engine.joint_positions)
        kept = np.clip(hold.keep(joints), *limits)
        palms[worlds], velocity[worlds] = uses.palms_at(time + period)
        fingers[worlds] = uses.fingers_at(time + period, joints[worlds], first, kept[worlds], opened)
        force[worlds], torque[worlds] = uses.loads_at(time, poses, centers, palm, weight)
        engine.push_object(force, torque)
        controls = engine.controls(palms, velocity, fingers)
        engine.step(controls, substeps, worlds[active])
        watch(controls)
        # What has let go may move; until then the object is to stay.
        holding = active & (time < durations - 1e-9)
        apart, turned = displacement(start, _in_palm(environment, worlds))
        moved = np.maximum(moved, apart)
        shift = np.where(holding, np.maximum(shift, apart), shift)
        turn = np.where(holding, np.maximum(turn, turned), turn)
    engine.push_object(np.zeros_like(force), np.zeros_like(torque))
    outcomes.shift_m[worlds], outcomes.turn_rad[worlds] = shift, turn
    _judge(environment, tested, outcomes, touched, shown)
    return _with_texts(outcomes)


def _in_palm(environment: LiftEnvironment, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Center of mass [m], shape [I, 3], and rotation, shape [I, 4], of objects in the palm's frame."""
    engine = environment.engine
    palm, pose = engine.palm_pose[worlds], engine.object_pose[worlds]
    center = inverse_transform_points(palm, engine.center_of_mass[worlds][:, None])[:, 0]
    return center, compose(invert(palm), pose)[:, 3:]


def _judge(
    environment: LiftEnvironment,
    uses: Sequence[tuple[int, UseMotion]],
    outcomes: UseOutcomes,
    parts: np.ndarray,
    shown: AsShown | None,
) -> None:
    """Fill in success and reason.

    Args:
        outcomes: of W worlds.
        parts: that each link touches, shape [W, L] str.
        shown: how the hands held, W rows; None if the person's places are not known.
    """
    engine, hand = environment.engine, environment.scene.hand
    contacts, forces, diverged = engine.link_contacts, engine.link_forces, engine.diverged
    for w, motion in uses:
        trigger = motion.trigger
        reason = DIVERGED if diverged[w] else moved_too_far(outcomes.shift_m[w], outcomes.turn_rad[w])
        if not reason and shown is not None and not shown.holds[w]:
            reason = "not held as shown"
        if not reason and trigger is not None:
            links = [i for i, name in enumerate(hand.link_names) if name.startswith(trigger.finger)]
            # Where the person's places are known, the finger presses at its own.
            there = contacts[w].copy()
            if shown is not None:
                there[1:] &= shown.shown[w]
            on_part = [i for i in links if there[i] and trigger.part in ("", parts[w, i])]
            outcomes.trigger_force_n[w] = forces[w, on_part].sum() if on_part else 0.0
            if not links:
                reason = f"the hand has no {trigger.finger} finger"
            elif not on_part:
                reason = f"the {trigger.finger} finger does not touch the {trigger.part or 'object'}"
            elif outcomes.trigger_force_n[w] < trigger.force:
                reason = f"the {trigger.finger} finger presses with less than {trigger.force:g} N"
        elif not reason and motion.pull and contacts[w].any():
            reason = "the hand did not let go"
        if not reason and trigger is None and not outcomes.functional_contact[w] > 0:
            reason = "no finger touches the part that the person held"
        outcomes.success[w], outcomes.reason[w] = not reason, reason


def _with_texts(outcomes: UseOutcomes) -> UseOutcomes:
    return replace(outcomes, reason=outcomes.reason.astype(str))
