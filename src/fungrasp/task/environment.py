"""Episodes of the lift test in randomized worlds with simulated sensors."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.arrays import copied, moved_to, rows_like
from fungrasp.geometry.poses import array_namespace, compose, relative
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.as_shown import ShownContacts
from fungrasp.objects import scaled_name, shifted_mass
from fungrasp.sim2real import NOMINAL, EpisodeSample, Randomization, draw, shift_on_table
from fungrasp.simulation import Engine, Scene, make_engine
from fungrasp.task.belief import Belief
from fungrasp.task.grasp_plan import GraspPlan
from fungrasp.task.lift import LiftTask
from fungrasp.task.object_placement import Placement, on_drawn_table, resting_shift, where_seen
from fungrasp.task.outcome import Outcomes
from fungrasp.task.policy import Action, Observation, Policy, Privileged, PrivilegedPolicy
from fungrasp.task.policy_checks import check_action, check_finite, check_policy
from fungrasp.task.protocol import LiftProtocol
from fungrasp.task.sensors import Jitter, SimulatedSensors

_log = logging.getLogger(__name__)


class LiftEnvironment:
    """W episodes. ``settle`` begins them like the lift test, ``begin`` at any step of a plan."""

    def __init__(
        self,
        scene: Scene,
        count: int,
        randomization: Randomization = NOMINAL,
        protocol: LiftProtocol | None = None,
        rng: Jitter | Sequence[np.random.Generator] | None = None,
        threads: int = 0,
        engine: Engine | None = None,
    ):
        """
        Args:
            scene: scene with the hand and the objects in all sizes of the randomization
                (``fungrasp.objects.with_sizes``).
            count: W.
            randomization: randomization of worlds and sensor errors.
            protocol: published protocol if None.
            rng: generators of sensor noise, one for all worlds or one per world; seed 0 if None.
            threads: 0 for all processors. Results do not depend on it.
            engine: engine with W worlds of the scene; made for the scene's device if None. Episode arrays are
                on its device.

        Raises:
            FungraspError: ``scene`` is not a scene.
        """
        if not isinstance(scene, Scene):
            raise FungraspError(
                f"expected a scene (fungrasp.build_scene(hand, objects)), not a {type(scene).__name__}"
            )
        self.scene, self.randomization = scene, randomization
        self.engine: Engine = engine or make_engine(scene, count, threads)
        self.task = LiftTask(self.engine, protocol)
        self.sensors = SimulatedSensors(self.task, randomization, rng or np.random.default_rng(0))
        joints = len(scene.hand.joint_names)
        self.sample = draw(randomization, count, joints, np.random.default_rng(0))
        self._mass, self._friction = (rows_like(self.task.time, np.zeros(count)) for _ in range(2))
        # Randomized parameters are per joint; joints without a servo are left out.
        actuators = scene.hand.actuators
        self._driven = np.array([scene.hand.joint_names.index(name) for name in actuators])
        self._torque_limit = np.zeros(joints)
        self._torque_limit[self._driven] = [servo.force_limit for servo in actuators.values()]

    def __len__(self) -> int:
        return len(self.engine)

    @property
    def sample(self) -> EpisodeSample:
        """Random parameters of each world; NumPy arrays."""
        return self._sample

    @sample.setter
    def sample(self, sample: EpisodeSample) -> None:
        self._sample = sample
        self._felt = sample.mapped(lambda values: moved_to(self.task.time, values))

    @property
    def protocol(self) -> LiftProtocol:
        """Protocol of the episodes."""
        return self.task.protocol

    def settle(self, grasps: RobotGraspSet, sample: EpisodeSample | None = None) -> Belief:
        """Begin episodes like the lift test: let objects settle and put hands at their start poses.

        Args:
            sample: random parameters of the W episodes; the current ``sample`` if None.

        Returns:
            Estimated state and nominal parameters of the scenes.

        Raises:
            FungraspError: the number of grasps is not W.
        """
        self._check_count(grasps, RobotGraspSet, "robot grasps")
        everyone = np.arange(len(self))
        self.sample = self.sample if sample is None else sample
        rest = on_drawn_table(grasps.object_rest_pose, np.zeros(len(self)), self.sample)
        index = self._object_index(grasps.object_name, self.sample)
        self._set_parameters(everyone, index, grasps.object_mass, rest)
        self.task.settle(replace(grasps, object_rest_pose=rest.object_pose), rest.table_height)
        self.task.show(everyone, ShownContacts.of(grasps))
        self.sensors.begin(everyone)
        seen = self.sensors.estimated_object_pose(self.task.settled_pose.copy(), self.sample)
        setpoints = self.task.setpoints
        belief = Belief.nominal(
            seen, grasps.object_mass.copy(), setpoints.wrist.pose.copy(), setpoints.fingers.copy()
        )
        belief = replace(belief, object_mass_spread=grasps.object_mass_spread)
        covariance = self.randomization.object_pose_covariance
        if not covariance.any():
            return belief
        return replace(belief, object_pose_covariance=np.tile(covariance, (len(self), 1, 1)))

    def move_objects(self) -> None:
        """Shift the objects on the table as sampled, after planning and before the episodes."""
        shift, task = self.sample.object_shift, self.task
        if not shift.any():
            return
        moved = shift_on_table(task.settled_pose, shift)
        # The wrist's frame moves along with the object; the palm stays.
        wrist = compose(moved, relative(task.settled_pose, self.engine.wrist_frame))
        setpoints = task.setpoints
        everyone = np.arange(len(self))
        task.begin(
            everyone,
            moved,
            wrist,
            setpoints.wrist.pose.copy(),
            setpoints.fingers.copy(),
            task.target_contacts,
        )
        self.sensors.begin(everyone)

    def begin(
        self,
        ids: np.ndarray,
        plans: GraspPlan,
        step: np.ndarray,
        sample: EpisodeSample,
        belief: Belief | None = None,
        *,
        hand_followed: bool = False,
    ) -> None:
        """Begin episodes in some worlds at any step of their plans. Objects rest where their estimated poses
        match the plans. Centers of mass are shifted only as far as the objects stay at rest
        (``resting_shift``), because nothing settles here.

        Args:
            ids: worlds, shape [I].
            plans: plans of these worlds, I of them.
            step: first control step of the plan, shape [I] int.
            sample: random parameters of the I episodes.
            belief: nominal friction and joint dynamics, I rows; the scene's if None.
            hand_followed: whether the hand has followed an object that was moved after planning to its
                estimated pose; otherwise the hand is at the planned pose.
        """
        self.engine.reset(ids)
        seen = shift_on_table(plans.object_pose, sample.object_shift)
        index = self._object_index(plans.object_name, sample)
        height = np.zeros(len(ids)) if belief is None else belief.table_height
        models = [self.scene.models[i] for i in index]
        sample = replace(
            sample, center_of_mass_shift=resting_shift(models, seen, sample.center_of_mass_shift)
        )
        self.sample = self.sample.replaced(ids, sample)
        center = self._mass_distribution(index, plans.object_mass, sample.center_of_mass_shift)[0]
        placed = where_seen(seen, height, sample, models, center)
        self._set_parameters(ids, index, plans.object_mass, placed, belief)
        rows, origin = np.arange(len(ids)), plans.object_pose
        if hand_followed:
            origin = on_drawn_table(seen, height, sample).object_pose
        self.task.begin(
            ids,
            placed.object_pose,
            compose(origin, plans.grasp_palm_pose),
            compose(origin, plans.palm_setpoint_object[rows, step]),
            plans.finger_targets[rows, np.maximum(step - 1, 0)],
            plans.link_contacts,
            plans.palm_velocity[rows, step],
            step * plans.control_period,
        )
        self.task.show(ids, ShownContacts.of(plans))
        self.sensors.begin(ids)

    def withdraw(self, ids: np.ndarray, rng: Sequence[np.random.Generator]) -> None:
        """Continue in some worlds after an attempt: hands may move, but not lift before ``begin_attempt``.

        Args:
            ids: worlds, shape [I].
            rng: generators of sensor noise from now on, one per world.
        """
        self.task.withdraw(ids)
        self.sensors.resume(ids, rng)

    def resume(self, ids: np.ndarray) -> None:
        """Continue in some worlds that were paused by marking them as done. ids: shape [I]."""
        self.task.done[ids] = False
        self.sensors.resume(ids)

    def begin_attempt(self, ids: np.ndarray, target_pose: np.ndarray) -> None:
        """Begin another attempt in some worlds from their current state.

        Args:
            ids: worlds, shape [I].
            target_pose: approximate palm pose of the grasp, world frame, shape [I, 7].
        """
        self.task.begin_attempt(ids, target_pose)
        self.sensors.begin(ids)

    def step(self, action: Action, watch: Callable[[], None] = lambda: None) -> None:
        """Advance by one control period. watch: called after each setpoint, for recording."""

        def after() -> None:
            self.sensors.record()
            watch()

        self.task.step(action, self._push, after)

    def observe(self) -> Observation:
        """Return the current sensor data."""
        return self.sensors.observe(self._felt)

    def privileged(self) -> Privileged:
        """Return the current privileged state."""
        engine = self.engine
        return Privileged(
            contacts=engine.link_contacts,
            forces=engine.link_forces,
            object_velocity=engine.object_velocity,
            table_forces=engine.table_forces,
            self_force=engine.self_force,
            object_on_table=engine.object_on_table,
            object_mass=copied(self._mass),
            friction=copied(self._friction),
            lifted_height=self.task.measurements.height,
        )

    def _check_count(self, rows: Any, kind: type, words: str) -> None:
        if not isinstance(rows, kind):
            raise FungraspError(f"expected {words}, not a {type(rows).__name__}")
        if len(rows) != len(self):
            raise FungraspError(f"there are {len(rows)} {words} for an environment of {len(self)} worlds")

    def _object_index(self, names: np.ndarray, sample: EpisodeSample) -> np.ndarray:
        """Return the index of each object in its sampled size, shape [I]. names: shape [I] str."""
        sizes = zip(names.tolist(), sample.object_scale.tolist(), strict=True)
        return self.scene.indices([scaled_name(name, factor) for name, factor in sizes])

    def _set_parameters(
        self,
        ids: np.ndarray,
        index: np.ndarray,
        mass: np.ndarray,
        placed: Placement,
        belief: Belief | None = None,
    ) -> None:
        """Set the physics of some worlds from nominal and random parameters.

        Args:
            ids: worlds, shape [I].
            index: scene indices of their objects, shape [I].
            mass: nominal masses of the objects [kg], shape [I].
            placed: placement of the objects and their tables.
            belief: nominal friction and joint dynamics, I rows; the scene's if None.
        """
        s, nominal = self.sample.select(ids), self.scene.settings.friction
        friction = np.full(len(ids), nominal) if s.friction is None else s.friction
        damping, stiffness, servo = s.joint_damping, s.servo_stiffness, s.servo_damping
        if belief is not None:
            friction = friction * (belief.friction / nominal)
            damping = damping if belief.joint_damping is None else damping * belief.joint_damping
            stiffness = stiffness if belief.servo_stiffness is None else stiffness * belief.servo_stiffness
            servo = servo if belief.servo_damping is None else servo * belief.servo_damping
        true_mass = mass * s.mass
        center, inertia = self._mass_distribution(index, true_mass, s.center_of_mass_shift)
        shifted = bool(s.center_of_mass_shift.any())
        self.engine.set_parameters(
            ids,
            object_index=index,
            object_mass=true_mass,
            object_center=center if shifted else None,
            object_inertia=inertia if shifted else None,
            friction=friction,
            table_height=placed.height_at_origin,
            table_tilt=placed.table_tilt,
            joint_friction=s.joint_friction * self._torque_limit,
            joint_damping=damping,
            servo_stiffness=stiffness[:, self._driven],
            servo_damping=servo[:, self._driven],
            wrist_stiffness=s.wrist_stiffness,
        )
        actuation = self.task.actuation
        for array, values in (
            (self._mass, true_mass),
            (self._friction, friction),
            (self.task.setpoints.delay, s.action_delay),
            (actuation.wrist_lag, s.wrist_lag),
            (actuation.wrist_offset, s.wrist_offset),
            (actuation.encoder_bias, s.encoder_bias[:, self._driven]),
            (actuation.backlash, s.backlash[:, self._driven]),
        ):
            array[moved_to(array, ids)] = moved_to(array, values)

    def _mass_distribution(
        self, index: np.ndarray, mass: np.ndarray, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return centers of mass [m], object frame, shape [I, 3], and inertias about them [kg m2], shape
        [I, 3, 3]."""
        models = [self.scene.models[i] for i in index]
        inertia = np.array([model.inertia / model.mass for model in models])
        return shifted_mass(
            np.array([model.center_of_mass for model in models]),
            mass[:, None, None] * inertia,
            mass,
            np.array([model.size for model in models]),
            shift,
        )

    def _push(self) -> None:
        r, s, task = self.randomization, self._felt, self.task
        if not r.push_times:
            return
        began, xp = task.lift_time if r.push_phase == "lift" else task.hold_time, array_namespace(task.time)
        since = (task.time - began)[:, None] - s.push_start
        active = xp.isfinite(since) & (since >= -1e-9) & (since < r.push_duration - 1e-9)
        weight = self.scene.settings.gravity * self._mass[:, None]
        size = xp.where(active, s.push_force + s.push_weights * weight, 0.0)
        self.engine.push_object((size[..., None] * s.push_direction).sum(axis=1))


def report_problems(engine: Engine) -> None:
    """Log the engine's problems as warnings, after a batch of episodes."""
    for problem in engine.problems():
        _log.warning("%s", problem)


def play(
    environment: LiftEnvironment,
    policy: Policy | PrivilegedPolicy,
    plan: GraspPlan,
    *,
    end_lost: bool = False,
    watch: Callable[[], None] = lambda: None,
    look: Callable[[Observation], None] = lambda observation: None,
) -> Outcomes:
    """Run a policy until all episodes end.

    Args:
        policy: a policy; teachers also get the privileged state.
        plan: one plan per world.
        end_lost: end an episode as failed as soon as its object is lost.
        watch: called after each setpoint, to record.
        look: called with each observation.

    Raises:
        FungraspError: the policy lacks a method, its first action is invalid, an action is not finite, or the
            number of plans is not the number of worlds.
    """
    check_policy(policy)
    environment._check_count(plan, GraspPlan, "plans")
    task, lost = environment.task, np.zeros(len(environment), dtype=bool)
    observation = environment.observe()
    look(observation)
    policy.reset(plan, observation)
    first = observation
    while not task.done.all():
        if isinstance(policy, PrivilegedPolicy):
            action = policy.act_privileged(observation, environment.privileged())
        else:
            action = policy.act(observation)
        if observation is first:
            check_action(action, plan, observation)
        check_finite(policy, action, plan, task.time, task.done | environment.engine.diverged)
        environment.step(action, watch)
        if end_lost:
            gone = task.lost
            lost |= gone & ~task.done
            task.done |= gone
        observation = environment.observe()
        look(observation)
    report_problems(environment.engine)
    outcomes = task.outcomes()
    outcomes.fail(lost, "lost before the hold")
    return outcomes
