"""An episode in SAPIEN, which is PhysX 5 on the processor: patches of contacts, its TGS solver."""

# The package may be missing, and its type stubs take arrays of one type alone.
# pyright: reportMissingImports=false, reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.engines.audit.bundle import EpisodeBundle
from benchmarks.engines.audit.hand_parts import Body, Inertia, Joint, Shape, Vector
from fungrasp.core.errors import FungraspError

TIMESTEP = 0.002
"""[s]; PhysX's articulations need smaller steps than MuJoCo."""
ITERATIONS = 40, 4
"""Of the solver, for positions and for velocities."""
OFFSET = 0.003
"""Distance from which contacts are made [m]."""
COUPLING = 1e5
"""Stiffness of a coupling [N m/rad]: what SAPIEN gives couplings of URDF files."""
HALF = float(np.sqrt(0.5))
_ALONG_X = (HALF, 0.0, -HALF, 0.0)
"""Turns what lies along z so that it lies along x, where PhysX has it."""


class SapienWorld:
    """See ``benchmarks.engines.audit.replay.EpisodeWorld``. Dry friction of joints is left out: PhysX knows
    it as a share of the load alone. A coupling is a stiff tendon along the chain of links."""

    def __init__(self, bundle: EpisodeBundle):
        """bundle: of the episode."""
        import sapien
        import sapien.physx as physx

        self._sapien, self._physx = sapien, physx
        gravity = np.array([0.0, 0.0, -bundle.gravity], dtype=np.float32)
        physx.set_scene_config(
            gravity=gravity,
            enable_pcm=True,
            enable_tgs=True,
            enable_friction_every_iteration=True,
            bounce_threshold=2.0,
        )
        physx.set_body_config(
            solver_position_iterations=ITERATIONS[0],
            solver_velocity_iterations=ITERATIONS[1],
            sleep_threshold=0.0,
        )
        physx.set_shape_config(contact_offset=OFFSET, rest_offset=0.0)
        self._system = physx.PhysxCpuSystem()
        self._world = sapien.Scene([self._system])
        self._system.set_timestep(TIMESTEP)
        self._material = physx.PhysxMaterial(bundle.friction, bundle.friction, 0.0)
        self._table = physx.PhysxRigidStaticComponent()
        plane = physx.PhysxCollisionShapePlane(self._material)
        self._table.attach(self._ready(plane, 0, sapien.Pose([0, 0, 0], _ALONG_X)))
        self._add(self._table, sapien.Pose([0.0, 0.0, bundle.table_height]))
        self._object = physx.PhysxRigidDynamicComponent()
        for corners in bundle.pieces:
            self._object.attach(self._ready(self._convex(corners), 0, sapien.Pose()))
        self._weigh(self._object, bundle.object_inertia)
        self._object.set_linear_damping(0.0)
        self._object.set_angular_damping(0.0)
        self._add(self._object, _pose_of(sapien, bundle.object_pose))
        self._drives: dict[str, Any] = {}
        self._links = self._add_hand(bundle)
        self._columns = [(self._drives[name], i) for i, name in enumerate(bundle.servos)]

    def tell(self, setpoints: np.ndarray) -> None:
        """Setpoints of the servos."""
        for drive, column in self._columns:
            drive.set_drive_target(float(setpoints[column]))

    def advance(self, duration: float) -> None:
        """Physics steps."""
        for _ in range(round(duration / TIMESTEP)):
            self._system.step()

    def object_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return _numbers(self._object.entity_pose)

    def palm_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return _numbers(self._palm.entity_pose)

    def touching(self) -> tuple[frozenset[str], bool]:
        """Bodies of the hand that touch the object, and whether the table does."""
        found, table = set(), False
        for contact in self._system.get_contacts():
            first, second = contact.bodies
            if self._object not in (first, second):
                continue
            if not any(np.linalg.norm(point.impulse) > 1e-7 for point in contact.points):
                continue
            other = second if first == self._object else first
            table |= other == self._table
            if other.name in self._links:
                found.add(other.name)
        return frozenset(found), table

    def _add(self, component: Any, pose: Any) -> Any:
        entity = self._sapien.Entity()
        entity.add_component(component)
        entity.set_pose(pose)
        self._world.add_entity(entity)
        return entity

    def _ready(self, shape: Any, apart: int, pose: Any) -> Any:
        """A shape where it belongs. apart: bits in common with shapes that it does not collide with."""
        shape.set_collision_groups([1, 1, apart, 0])
        shape.set_local_pose(pose)
        return shape

    def _convex(self, corners: tuple[Vector, ...]) -> Any:
        points, scale = np.array(corners, dtype=np.float32), np.ones(3, dtype=np.float32)
        return self._physx.PhysxCollisionShapeConvexMesh(points, scale, self._material)

    def _weigh(self, body: Any, inertia: Inertia) -> None:
        from scipy.spatial.transform import Rotation

        moments, axes = np.linalg.eigh(np.array(inertia.tensor))
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        body.set_mass(inertia.mass)
        body.set_cmass_local_pose(self._sapien.Pose(np.array(inertia.center), turn))
        body.set_inertia(moments)

    def _add_hand(self, bundle: EpisodeBundle) -> dict[str, Any]:
        sapien, physx = self._sapien, self._physx
        bits = dict.fromkeys((body.name for body in bundle.bodies), 0)
        for number, pair in enumerate(bundle.apart):
            for name in pair:
                bits[name] |= 1 << number
        root, base = physx.PhysxArticulationLinkComponent(None), sapien.Entity()
        self._weigh(root, Inertia(1.0, (0.0, 0.0, 0.0), _diagonal(1e-2)))
        root.name = "wrist_reference"
        base.add_component(root)
        base.set_pose(_pose_of(sapien, bundle.wrist_reference))
        entities, made, chain = [base], {"": root}, {}
        for body in bundle.bodies:
            parent, place = made[body.parent], _pose_of(sapien, body.pose)
            for number in range(max(len(body.joints), 1)):
                entity, part = sapien.Entity(), physx.PhysxArticulationLinkComponent(parent)
                last = number >= len(body.joints) - 1
                self._weigh(part, body.inertia if last else Inertia(1e-3, (0.0, 0.0, 0.0), _diagonal(1e-6)))
                part.name = body.name if last else f"{body.name}_{number}"
                if last:
                    self._add_shapes(part, body, bits[body.name])
                part.set_disable_gravity(True)
                part.set_linear_damping(0.0)
                part.set_angular_damping(0.0)
                entity.add_component(part)
                if body.joints:
                    joint = body.joints[number]
                    self._join(part, joint, place)
                    chain[joint.name] = part
                else:
                    part.joint.type = "fixed"
                    part.joint.pose_in_parent, part.joint.pose_in_child = place, sapien.Pose()
                entities.append(entity)
                parent, place = part, sapien.Pose()
            made[body.name] = parent
        root.joint.type = "fixed"
        hand = root.articulation
        for coupling in bundle.couplings:
            links = _between(chain[coupling.leader], chain[coupling.follower], coupling.follower)
            inner = [0.0] * (len(links) - 3)
            hand.create_fixed_tendon(
                links,
                [0.0, -coupling.ratio, *inner, 1.0],
                [0.0, -1.0 / coupling.ratio, *inner, 1.0],
                rest_length=coupling.offset,
                stiffness=COUPLING,
            )
        for entity in entities:
            self._world.add_entity(entity)
        hand.set_solver_position_iterations(ITERATIONS[0])
        hand.set_solver_velocity_iterations(ITERATIONS[1])
        hand.set_sleep_threshold(0.0)
        names = [joint.name for joint in hand.active_joints]
        hand.set_qpos(np.array([bundle.start[name] for name in names], dtype=np.float32))
        self._palm = made[bundle.palm]
        return {body.name: made[body.name] for body in bundle.bodies}

    def _add_shapes(self, part: Any, body: Body, apart: int) -> None:
        for shape in body.shapes:
            local = _pose_of(self._sapien, shape.pose)
            if shape.kind in ("capsule", "cylinder"):
                local = local * self._sapien.Pose([0, 0, 0], _ALONG_X)
            part.attach(self._ready(self._solid(shape), apart, local))

    def _solid(self, shape: Shape) -> Any:
        physx, size = self._physx, shape.size
        make: dict[str, Callable[[], Any]] = {
            "box": lambda: physx.PhysxCollisionShapeBox(list(size), self._material),
            "capsule": lambda: physx.PhysxCollisionShapeCapsule(size[0], size[1], self._material),
            "cylinder": lambda: physx.PhysxCollisionShapeCylinder(size[0], size[1], self._material),
            "sphere": lambda: physx.PhysxCollisionShapeSphere(size[0], self._material),
            "convex": lambda: self._convex(shape.vertices),
        }
        return make[shape.kind]()

    def _join(self, part: Any, joint: Joint, place: Any) -> None:
        """A joint between a link and its parent; PhysX's turn about x, and slide along it."""
        from scipy.spatial.transform import Rotation

        axis = np.array(joint.axis)
        across = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        frame = np.stack([axis, across, np.cross(axis, across)], axis=1)
        turn = self._sapien.Pose([0, 0, 0], Rotation.from_matrix(frame).as_quat(scalar_first=True))
        added = part.joint
        added.type = "prismatic" if joint.slide else "revolute"
        added.pose_in_parent, added.pose_in_child = place * turn, turn
        added.limit = np.array(joint.limits or (-3.0, 3.0), dtype=np.float32)
        added.name = joint.name
        added.set_armature(np.array([joint.armature], dtype=np.float32))
        added.set_friction(0.0)
        stiffness, damping, force = joint.servo or (0.0, 0.0, 1e9)
        added.set_drive_properties(stiffness, damping + joint.damping, force, "force")
        self._drives[joint.name] = added


def _between(leader: Any, follower: Any, name: str) -> list[Any]:
    """The links from before a leading joint to the following one, both included."""
    links = [follower]
    while links[-1] != leader:
        if links[-1].parent is None:
            raise FungraspError(f"joint '{name}' follows one of another chain, which PhysX can't couple")
        links.append(links[-1].parent)
    return [leader.parent, *reversed(links)]


def _diagonal(value: float) -> tuple[Vector, ...]:
    return (value, 0.0, 0.0), (0.0, value, 0.0), (0.0, 0.0, value)


def _pose_of(sapien: Any, pose: Vector) -> Any:
    return sapien.Pose(np.array(pose[:3]), np.array(pose[3:]))


def _numbers(pose: Any) -> np.ndarray:
    return np.concatenate([pose.p, pose.q]).astype(float)
