"""The CPU engine: it keeps the contract of all engines, and MuJoCo's own fields agree with one another."""

from __future__ import annotations

import numpy as np
import pytest
from engine_contract import CAN, OBJECTS, EngineContract, contract_scene, pose, standing, still

from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.simulation import MujocoCpuEngine, Scene, build_scene


class TestMujocoCpuEngine(EngineContract):
    def make(self, scene: Scene, count: int, threads: int = 1) -> MujocoCpuEngine:
        return MujocoCpuEngine(scene, count, threads)


def test_settled_objects_weigh_what_they_weigh():
    scene, mass = contract_scene(), np.linspace(0.1, 1.2, len(OBJECTS))
    engine = MujocoCpuEngine(scene, len(OBJECTS))
    engine.set_parameters(object_index=np.arange(len(OBJECTS)), object_mass=mass)
    stood = standing(np.arange(len(OBJECTS)))
    stood[:, 2] += 0.002
    engine.set_state(object_pose=stood, wrist_frame=pose(len(OBJECTS), 0.0, 0.0, 1.0))
    engine.step(still(engine), 300)
    assert engine.object_on_table.all() and not engine.link_contacts.any()
    assert np.linalg.norm(engine.object_velocity[:, :3], axis=1).max() < 0.02
    column = scene.model.sensor("object/table").adr[0]
    force = np.linalg.norm(engine.batch.bind("sensordata")[:, column + 1 : column + 4], axis=1)
    np.testing.assert_allclose(force, 9.81 * mass, rtol=0.05)


def test_a_world_that_breaks_down_is_put_back_to_numbers(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    engine = MujocoCpuEngine(contract_scene(), 2)
    engine.set_parameters(object_index=np.full(2, CAN))
    engine.set_state(object_pose=standing(np.full(2, CAN)), wrist_frame=pose(2, 0.0, 0.0, 0.5))
    engine.batch.bind("qvel")[1] = 1e12
    engine.step(still(engine), 5)
    assert engine.diverged.tolist() == [False, True] and np.isfinite(engine.positions).all()


def test_coupled_joints_have_damping_of_their_own():
    """A hand with more joints than servos: factors are by joint and by servo."""
    scene = build_scene(load_hand("inspire"), {"can": builtin_object("can")})
    hand, model = scene.hand, scene.model
    assert (len(hand.joint_names), len(hand.actuators)) == (12, 6)
    rng = np.random.default_rng(0)
    damping = rng.uniform(0.5, 2.0, (1, 12))
    stiffness, servo_damping = rng.uniform(0.5, 2.0, (2, 1, 6))
    engine = MujocoCpuEngine(scene, 1)
    engine.set_parameters(joint_damping=damping, servo_stiffness=stiffness, servo_damping=servo_damping)
    for column, name in enumerate(hand.joint_names):
        dof = model.joint(f"hand/{name}").dofadr[0]
        factor = engine.batch.expand("dof_damping")[0, dof] / model.dof_damping[dof]
        assert factor == pytest.approx(damping[0, column])
    for column, name in enumerate(hand.actuators):
        servo = model.actuator(f"hand/{name}").id
        gain = engine.batch.expand("actuator_gainprm")[0, servo, 0] / model.actuator_gainprm[servo, 0]
        bias = engine.batch.expand("actuator_biasprm")[0, servo, :3]
        assert gain == pytest.approx(stiffness[0, column])
        assert bias[1] / model.actuator_biasprm[servo, 1] == pytest.approx(gain)
        assert bias[2] / model.actuator_biasprm[servo, 2] == pytest.approx(servo_damping[0, column])
