"""mink: differential inverse kinematics towards surface targets, with the model's convex pieces kept apart
by its collision limit."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from benchmarks.peers.problem import CpuClock, PeerProblem
from fungrasp.geometry.poses import compose, invert, rotate
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel

STEPS, STEP_TIME = 80, 0.1
"""Steps of the solver for each grasp, and the time of each [s]."""

START_AWAY = 0.08
"""The palm starts so far back along its normal [m], so that no finger starts within the object."""


def solve_mink(problem: PeerProblem) -> tuple[RobotGraspSet, float]:
    """By mink (Zakka, 2024). Returns the grasps and processor seconds."""
    hand, human = problem.hand, problem.human
    scenes = {name: _Scene(hand, model) for name, model in problem.objects.items()}
    targets = problem.contact_points()
    start = problem.wrist_start.copy()
    start[:, :3] -= START_AWAY * rotate(start[:, 3:], hand.palm_normal)
    joints = hand.all_joints(problem.joints_start)
    wanted = problem.targets.contacts[:, 1:]

    def one(row: int, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray]:
        scene = scenes[str(human.object_name[row])]
        scene.place(human.object_pose[row], human.object_rest_pose[row])
        return scene.solve(problem, start[row], joints[row], targets[row], wanted[row], steps)

    one(0, 2)
    with CpuClock() as clock:
        found = [one(row) for row in range(len(human))]
    wrist, angles = (np.array(x) for x in zip(*found, strict=True))
    return problem.solved(wrist, angles), clock.seconds


def hand_on_free_joint(hand: Hand) -> mujoco.MjSpec:
    """A hand's model without its actuators, its palm on the joint "free"."""
    spec = hand.spec()
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    spec.body(hand.palm).add_freejoint(name="free")
    return spec


class _Scene:
    """The hand on a free joint, an object and a table."""

    def __init__(self, hand: Hand, model: ObjectModel):
        spec = hand_on_free_joint(hand)
        table = spec.worldbody.add_body(name="table", mocap=True)
        table.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.05], pos=[0, 0, -0.05])
        obj = spec.worldbody.add_body(name="object", mocap=True)
        for number, piece in enumerate(model.pieces):
            spec.add_mesh(name=f"piece{number}", uservert=np.asarray(piece.vertices).ravel())
            obj.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece{number}")
        self.hand, self.model = hand, spec.compile()
        m = self.model
        root = m.body(hand.palm).rootid[0]
        owner = m.body_rootid[m.geom_bodyid]
        self._hand_geoms = np.flatnonzero(owner == root).tolist()
        self._others = np.flatnonzero(owner != root).tolist()
        self._address = [int(m.jnt_qposadr[m.joint(name).id]) for name in hand.joint_names]
        self._free = int(m.jnt_qposadr[m.joint("free").id])
        self._mocap: dict[str, np.ndarray] = {}

    def place(self, object_pose: np.ndarray, rest_pose: np.ndarray) -> None:
        """The object where it is grasped; the table as it lies under the object at rest."""
        self._mocap = {"object": object_pose, "table": compose(object_pose, invert(rest_pose))}

    def solve(
        self,
        problem: PeerProblem,
        start: np.ndarray,
        joints: np.ndarray,
        targets: np.ndarray,
        wanted: np.ndarray,
        steps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Palm pose [7] and all joints [M], world frame."""
        import mink  # pyright: ignore[reportMissingImports]

        model = self.model
        qpos = np.zeros(model.nq)
        qpos[self._free : self._free + 7], qpos[self._address] = start, joints
        configuration = mink.Configuration(model)
        configuration.update(qpos)
        data = configuration.data
        for name, pose in self._mocap.items():
            mocap = model.body(name).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = pose[:3], pose[3:]
        mujoco.mj_forward(model, data)
        match, names = problem.points.match, self.hand.keypoint_names
        tasks: list[Any] = []
        for link, far in enumerate(match.far):
            is_site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, names[far]) >= 0
            cost = 1.0 if match.is_last[link] else 0.3 if wanted[link] else 0.1
            kind = "site" if is_site else "body"
            task = mink.FrameTask(names[far], kind, position_cost=cost, orientation_cost=0.0, lm_damping=1e-3)
            task.set_target(mink.SE3.from_translation(targets[link]))
            tasks.append(task)
        palm = mink.FrameTask(self.hand.palm, "body", position_cost=0.0, orientation_cost=0.02)
        palm.set_target(mink.SE3.from_rotation(mink.SO3(start[3:])))
        posture = mink.PostureTask(model, cost=1e-3)
        posture.set_target(qpos)
        tasks += [palm, posture]
        if model.neq:
            tasks.append(mink.EqualityConstraintTask(model, cost=1.0))
        pairs = [(self._hand_geoms, self._others), (self._hand_geoms, self._hand_geoms)]
        collisions = mink.CollisionAvoidanceLimit(
            model,
            pairs,
            gain=0.85,
            minimum_distance_from_collisions=0.0005,
            collision_detection_distance=0.03,
        )
        limits = [mink.ConfigurationLimit(model), collisions]
        for _ in range(steps):
            try:
                velocity = mink.solve_ik(configuration, tasks, STEP_TIME, "daqp", damping=1e-4, limits=limits)
            except mink.NoSolutionFound:
                velocity = mink.solve_ik(
                    configuration, tasks, STEP_TIME, "daqp", damping=1e-4, limits=limits[:1]
                )
            configuration.integrate_inplace(velocity, STEP_TIME)
        q = configuration.q
        return q[self._free : self._free + 7].copy(), q[self._address].copy()
