"""An episode in Drake: hydroelastic contact of compliant solids, and its "lagged" convex approximation."""

# The package may be missing, and its type stubs take arrays of one type alone.
# pyright: reportMissingImports=false, reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.engines.bundle import EpisodeBundle, Inertia, Shape

TIMESTEP = 0.004
"""[s]; the setpoint period is a multiple of it."""
MODULUS = {"hand": 1e7, "table": 1e8}
"""Hydroelastic modulus [Pa] of hand and object, and of the table: hard rubber, and ten times as hard."""
DISSIPATION = 10.0
"""Of Hunt and Crossley [s/m]."""
STICTION = 1e-4
"""Speed below which friction sticks [m/s]; a tenth of Drake's default, against creep."""
RESOLUTION = 0.006
"""Edge of the tetrahedra of rounded shapes [m]: a fingertip's radius."""


class DrakeWorld:
    """See ``benchmarks.engines.replay.EpisodeWorld``. Drake has no dry friction of joints."""

    def __init__(self, bundle: EpisodeBundle):
        """bundle: of the episode."""
        from pydrake.geometry import Box, Convex
        from pydrake.math import RigidTransform
        from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
        from pydrake.multibody.tree import PrismaticJoint
        from pydrake.systems.analysis import Simulator
        from pydrake.systems.framework import DiagramBuilder

        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=TIMESTEP,
            contact_model="hydroelastic_with_fallback",
            discrete_contact_approximation="lagged",
            stiction_tolerance=STICTION,
        )
        self._plant, self._scene = AddMultibodyPlant(config, builder)
        plant = self._plant
        below = RigidTransform([0.0, 0.0, bundle.table_height - 0.05])
        slab = Box(1.5, 1.5, 0.1)
        self._table = plant.RegisterCollisionGeometry(
            plant.world_body(), below, slab, "table", _material(bundle.friction, MODULUS["table"])
        )
        self._hand, loose = plant.AddModelInstance("hand"), plant.AddModelInstance("object")
        self._object = plant.AddRigidBody("object", loose, _inertia(bundle.object_inertia))
        soft = _material(bundle.friction, MODULUS["hand"])
        for number, corners in enumerate(bundle.pieces):
            solid = Convex(np.array(corners).T, f"piece{number}")
            plant.RegisterCollisionGeometry(self._object, RigidTransform(), solid, f"piece{number}", soft)
        self._bodies = self._add_hand(bundle, soft)
        for coupling in bundle.couplings:
            follower, leader = (plant.GetJointByName(n) for n in (coupling.follower, coupling.leader))
            plant.AddCouplerConstraint(follower, leader, coupling.ratio, coupling.offset)
        # MuJoCo makes the hand weightless, as a robot's arm does.
        plant.set_gravity_enabled(self._hand, False)
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -bundle.gravity])
        self._leave_apart(bundle)
        plant.Finalize()
        self._owner = {
            shape: name
            for name, body in self._bodies.items()
            for shape in plant.GetCollisionGeometriesForBody(body)
        }
        self._pieces = set(plant.GetCollisionGeometriesForBody(self._object))
        self._simulator = Simulator(builder.Build())
        self._context = plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        for name, value in bundle.start.items():
            joint = plant.GetJointByName(name)
            (joint.set_translation if isinstance(joint, PrismaticJoint) else joint.set_angle)(
                self._context, value
            )
        plant.SetFreeBodyPose(self._context, self._object, _transform(bundle.object_pose))
        order = [plant.get_joint_actuator(i).name() for i in plant.GetJointActuatorIndices(self._hand)]
        self._columns = np.array([bundle.servos.index(name) for name in order])
        self._port = plant.get_desired_state_input_port(self._hand)
        self._palm = self._bodies[bundle.palm]
        self.tell(bundle.told[0])
        self._simulator.Initialize()

    def tell(self, setpoints: np.ndarray) -> None:
        """Setpoints of the servos."""
        rest = np.zeros(len(self._columns))
        self._port.FixValue(self._context, np.concatenate([setpoints[self._columns], rest]))

    def advance(self, duration: float) -> None:
        """Physics steps."""
        self._simulator.AdvanceTo(self._simulator.get_context().get_time() + duration)

    def object_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return _pose(self._plant.EvalBodyPoseInWorld(self._context, self._object))

    def palm_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return _pose(self._plant.EvalBodyPoseInWorld(self._context, self._palm))

    def touching(self) -> tuple[frozenset[str], bool]:
        """Bodies of the hand that touch the object, and whether the table does."""
        results = self._plant.get_contact_results_output_port().Eval(self._context)
        surfaces = [
            results.hydroelastic_contact_info(i).contact_surface()
            for i in range(results.num_hydroelastic_contacts())
        ]
        points = [
            results.point_pair_contact_info(i).point_pair() for i in range(results.num_point_pair_contacts())
        ]
        pairs = [{s.id_M(), s.id_N()} for s in surfaces] + [{p.id_A, p.id_B} for p in points]
        others = {shape for pair in pairs if pair & self._pieces for shape in pair - self._pieces}
        found = frozenset(self._owner[shape] for shape in others if shape in self._owner)
        return found, self._table in others

    def _add_hand(self, bundle: EpisodeBundle, material: Any) -> dict[str, Any]:
        from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, PrismaticJoint, RevoluteJoint

        plant, made = self._plant, {}
        base = plant.AddFrame(
            FixedOffsetFrame("wrist_reference", plant.world_frame(), _transform(bundle.wrist_reference))
        )
        for body in bundle.bodies:
            made[body.name] = link = plant.AddRigidBody(body.name, self._hand, _inertia(body.inertia))
            parent = base if not body.parent else made[body.parent].body_frame()
            parent = plant.AddFrame(FixedOffsetFrame(f"{body.name}_in", parent, _transform(body.pose)))
            for number, joint in enumerate(body.joints):
                last = number == len(body.joints) - 1
                child = link if last else plant.AddRigidBody(f"{body.name}_{number}", self._hand, _between())
                low, high = joint.limits or (-np.inf, np.inf)
                kind = PrismaticJoint if joint.slide else RevoluteJoint
                added = plant.AddJoint(
                    kind(joint.name, parent, child.body_frame(), joint.axis, low, high, joint.damping)
                )
                if joint.servo:
                    stiffness, damping, force = joint.servo
                    servo = plant.AddJointActuator(joint.name, added, force)
                    servo.set_controller_gains(PdControllerGains(p=stiffness, d=damping))
                    servo.set_default_gear_ratio(1.0)
                    servo.set_default_rotor_inertia(joint.armature)
                parent = child.body_frame()
            if not body.joints:
                plant.WeldFrames(parent, link.body_frame())
            for number, shape in enumerate(body.shapes):
                name = f"{body.name}/{number}"
                plant.RegisterCollisionGeometry(link, _transform(shape.pose), _solid(shape), name, material)
        return made

    def _leave_apart(self, bundle: EpisodeBundle) -> None:
        """Pairs that do not collide, and bodies that are fixed to each other."""
        from pydrake.geometry import CollisionFilterDeclaration, GeometrySet

        shapes = {
            name: GeometrySet(self._plant.GetCollisionGeometriesForBody(body))
            for name, body in self._bodies.items()
        }
        joined = [(body.name, body.parent) for body in bundle.bodies if body.parent]
        for first, second in [*bundle.apart, *joined]:
            declaration = CollisionFilterDeclaration().ExcludeBetween(shapes[first], shapes[second])
            self._scene.collision_filter_manager().Apply(declaration)


def _material(friction: float, modulus: float) -> Any:
    from pydrake.geometry import AddCompliantHydroelasticProperties, AddContactMaterial, ProximityProperties
    from pydrake.multibody.plant import CoulombFriction

    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=DISSIPATION, friction=CoulombFriction(friction, friction), properties=properties
    )
    AddCompliantHydroelasticProperties(RESOLUTION, modulus, properties)
    return properties


def _inertia(inertia: Inertia) -> Any:
    from pydrake.multibody.tree import RotationalInertia, SpatialInertia

    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tensor
    about = RotationalInertia(xx, yy, zz, xy, xz, yz)
    return SpatialInertia.MakeFromCentralInertia(inertia.mass, np.array(inertia.center), about)


def _between() -> Any:
    """Of a body between two joints of one link: as light as the solver bears."""
    return _inertia(Inertia(1e-4, (0.0, 0.0, 0.0), ((1e-7, 0.0, 0.0), (0.0, 1e-7, 0.0), (0.0, 0.0, 1e-7))))


def _solid(shape: Shape) -> Any:
    from pydrake.geometry import Box, Capsule, Convex, Cylinder, Sphere

    size = shape.size
    if shape.kind == "box":
        return Box(*(2.0 * half for half in size))
    if shape.kind == "sphere":
        return Sphere(size[0])
    if shape.kind == "convex":
        return Convex(np.array(shape.vertices).T, "solid")
    return {"capsule": Capsule, "cylinder": Cylinder}[shape.kind](size[0], 2.0 * size[1])


def _transform(pose: tuple[float, ...]) -> Any:
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.math import RigidTransform, RotationMatrix

    turn = np.array(pose[3:]) / np.linalg.norm(pose[3:])
    return RigidTransform(RotationMatrix(Quaternion(turn)), np.array(pose[:3]))


def _pose(transform: Any) -> np.ndarray:
    return np.concatenate([transform.translation(), transform.rotation().ToQuaternion().wxyz()])
