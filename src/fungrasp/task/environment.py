"""Episodes of the lift test as a policy meets them: worlds that differ from the nominal ones, seen by
sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fungrasp.geometry.poses import compose, relative
from fungrasp.grasps import RobotGraspSet
from fungrasp.simulation import Engine, MujocoCpuEngine, Scene
from fungrasp.task.action import Action
from fungrasp.task.belief import Belief
from fungrasp.task.grasp_plan import GraspPlan
from fungrasp.task.lift import LiftTask
from fungrasp.task.observation import Observation, Privileged
from fungrasp.task.outcome import Outcomes
from fungrasp.task.policy import Policy, PrivilegedPolicy
from fungrasp.task.protocol import LiftProtocol
from fungrasp.task.sensors import SimulatedSensors
from fungrasp.transfer import NOMINAL, EpisodeSample, Randomization, draw, shift_on_table


class LiftEnvironment:
    """W episodes. They begin with ``settle`` as the lift test does, or with ``begin`` in the midst of
    plans."""

    def __init__(
        self,
        scene: Scene,
        count: int,
        randomization: Randomization = NOMINAL,
        protocol: LiftProtocol | None = None,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
        threads: int = 0,
        engine: Engine | None = None,
    ):
        """
        Args:
            scene: with the hand and the objects.
            count: W.
            randomization: how worlds may differ from the nominal ones, and sensors err.
            protocol: the published one if None.
            rng: of the sensors' jitter, one for all worlds or one for each; seeded with zero if None.
            threads: 0 means all processors. Results do not depend on it.
            engine: with W worlds of the scene; the CPU engine if None.
        """
        self.scene, self.randomization = scene, randomization
        self.engine: Engine = engine or MujocoCpuEngine(scene, count, threads)
        self.task = LiftTask(self.engine, protocol)
        self.sensors = SimulatedSensors(self.task, randomization, rng or np.random.default_rng(0))
        joints = len(scene.hand.joint_names)
        self.sample: EpisodeSample = draw(randomization, count, joints, np.random.default_rng(0))
        """What was drawn for the episode in each world."""
        self._mass = np.zeros(count)
        self._friction = np.zeros(count)
        # Motors and joints are numbered by joint; those that have no servo are left out.
        self._driven = np.array([scene.hand.joint_names.index(name) for name in scene.hand.actuators])

    def __len__(self) -> int:
        return len(self.engine)

    @property
    def protocol(self) -> LiftProtocol:
        """Protocol of the episodes."""
        return self.task.protocol

    def settle(self, grasps: RobotGraspSet, sample: EpisodeSample | None = None) -> Belief:
        """Begin episodes as the lift test does: objects settle, hands are at their start.

        Args:
            grasps: one per world.
            sample: what differs from the nominal worlds, W episodes; what was drawn before if None.

        Returns:
            Estimated state and nominal parameters of the scenes.
        """
        everyone = np.arange(len(self))
        self.sample = self.sample if sample is None else sample
        self._set_parameters(everyone, self.scene.indices(grasps.object_name.tolist()), grasps.object_mass)
        rest = grasps.object_rest_pose.copy()
        rest[:, 2] += self.sample.table_height
        self.task.settle(replace(grasps, object_rest_pose=rest), self.sample.table_height)
        self.sensors.begin(everyone)
        seen = self.sensors.estimated_object_pose(self.task.settled_pose.copy(), self.sample)
        setpoints = self.task.setpoints
        return Belief.nominal(
            seen, grasps.object_mass.copy(), setpoints.wrist.pose.copy(), setpoints.fingers.copy()
        )

    def move_objects(self) -> None:
        """Move the objects on the table as drawn: after planning, before the episodes are played."""
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
        """Begin episodes of some worlds in the midst of their plans, objects at rest.

        Args:
            ids: worlds, shape [I].
            plans: of these worlds, I of them.
            step: control step of the plan to begin at, shape [I] int.
            sample: what differs from the nominal worlds, I episodes.
            belief: with the nominal friction and joint dynamics, I rows; the scene's if None.
            hand_followed: whether the hand has followed an object that was moved since it was planned for;
                else it is where the plan has it.
        """
        self.engine.reset(ids)
        self.sample = self.sample.replaced(ids, sample)
        index = self.scene.indices(plans.object_name.tolist())
        self._set_parameters(ids, index, plans.object_mass, belief)
        placed = shift_on_table(plans.object_pose, sample.object_shift)
        placed[:, 2] += sample.table_height
        rows, origin = np.arange(len(ids)), placed if hand_followed else plans.object_pose
        self.task.begin(
            ids,
            placed,
            compose(origin, plans.grasp_palm_pose),
            compose(origin, plans.palm_setpoint[rows, step]),
            plans.finger_targets[rows, np.maximum(step - 1, 0)],
            plans.link_contacts,
            plans.palm_velocity[rows, step],
            step * plans.control_period,
        )
        self.sensors.begin(ids)

    def step(self, action: Action, watch: Callable[[], None] = lambda: None) -> None:
        """Advance by one control period. watch: called after each setpoint, to record."""

        def after() -> None:
            self.sensors.record()
            watch()

        self.task.step(action, self._push, after)

    def observe(self) -> Observation:
        """What the sensors say now."""
        return self.sensors.observe(self.sample)

    def privileged(self) -> Privileged:
        """What only a simulation knows."""
        engine = self.engine
        return Privileged(
            contacts=engine.link_contacts,
            forces=engine.link_forces,
            object_velocity=engine.object_velocity,
            table_forces=engine.table_forces,
            self_force=engine.self_force,
            object_on_table=engine.object_on_table,
            object_mass=self._mass.copy(),
            friction=self._friction.copy(),
            lifted_height=self.task.measurements.height,
        )

    def _set_parameters(
        self, ids: np.ndarray, index: np.ndarray, mass: np.ndarray, belief: Belief | None = None
    ) -> None:
        """The physics of some worlds: nominal parameters times the factors that were drawn."""
        s, nominal = self.sample.select(ids), self.scene.settings.friction
        friction = np.full(len(ids), nominal) if s.friction is None else s.friction
        table = s.table_height if belief is None else s.table_height + belief.table_height
        damping, stiffness, servo = s.joint_damping, s.servo_stiffness, s.servo_damping
        if belief is not None:
            friction = friction * (belief.friction / nominal)
            damping = damping if belief.joint_damping is None else damping * belief.joint_damping
            stiffness = stiffness if belief.servo_stiffness is None else stiffness * belief.servo_stiffness
            servo = servo if belief.servo_damping is None else servo * belief.servo_damping
        self._mass[ids], self._friction[ids] = mass * s.mass, friction
        self.engine.set_parameters(
            ids,
            object_index=index,
            object_mass=self._mass[ids],
            friction=friction,
            table_height=table,
            joint_damping=damping,
            servo_stiffness=stiffness[:, self._driven],
            servo_damping=servo[:, self._driven],
            wrist_stiffness=s.wrist_stiffness,
        )
        self.task.setpoints.delay[ids] = s.action_delay

    def _push(self) -> None:
        """Push the objects as drawn."""
        r, s, task = self.randomization, self.sample, self.task
        if not r.push_times:
            return
        began = task.lift_time if r.push_phase == "lift" else task.hold_time
        since = (task.time - began)[:, None] - s.push_start
        active = np.isfinite(since) & (since >= -1e-9) & (since < r.push_duration - 1e-9)
        weight = self.scene.settings.gravity * self._mass[:, None]
        size = np.where(active, s.push_force + s.push_weights * weight, 0.0)
        self.engine.push_object((size[..., None] * s.push_direction).sum(axis=1))


def play(
    environment: LiftEnvironment,
    policy: Policy | PrivilegedPolicy,
    plan: GraspPlan,
    *,
    end_lost: bool = False,
    watch: Callable[[], None] = lambda: None,
) -> Outcomes:
    """Let a policy act until all episodes are over.

    Args:
        environment: whose episodes have begun.
        policy: what acts; one that takes privileged information gets it.
        plan: to follow, one for each world.
        end_lost: episodes end as soon as their object is lost, as failures.
        watch: called after each setpoint, to record.
    """
    task, lost = environment.task, np.zeros(len(environment), dtype=bool)
    observation = environment.observe()
    policy.reset(plan, observation)
    while not task.done.all():
        if isinstance(policy, PrivilegedPolicy):
            action = policy.act_privileged(observation, environment.privileged())
        else:
            action = policy.act(observation)
        environment.step(action, watch)
        if end_lost:
            gone = task.lost
            lost |= gone & ~task.done
            task.done |= gone
        observation = environment.observe()
    outcomes = task.outcomes()
    outcomes.success[lost] = False
    outcomes.reason[lost] = "lost before the hold"
    return outcomes
