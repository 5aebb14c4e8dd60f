"""Use tests of W worlds after their lift test: the wrist plays the motion of each grasp's task."""

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
"""Integral gain of the finger setpoints, per setpoint. With 0.1 fewer objects stay in the hand; much larger
gains overshoot, because joints follow their setpoints with a delay."""


class FingerHold:
    """Finger setpoints of W hands that hold an object.

    A servo alone is a spring: a finger of 4 N m/rad yields by a centimeter to 3 N. Integral control moves the
    setpoints until the joints are back at their positions, within the torque limits. It needs only the
    encoders, whose biases do not matter.
    """

    def __init__(self, hand: Hand, setpoints: np.ndarray, joints: np.ndarray):
        """
        Args:
            setpoints: setpoints of the independent joints in the hold [rad], shape [W, U].
            joints: positions of the independent joints in the hold [rad], shape [W, U].
        """
        servos = hand.actuators.values()
        self._most = np.array([servo.force_limit / servo.kp for servo in servos])
        self._reference, self._setpoints = joints.copy(), setpoints.copy()

    def keep(self, joints: np.ndarray) -> np.ndarray:
        """Return the next setpoints [rad], shape [W, U]. joints: current positions [rad], shape [W, U]."""
        moved = self._setpoints + HOLD_GAIN * (self._reference - joints)
        # A setpoint beyond the torque limit would only delay the joint's return.
        self._setpoints = np.clip(moved, joints - self._most, joints + self._most)
        return self._setpoints


TABLE_AWAY = -0.2
"""Height of the table top during the motion [m]; a robot would move away from the table."""

LOST = 0.1
"""Displacement in the palm beyond which an object is lost or released, and its test ends [m]."""


def play_use(
    environment: LiftEnvironment,
    motions: Sequence[UseMotion | None],
    held: np.ndarray,
    watch: Callable[[np.ndarray], None] = lambda controls: None,
) -> UseOutcomes:
    """Play the use motions of W grasps after the hold, while the fingers keep holding (``FingerHold``).

    Args:
        motions: motion of each world; None if its task has none.
        held: worlds that passed the lift test, shape [W] bool; the others are not tested.
        watch: called after each setpoint with the servo controls, to record
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
        # Worlds with a lost or released object stop: a light object pulled at its far end would spin until
        # the simulation diverges.
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
        # Displacements count until the hand lets go.
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
    """Return the objects' centers of mass [m], shape [I, 3], and rotations, shape [I, 4], palm frame."""
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
        outcomes: W rows.
        parts: part that each link touches, shape [W, L] str.
        shown: whether grasps are held as shown, W rows; None if the person's contacts are unknown.
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
            # If the person's contacts are known, the finger has to press at its own.
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
