"""A recorded episode in MuJoCo, built anew from its bundle: the control, which has to end as recorded."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from benchmarks.engines.bundle import EpisodeBundle, Vector
from fungrasp.objects.convex_decomposition import convex_hull
from fungrasp.simulation import SceneSettings

_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "convex": mujoco.mjtGeom.mjGEOM_MESH,
}


class MujocoWorld:
    """See ``benchmarks.engines.replay.EpisodeWorld``."""

    def __init__(self, bundle: EpisodeBundle):
        """bundle: of the episode."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        own, option = SceneSettings(), spec.option
        option.timestep, option.gravity = bundle.timestep, [0.0, 0.0, -bundle.gravity]
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, own.impratio
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.iterations, option.ls_iterations = own.iterations, 20
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
        self._contact = {"friction": [bundle.friction, bundle.torsional_friction, 1e-4], "condim": 4}
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name="table", type=plane, size=[0.75, 0.75, 0.05], **self._contact)
        spec.geom("table").pos = [0.0, 0.0, bundle.table_height]
        obj = spec.worldbody.add_body(name="object")
        obj.add_freejoint(name="object")
        obj.mass, obj.ipos = bundle.object_inertia.mass, bundle.object_inertia.center
        obj.fullinertia, obj.explicitinertial = _six(bundle.object_inertia.tensor), True
        for number, corners in enumerate(bundle.pieces):
            self._convex(spec, obj, f"object/{number}", corners, {})
        reference = bundle.wrist_reference
        base = spec.worldbody.add_body(name="", mocap=True, pos=reference[:3], quat=reference[3:])
        base.name = "wrist_reference"
        self._add_hand(spec, base, bundle)
        for first, second in bundle.apart:
            spec.add_exclude(bodyname1=first, bodyname2=second)
        for coupling in bundle.couplings:
            equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT)
            equality.name1, equality.name2 = coupling.follower, coupling.leader
            equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
            equality.data[:5] = [coupling.offset, coupling.ratio, 0.0, 0.0, 0.0]
            # As the hands' models have them: twice as stiff as a contact.
            equality.solref, equality.solimp = [0.01, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
        self._model = model = spec.compile()
        self._data = data = mujoco.MjData(model)
        self._servos = np.array([model.actuator(name).id for name in bundle.servos])
        for name, value in bundle.start.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        data.ctrl[self._servos] = bundle.told[0]
        first = int(model.joint("object").qposadr[0])
        self._place = slice(first, first + 7)
        data.qpos[self._place] = bundle.object_pose
        self._object, self._palm = model.body("object").id, model.body(bundle.palm).id
        self._owner = {model.body(body.name).id: body.name for body in bundle.bodies}
        mujoco.mj_forward(model, data)

    def tell(self, setpoints: np.ndarray) -> None:
        """Setpoints of the servos."""
        self._data.ctrl[self._servos] = setpoints

    def advance(self, duration: float) -> None:
        """Physics steps."""
        mujoco.mj_step(self._model, self._data, round(duration / self._model.opt.timestep))
        mujoco.mj_forward(self._model, self._data)

    def object_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return self._data.qpos[self._place].copy()

    def palm_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        return np.concatenate([self._data.xpos[self._palm], self._data.xquat[self._palm]])

    def touching(self) -> tuple[frozenset[str], bool]:
        """Bodies of the hand that touch the object, and whether the table does."""
        found, table = set(), False
        for contact in self._data.contact[: self._data.ncon]:
            pair = {int(self._model.geom_bodyid[g]) for g in (contact.geom1, contact.geom2)}
            if self._object in pair and len(pair) == 2:
                other = (pair - {self._object}).pop()
                table |= other == 0
                found |= {self._owner[other]} if other in self._owner else set()
        return frozenset(found), table

    def _add_hand(self, spec: mujoco.MjSpec, base: Any, bundle: EpisodeBundle) -> None:
        made = {"": base}
        for body in bundle.bodies:
            new = made[body.parent].add_body(name=body.name, pos=body.pose[:3], quat=body.pose[3:])
            new.mass, new.ipos, new.fullinertia = (
                body.inertia.mass,
                body.inertia.center,
                _six(body.inertia.tensor),
            )
            new.explicitinertial, new.gravcomp = True, 1.0
            made[body.name] = new
            for joint in body.joints:
                kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.slide else mujoco.mjtJoint.mjJNT_HINGE
                added = new.add_joint(name=joint.name, type=kind, axis=joint.axis, armature=joint.armature)
                added.frictionloss = joint.friction
                added.damping = [joint.damping, 0.0, 0.0] if np.ndim(added.damping) else joint.damping
                if joint.limits:
                    added.range, added.limited = joint.limits, True
                if joint.servo:
                    stiffness, damping, force = joint.servo
                    servo = spec.add_actuator(name=joint.name, target=joint.name)
                    servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
                    servo.set_to_position(kp=stiffness, kv=damping)
                    servo.forcelimited, servo.forcerange = True, [-force, force]
            for number, shape in enumerate(body.shapes):
                name = f"{body.name}/{number}"
                place = {"pos": shape.pose[:3], "quat": shape.pose[3:]}
                if shape.kind == "convex":
                    self._convex(spec, new, name, shape.vertices, place)
                else:
                    size = [*shape.size, 0.0, 0.0][:3]
                    kind = _TYPES[shape.kind]
                    new.add_geom(name=name, type=kind, size=size, mass=0.0, **place, **self._contact)

    def _convex(
        self, spec: mujoco.MjSpec, body: Any, name: str, corners: tuple[Vector, ...], place: dict[str, Any]
    ) -> None:
        hull = convex_hull(np.array(corners))
        mesh = spec.add_mesh(name=name)
        mesh.uservert, mesh.userface = hull.vertices.ravel().tolist(), hull.faces.ravel().tolist()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        body.add_geom(name=name, type=_TYPES["convex"], meshname=name, mass=0.0, **place, **self._contact)


def _six(tensor: tuple[Vector, ...]) -> list[float]:
    """Of a symmetric matrix: the diagonal, then xy, xz, yz."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    return [xx, yy, zz, xy, xz, yz]
