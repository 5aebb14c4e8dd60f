"""What every engine has to do, told through the door alone.

A test module of an engine subclasses ``EngineContract`` as ``Test...`` and says how the engine is made.
Fields of a particular engine are the business of its own tests.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, invert, relative, rotation_vector, transform_points
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, builtin_object
from fungrasp.simulation import Engine, Scene, build_scene

OBJECTS = ("mug", "box", "tennis_ball", "can", "scissors", "drill", "bowl")
"""Many pieces and one, center of mass at the origin and away from it."""
MUG, BOX, BALL, CAN, DRILL = 0, 1, 2, 3, 5
STEP = 0.005
"""Physics step of the scene [s]."""
HALF = np.sqrt(0.5)
UPSIDE_DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""Fingers of the Allegro hand point at the table."""
PALM_DOWN = np.array([HALF, 0.0, HALF, 0.0])
"""Its palm does; fingers point along the world's x axis."""


@cache
def contract_objects() -> dict[str, ObjectModel]:
    return {name: builtin_object(name) for name in OBJECTS}


@cache
def contract_scene() -> Scene:
    return build_scene(load_hand("allegro"), contract_objects())


def pose(count: int, *position: float, turn: np.ndarray | None = None) -> np.ndarray:
    """The same for all worlds, shape [W, 7]."""
    return np.tile([*position, *([1.0, 0.0, 0.0, 0.0] if turn is None else turn)], (count, 1))


def standing(index: np.ndarray) -> np.ndarray:
    """Poses of objects upright on the table, shape [W, 7]."""
    result = pose(len(index), 0.0, 0.0, 0.0)
    result[:, 2] = [-contract_objects()[OBJECTS[i]].vertices[:, 2].min() for i in index]
    return result


def leaning_box(count: int) -> np.ndarray:
    """Poses of the box on its lower edge, a little beyond where it would balance."""
    half = 0.5 * contract_objects()["box"].size
    lean = np.arctan2(half[0], half[2]) + 0.15
    height = half[2] * np.cos(lean) + half[0] * np.sin(lean)
    return pose(count, 0.3, 0.0, height, turn=np.array([np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0]))


def random_poses(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=rng).as_quat(scalar_first=True)
    return np.concatenate([rng.normal(size=(count, 3)), turns], axis=1)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between orientations [rad]."""
    return 2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))


def still(engine: Engine, fingers: np.ndarray | float | None = None) -> np.ndarray:
    """Controls under which the palm stays in the wrist's frame."""
    servos = len(engine.scene.hand.actuators)
    if fingers is None:
        fingers = engine.scene.hand.independent(engine.joint_positions)
    targets = np.broadcast_to(fingers, (len(engine), servos))
    return engine.controls(engine.wrist_frame, np.zeros((len(engine), 3)), targets)


class EngineContract:
    """Tests of one engine."""

    readback = 1e-9
    """How well what is written is read back [m, rad]."""
    turned = 1e-6
    """How well an orientation is read back [rad]: of the angle between two, which doubles the digits lost."""
    alone = 1e-10
    """How far a world among others may differ from one by itself [m, rad]."""
    alike = 1e-7
    """How far an object may differ from the same one that is described in another way [m, rad]."""
    together: int | None = None
    """Samples of a path in contact over which what differs by rounding stays together; None for all."""
    apart: tuple[int, ...] = ()
    """Objects in which the fingers begin centimeters deep, where the order of contacts decides how they are
    pushed out, and an engine that stops at a tolerance may differ."""

    def make(self, scene: Scene, count: int, threads: int = 1) -> Engine:
        """An engine with so many worlds."""
        raise NotImplementedError

    def ready(self, index: np.ndarray | list[int], threads: int = 1, height: float = 0.5) -> Engine:
        """Objects that stand on the table, the hand above, pointing down."""
        index = np.asarray(index)
        engine = self.make(contract_scene(), len(index), threads)
        engine.set_parameters(object_index=index)
        engine.reset()
        engine.set_state(
            object_pose=standing(index),
            wrist_frame=pose(len(index), 0.0, 0.0, height, turn=UPSIDE_DOWN),
            joint_positions=np.full((len(index), 16), 0.3),
        )
        return engine

    def collide(
        self, engine: Engine, seeds: np.ndarray, calls: int = 30, stood: np.ndarray | None = None
    ) -> np.ndarray:
        """The hand comes down on the objects while its fingers move at random; positions along the way.
        stood: where the objects stand, if they are not those of the contract's scene."""
        count = len(engine)
        raised = standing(engine.object_index) if stood is None else stood.copy()
        raised[:, 2] += 0.02
        start = pose(count, 0.0, 0.0, 0.12, turn=UPSIDE_DOWN)
        engine.reset()
        engine.set_state(object_pose=raised, wrist_frame=start, joint_positions=np.zeros((count, 16)))
        random, path = [np.random.default_rng(seed) for seed in seeds], []
        for i in range(calls):
            goal = start.copy()
            goal[:, 2] -= 0.004 * (i + 1)
            fingers = np.stack([rng.uniform(0.0, 1.2, 16) for rng in random])
            engine.step(engine.controls(goal, np.zeros((count, 3)), fingers), 5)
            path.append(engine.positions)
        return np.array(path)

    # State

    def test_what_is_written_is_read(self):
        engine = self.make(contract_scene(), 4)
        obj, frame, palm = (random_poses(seed, 4) for seed in range(3))
        palm[:, :3] = frame[:, :3] + 0.1
        palm[:, 3:] = compose(frame, pose(4, 0, 0, 0, turn=np.array([0.8, 0.6, 0, 0])))[:, 3:]
        joints = np.random.default_rng(3).uniform(0, 1, (4, 16))
        engine.set_state(object_pose=obj, wrist_frame=frame, palm_pose=palm, joint_positions=joints)
        for seen, written in ((engine.object_pose, obj), (engine.palm_pose, palm)):
            np.testing.assert_allclose(seen[:, :3], written[:, :3], atol=self.readback)
            np.testing.assert_allclose(angle(seen[:, 3:], written[:, 3:]), 0, atol=self.turned)
        np.testing.assert_allclose(engine.wrist_frame, frame, atol=self.readback)
        np.testing.assert_allclose(engine.joint_positions, joints, atol=self.readback)
        centers = np.tile(contract_objects()[OBJECTS[0]].center_of_mass, (4, 1))
        center = transform_points(obj, centers[:, None])[:, 0]
        np.testing.assert_allclose(engine.center_of_mass, center, atol=self.turned)
        np.testing.assert_allclose(engine.object_velocity, 0, atol=self.readback)
        assert engine.positions.shape == (4, contract_scene().model.nq)
        links = len(contract_scene().hand.links)
        for name in ("link_contacts", "link_forces", "table_forces"):
            assert getattr(engine, name).shape == (4, links), name
        for name in ("self_force", "object_on_table", "diverged"):
            assert getattr(engine, name).shape == (4,), name

    def test_the_palm_goes_to_the_wrists_frame_unless_told_where(self):
        engine = self.make(contract_scene(), 3)
        frame = random_poses(0, 3)
        engine.set_state(wrist_frame=frame)
        np.testing.assert_allclose(engine.palm_pose[:, :3], frame[:, :3], atol=self.readback)
        np.testing.assert_allclose(angle(engine.palm_pose[:, 3:], frame[:, 3:]), 0, atol=self.turned)
        there = compose(frame, pose(3, 0.1, 0.2, -0.1))
        engine.set_state(palm_pose=there)
        np.testing.assert_allclose(engine.palm_pose[:, :3], there[:, :3], atol=self.readback)
        np.testing.assert_allclose(engine.wrist_frame, frame, atol=self.readback)

    def test_what_is_not_given_stays_where_it_is(self):
        engine = self.ready([CAN, MUG])
        before = engine.object_pose, engine.palm_pose, engine.joint_positions
        engine.set_state(np.array([1]), joint_positions=np.full((1, 16), 0.5))
        np.testing.assert_array_equal(engine.object_pose, before[0])
        np.testing.assert_array_equal(engine.palm_pose, before[1])
        np.testing.assert_array_equal(engine.joint_positions[0], before[2][0])
        np.testing.assert_allclose(engine.joint_positions[1], 0.5, atol=self.readback)

    def test_things_are_put_down_at_rest(self):
        engine = self.ready([CAN])
        high = pose(1, 0.5, 0.0, 1.0)
        engine.set_state(object_pose=high)
        engine.step(still(engine), 40)
        assert engine.object_velocity[0, 2] < -1.0
        engine.set_state(object_pose=high)
        np.testing.assert_array_equal(engine.object_velocity, 0.0)
        engine.step(still(engine), 1)
        assert engine.object_velocity[0, 2] == pytest.approx(-9.81 * STEP, rel=1e-3)

    def test_a_palm_velocity_is_in_the_world(self):
        engine = self.ready([CAN, CAN], height=1.0)
        velocity = np.array([[0.1, -0.05, 0.08], [0.0, 0.0, 0.0]])
        engine.set_state(palm_velocity=velocity)
        start, fingers = engine.palm_pose, np.full((2, 16), 0.3)
        for i in range(20):
            goal = start.copy()
            goal[:, :3] += STEP * (i + 1) * velocity
            engine.step(engine.controls(goal, velocity, fingers), 1)
        moved = (engine.palm_pose - start)[:, :3]
        np.testing.assert_allclose(moved, 20 * STEP * velocity, atol=5e-4)

    def test_velocities_are_those_of_the_motion_in_the_world(self):
        """Boxes that tip over, each towards another side."""
        engine = self.ready([BOX, BOX])
        yaw = compose(pose(2, 0.4, 0.3, 0.0), pose(2, 0, 0, 0, turn=np.array([0.8, 0.0, 0.0, 0.6])))
        yaw[1, 3:] = [0.0, 0.0, 0.0, 1.0]
        engine.set_state(object_pose=compose(yaw, leaning_box(2)))
        controls = still(engine)
        engine.step(controls, 60)
        before = engine.object_pose
        engine.step(controls, 1)
        after, seen = engine.object_pose, engine.object_velocity
        np.testing.assert_allclose((after - before)[:, :3] / STEP, seen[:, :3], atol=1e-3)
        turns = [Rotation.from_quat(p[:, 3:], scalar_first=True) for p in (before, after)]
        spin = (turns[1] * turns[0].inv()).as_rotvec() / STEP
        assert (np.linalg.norm(spin, axis=1) > 1.0).all() and (np.abs(spin[0] - spin[1]).max() > 1.0)
        np.testing.assert_allclose(seen[:, 3:], spin, atol=1e-3)

    def test_readings_are_copies(self):
        engine = self.ready([CAN])
        for name in [
            "object_pose",
            "object_velocity",
            "center_of_mass",
            "palm_pose",
            "joint_positions",
            "link_contacts",
            "link_forces",
            "table_forces",
            "self_force",
            "object_on_table",
            "diverged",
            "positions",
            "wrist_frame",
        ]:
            before = getattr(engine, name)
            kept = before.copy()
            before[:] = 1
            np.testing.assert_array_equal(getattr(engine, name), kept, err_msg=name)

    def test_a_reset_world_is_as_new_and_the_others_stay(self):
        engine, fresh = self.ready([CAN, CAN]), self.ready([CAN, CAN])
        fresh.reset()
        engine.step(still(engine), 10)
        before = engine.positions
        engine.reset(np.array([1]))
        np.testing.assert_array_equal(engine.positions[0], before[0])
        np.testing.assert_array_equal(engine.positions[1], fresh.positions[1])
        np.testing.assert_array_equal(engine.wrist_frame[1], fresh.wrist_frame[1])

    # Stepping

    def test_set_points_that_stay_are_reached(self):
        engine = self.ready([CAN, MUG], height=0.6)
        goal = compose(engine.wrist_frame, pose(2, 0.05, -0.03, 0.04, turn=np.array([0.99, 0.1, 0.1, 0.0])))
        goal[:, 3:] /= np.linalg.norm(goal[:, 3:], axis=1, keepdims=True)
        low, high = engine.scene.servo_limits.T
        fingers = np.tile(0.5 * (low + high), (2, 1))
        engine.step(engine.controls(goal, np.zeros((2, 3)), fingers), 400)
        np.testing.assert_allclose(engine.palm_pose[:, :3], goal[:, :3], atol=1e-3)
        np.testing.assert_allclose(angle(engine.palm_pose[:, 3:], goal[:, 3:]), 0, atol=5e-3)
        np.testing.assert_allclose(engine.scene.hand.independent(engine.joint_positions), fingers, atol=0.02)

    @pytest.mark.parametrize("factor", [1.0, 0.5])
    def test_a_moving_set_point_does_not_trail(self, factor):
        """In a turned frame, and with softer servos."""
        engine = self.make(contract_scene(), 1)
        engine.set_parameters(wrist_stiffness=np.array([factor]))
        start = pose(1, 0.0, 0.0, 0.8, turn=np.array([0.5, 0.5, 0.5, 0.5]))
        engine.set_state(object_pose=pose(1, 0.6, 0.6, 0.5), wrist_frame=start)
        velocity, fingers = np.array([[0.06, -0.08, 0.02]]), np.full((1, 16), 0.3)
        for i in range(200):
            goal = start.copy()
            goal[:, :3] += STEP * (i + 1) * velocity
            engine.step(engine.controls(goal, velocity, fingers), 1)
        moved = (engine.palm_pose - start)[:, :3]
        np.testing.assert_allclose(moved, 200 * STEP * velocity, atol=1.5e-3)

    def test_controls_of_many_set_points_are_those_of_each(self):
        engine = self.ready([CAN, MUG])
        palm = np.stack([compose(engine.wrist_frame, pose(2, 0.01 * i, 0, 0)) for i in range(3)])
        velocity, fingers = np.ones((3, 2, 3)), np.random.default_rng(0).random((3, 2, 16))
        together = engine.controls(palm, velocity, fingers)
        assert together.shape == (3, 2, 22)
        for i in range(3):
            one = engine.controls(palm[i], velocity[i], fingers[i])
            np.testing.assert_allclose(together[i], one, atol=1e-12)

    def test_a_world_among_others_moves_as_one_by_itself(self):
        index = np.array([3, 0, 5, 1, 2, 4, 0])
        mass = np.array([0.3, 0.2, 1.1, 0.05, 0.058, 0.04, 0.4])
        friction = np.array([0.9, 0.4, 0.9, 0.7, 0.9, 1.2, 0.9])
        together = self.make(contract_scene(), 7, threads=2)
        together.set_parameters(object_index=index, object_mass=mass, friction=friction)
        path = self.collide(together, np.arange(7))
        assert np.isfinite(path[-1]).all()
        assert (np.abs(path[-1] - path[0]).max(axis=1) > 0.01).all()
        for world, kind in enumerate(index):
            if kind in self.apart:
                continue
            name = OBJECTS[kind]
            engine = self.make(build_scene(load_hand("allegro"), {name: contract_objects()[name]}), 1)
            engine.set_parameters(object_mass=mass[[world]], friction=friction[[world]])
            one = self.collide(engine, np.array([world]), stood=standing(np.array([kind])))
            np.testing.assert_allclose(path[:, world], one[:, 0], rtol=0, atol=self.alone, err_msg=name)

    def test_threads_do_not_matter(self):
        one, other = (self.collide(self.ready(range(6), n), np.arange(6), 12) for n in (1, 3))
        np.testing.assert_array_equal(one, other)

    def test_stepping_some_worlds_leaves_the_others(self):
        engine = self.ready([CAN, CAN, CAN])
        engine.set_state(object_pose=pose(3, 0.3, 0.0, 0.5))
        before = engine.positions
        engine.step(still(engine), 10, np.array([1]))
        np.testing.assert_array_equal(engine.positions[[0, 2]], before[[0, 2]])
        assert engine.object_pose[1, 2] < 0.499

    def test_physics_goes_on_from_a_snapshot_to_the_last_bit(self):
        engine = self.ready([MUG, CAN, BALL])
        self.collide(engine, np.arange(3), 20)
        state, controls = engine.get_state(), still(engine, 0.8)
        names = ("positions", "object_velocity", "center_of_mass", "palm_pose", "wrist_frame")
        seen = {name: getattr(engine, name) for name in names}
        assert engine.link_contacts.any()
        paths = []
        for _ in range(2):
            engine.restore(state)
            for name, value in seen.items():
                np.testing.assert_array_equal(getattr(engine, name), value, err_msg=name)
            path = []
            for _ in range(10):
                engine.step(controls, 4)
                path += [engine.positions, engine.link_forces]
            paths.append(path)
            engine.set_state(object_pose=pose(3, 0.5, 0.5, 0.5), wrist_frame=pose(3, 0.0, 0.0, 0.7))
            engine.step(controls, 10)
        for a, b in zip(*paths, strict=True):
            np.testing.assert_array_equal(a, b)

    def test_a_world_that_breaks_down_is_known_until_it_is_reset(self, monkeypatch, tmp_path):
        # MuJoCo writes a log where it is.
        monkeypatch.chdir(tmp_path)
        engine = self.ready([CAN, CAN, CAN])
        engine.step(still(engine), 5)
        assert not engine.diverged.any()
        bad = still(engine)
        bad[1, 0] = np.nan
        engine.step(bad, 5)
        np.testing.assert_array_equal(engine.diverged, [False, True, False])
        engine.step(still(engine, 0.3), 5)
        engine.reset(np.array([0]))
        np.testing.assert_array_equal(engine.diverged, [False, True, False])
        engine.reset(np.array([1]))
        engine.set_state(wrist_frame=pose(3, 0.0, 0.0, 0.5, turn=UPSIDE_DOWN))
        engine.step(still(engine, 0.3), 5)
        assert not engine.diverged.any()

    def test_a_velocity_beyond_all_bounds_breaks_a_world(self, monkeypatch, tmp_path):
        monkeypatch.chdir(tmp_path)
        engine = self.ready([CAN, CAN])
        engine.set_state(np.array([0]), palm_velocity=np.full((1, 3), 1e12))
        engine.step(still(engine, 0.3), 5)
        np.testing.assert_array_equal(engine.diverged, [True, False])

    # Contacts

    def test_contacts_of_a_ball_on_a_finger_on_the_table_and_in_the_air(self):
        engine = self.ready([BALL] * 3)
        hand = engine.scene.hand
        link = hand.link_names.index("middle_proximal")
        points = HandKinematics(hand, 3).keypoints(engine.palm_pose, engine.joint_positions)
        place = pose(3, 0.0, 0.0, 0.033)
        at = hand.keypoint_names.index(hand.links[link][0])
        place[0, :3] = points[0, at] - [0.0, 0.0, 0.02]
        place[2, :3] = [0.4, 0.0, 0.3]
        engine.set_state(object_pose=place)
        engine.step(still(engine), 1)
        assert engine.link_contacts[0, link] and not engine.object_on_table[0]
        assert not engine.link_contacts[1].any() and engine.object_on_table[1]
        assert not engine.link_contacts[2].any() and not engine.object_on_table[2]
        forces = engine.link_forces
        assert forces[0, link] > 0.1 and not forces[1:].any()
        assert not engine.table_forces.any()

    def test_contacts_are_those_of_the_last_step_until_a_reset(self):
        engine = self.ready([BALL, BALL, BALL])
        assert not engine.object_on_table.any()
        engine.step(still(engine), 20)
        assert engine.object_on_table.all()
        engine.set_state(object_pose=pose(3, 0.4, 0.0, 0.3))
        assert engine.object_on_table.all()
        engine.reset(np.array([1]))
        assert engine.object_on_table.tolist() == [True, False, True]
        engine.set_state(object_pose=pose(3, 0.4, 0.0, 0.3))
        engine.step(still(engine), 1)
        assert not engine.object_on_table.any()

    def test_fingers_that_touch_each_other_are_felt(self):
        engine = self.ready([CAN])
        engine.set_state(object_pose=pose(1, 0.6, 0.0, 0.06))
        assert engine.self_force[0] == 0.0
        fist = np.tile(engine.scene.servo_limits[:, 1], (1, 1))
        engine.step(still(engine, fist), 300)
        assert engine.self_force[0] > 0.1
        assert not engine.link_contacts.any() and not engine.link_forces.any()

    # Parameters

    def test_an_object_weighs_what_it_is_told_to(self):
        """Pulled upwards; one has its own mass, the others another."""
        engine = self.ready([CAN, CAN, BOX])
        engine.set_parameters(np.array([1, 2]), object_mass=np.array([0.8, 2.5]))
        own = contract_objects()["can"].mass
        mass = np.array([own, 0.8, 2.5])
        engine.set_state(object_pose=pose(3, 0.5, 0.0, 0.5))
        force = np.array([[0.0, 0.0, 20.0]] * 3)
        engine.push_object(force)
        engine.step(still(engine), 20)
        np.testing.assert_allclose(engine.object_velocity[:, 2], 0.1 * (20.0 / mass - 9.81), rtol=1e-3)
        np.testing.assert_allclose(engine.object_velocity[:, [0, 1, 3, 4, 5]], 0, atol=1e-6)

    def test_a_torque_turns_the_object_about_its_center_of_mass(self):
        engine = self.ready([CAN])
        engine.set_state(object_pose=pose(1, 0.5, 0.0, 0.5))
        center = engine.center_of_mass
        weight = np.array([[0.0, 0.0, 9.81 * contract_objects()["can"].mass]])
        engine.push_object(weight, np.array([[0.0, 0.0, 1e-3]]))
        engine.step(still(engine), 20)
        spin = 0.1 * 1e-3 / contract_objects()["can"].inertia[2, 2]
        np.testing.assert_allclose(engine.object_velocity[0, 5], spin, rtol=1e-2)
        np.testing.assert_allclose(engine.center_of_mass, center, atol=1e-5)
        engine.push_object(weight)
        before = engine.object_velocity[0, 5]
        engine.step(still(engine), 20)
        np.testing.assert_allclose(engine.object_velocity[0, 5], before, rtol=1e-2)

    def test_bodies_fall_alike_and_tip_over_alike_whatever_they_weigh(self):
        """As inertia scales along with mass, heavy and light boxes tip over in the same time."""
        engine = self.ready([BOX] * 3)
        engine.set_parameters(object_mass=np.array([0.1, 0.5, 4.0]))
        engine.set_state(object_pose=pose(3, 0.5, 0.0, 1.0))
        engine.step(still(engine), 60)
        fallen = 1.0 - engine.object_pose[:, 2]
        np.testing.assert_allclose(fallen, 0.5 * 9.81 * (60 * STEP) ** 2, rtol=0.02)
        engine.set_state(object_pose=leaning_box(3))
        controls, times = still(engine), np.full(3, np.nan)
        for i in range(200):
            engine.step(controls, 1)
            flat = angle(engine.object_pose[:, 3:], pose(3, 0, 0, 0, turn=PALM_DOWN)[:, 3:]) < 0.2
            times = np.where(np.isnan(times) & flat, STEP * i, times)
        assert times.min() > 0.2 and times.max() - times.min() <= 2.1 * STEP, times

    def test_a_mass_is_that_of_an_object_of_this_mass(self):
        hand, light, heavy = load_hand("allegro"), builtin_object("mug", 0.2), builtin_object("mug", 0.7)
        scaled = self.make(build_scene(hand, {"mug": light}), 1)
        scaled.set_parameters(object_mass=np.array([0.7]))
        own = self.make(build_scene(hand, {"mug": heavy}), 1)
        stood = standing(np.array([MUG]))
        one, other = (self.collide(engine, np.arange(1), stood=stood) for engine in (scaled, own))
        np.testing.assert_allclose(one[20], other[20], rtol=0, atol=self.alike)

    def test_a_world_that_is_given_another_object_moves_as_a_fresh_one(self):
        index, mass = np.array([3, 1, 5]), np.array([0.3, 0.2, 1.1])
        friction = np.array([0.5, 0.9, 0.7])
        used = self.make(contract_scene(), 3)
        used.set_parameters(
            object_index=np.array([0, 1, 2]),
            object_mass=np.array([0.9, 0.2, 0.4]),
            friction=np.array([1.2, 0.9, 0.3]),
            table_height=np.array([0.1, 0.0, -0.1]),
        )
        some = np.array([0, 2])
        used.set_parameters(
            some,
            object_mass=np.array([0.9, 0.4]),
            object_center=np.full((2, 3), 0.02),
            object_inertia=np.tile(1e-3 * np.eye(3), (2, 1, 1)),
        )
        self.collide(used, np.arange(3), 4)
        used.set_parameters(some, object_index=index[some], object_mass=mass[some], friction=friction[some])
        assert used.object_index.tolist() == index.tolist()
        fresh = self.make(contract_scene(), 3)
        fresh.set_parameters(object_index=index, object_mass=mass, friction=friction)
        np.testing.assert_array_equal(*(self.collide(e, np.arange(3), 12) for e in (used, fresh)))

    @pytest.mark.parametrize("names", [OBJECTS, ("can",)])
    def test_mass_and_table_are_the_scenes_again_with_another_object(self, names):
        """Also in a scene of one object."""
        scene = build_scene(load_hand("allegro"), {name: contract_objects()[name] for name in names})
        index = np.full(2, names.index("can"))
        used, fresh = self.make(scene, 2), self.make(scene, 2)
        for engine in (used, fresh):
            engine.set_parameters(object_index=index)
        used.set_parameters(object_mass=np.array([1.7, 1.7]), table_height=np.array([0.2, 0.2]))
        used.set_parameters(np.array([1]), object_index=index[1:])
        for engine in (used, fresh):
            engine.reset()
            stood = standing(np.array([CAN, CAN]))
            engine.set_state(object_pose=stood, wrist_frame=pose(2, 0, 0, 0.8, turn=UPSIDE_DOWN))
            engine.push_object(np.array([[0.0, 0.0, 5.0]] * 2))
            engine.step(still(engine), 50)
        np.testing.assert_array_equal(used.positions[1], fresh.positions[1])
        assert np.abs(used.positions[0] - fresh.positions[0]).max() > 0.05

    def test_friction_decides_what_slides(self):
        """Cans that are pushed by a quarter of their weight."""
        engine = self.ready([CAN, CAN], height=1.0)
        engine.set_parameters(friction=np.array([0.15, 0.35]))
        engine.step(still(engine), 50)
        before = engine.object_pose
        engine.push_object(np.tile([0.25 * 9.81 * contract_objects()["can"].mass, 0.0, 0.0], (2, 1)))
        engine.step(still(engine), 100)
        slid = np.linalg.norm((engine.object_pose - before)[:, :2], axis=1)
        assert slid[0] > 0.1 and slid[1] < 0.005

    def test_the_table_carries_the_object_at_its_height(self):
        heights = np.array([0.0, 0.03, -0.03])
        engine = self.ready([CAN] * 3, height=0.8)
        engine.set_parameters(table_height=heights)
        stood = standing(engine.object_index)
        stood[:, 2] += heights + 0.01
        engine.set_state(object_pose=stood)
        engine.step(still(engine), 200)
        np.testing.assert_allclose(engine.object_pose[:, 2] - engine.object_pose[0, 2], heights, atol=1e-3)
        assert engine.object_on_table.all()
        np.testing.assert_allclose(engine.object_velocity, 0, atol=0.02)

    def test_a_tilted_table_carries_the_object_leaning_and_a_slippery_one_lets_it_go(self):
        """About the world's y axis by 0.1 rad: downhill is +x, and the top is lower there."""
        engine = self.ready([BOX, BOX, BOX], height=0.8)
        tilt = np.array([[0.0, 0.0], [0.0, 0.1], [0.0, 0.1]])
        engine.set_parameters(table_tilt=tilt, friction=np.array([0.9, 0.9, 0.02]))
        stood = standing(engine.object_index)
        stood[:, 0], stood[:, 2] = 0.2, stood[:, 2] + 0.003
        engine.set_state(object_pose=stood)
        engine.step(still(engine), 120)
        seen = engine.object_pose
        np.testing.assert_allclose(angle(seen[:2, 3:], stood[:2, 3:]), [0.0, 0.1], atol=0.01)
        assert seen[1, 2] - seen[0, 2] == pytest.approx(-0.2 * np.tan(0.1), abs=4e-3)
        moved = seen[:, 0] - seen[0, 0]
        assert abs(moved[1]) < 0.015 and moved[2] > 0.05

    def test_a_given_mass_distribution_is_that_of_an_object_that_has_it(self):
        """A can whose own fields are given by hand, with another mass."""
        can = contract_objects()["can"]
        told, own = self.ready([CAN]), self.ready([CAN])
        mass = np.array([0.7])
        told.set_parameters(
            object_mass=mass,
            object_center=can.center_of_mass[None],
            object_inertia=(0.7 / can.mass * can.inertia)[None],
        )
        own.set_parameters(object_mass=mass)
        one, other = (self.collide(engine, np.arange(1), 20) for engine in (told, own))
        some = slice(self.together)
        np.testing.assert_allclose(one[some], other[some], rtol=0, atol=10 * self.alike)

    def test_an_object_turns_about_the_center_of_mass_that_it_is_given(self):
        """Pushed at that center, in free fall: it does not turn, and the center is where it was said."""
        engine = self.ready([BOX, DRILL])
        centers = np.array([[0.02, -0.01, 0.03], [-0.02, 0.03, 0.0]])
        inertia = np.diag([1e-3, 2e-3, 2.5e-3]) + 2e-4 * (np.ones((3, 3)) - np.eye(3))
        engine.set_parameters(
            object_mass=np.full(2, 0.5), object_center=centers, object_inertia=np.tile(inertia, (2, 1, 1))
        )
        place = random_poses(0, 2)
        place[:, :3] = [[0.6, 0.0, 1.0], [0.6, 0.2, 1.0]]
        engine.set_state(object_pose=place)
        expected = transform_points(place, centers[:, None])[:, 0]
        np.testing.assert_allclose(engine.center_of_mass, expected, atol=self.readback)
        engine.push_object(np.tile([3.0, 0.0, 9.81 * 0.5], (2, 1)))
        engine.step(still(engine), 20)
        np.testing.assert_allclose(engine.object_velocity[:, 3:], 0.0, atol=1e-6)
        np.testing.assert_allclose(engine.center_of_mass[:, 0] - expected[:, 0], 0.03, rtol=0.1)

    def test_an_object_stays_where_it_stands_when_it_is_given_another_center_of_mass(self):
        """Its shape stays with its body, whichever of their frames the engine had found to coincide."""
        index = np.arange(len(OBJECTS))
        index = index[index != BALL]
        engine = self.ready(index)
        models = [contract_objects()[OBJECTS[i]] for i in index]
        lowest = np.array([model.size[2] for model in models]) * 0.02
        engine.set_parameters(
            object_mass=np.array([model.mass for model in models]),
            object_center=np.array([model.center_of_mass for model in models]) - [0, 0, 1] * lowest[:, None],
            object_inertia=np.array([model.inertia for model in models]),
        )
        before = standing(index)
        engine.set_state(object_pose=before)
        engine.step(still(engine), 100)
        # A few millimeters onto the table, and no jump.
        assert np.linalg.norm(engine.object_pose[:, :3] - before[:, :3], axis=1).max() < 0.005

    def test_a_top_heavy_box_tips_where_another_stands(self):
        """Leaning within its base: it falls over only with the center of mass beyond the edge."""
        engine = self.ready([BOX, BOX])
        half, box = 0.5 * contract_objects()["box"].size, contract_objects()["box"]
        lean = 0.5 * np.arctan2(half[0], half[2])
        height = half[2] * np.cos(lean) + half[0] * np.sin(lean)
        turn = np.array([np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0])
        shift = np.array([[0.0, 0.0, 0.0], [0.9 * half[0], 0.0, 0.0]])
        engine.set_parameters(
            object_mass=np.full(2, box.mass),
            object_center=box.center_of_mass + shift,
            object_inertia=np.tile(box.inertia, (2, 1, 1)),
        )
        engine.set_state(object_pose=pose(2, 0.3, 0.0, height, turn=turn))
        engine.step(still(engine), 300)
        fallen = angle(engine.object_pose[:, 3:], pose(2, 0, 0, 0)[:, 3:])
        assert fallen[0] < 0.1 and fallen[1] > 1.0

    def test_dry_friction_takes_from_the_torque_of_the_joint_it_belongs_to(self):
        """A joint with more friction than its servo's torque hardly moves, and only until it is taken back.
        Soft constraints let it creep."""
        engine = self.ready([CAN, CAN], height=0.8)
        joint = 5
        friction = np.zeros((2, 16))
        friction[1, joint] = 0.3 * list(engine.scene.hand.actuators.values())[joint].kp
        engine.set_parameters(joint_friction=friction)
        start = engine.joint_positions
        engine.step(still(engine, 0.5), 20)
        moved = engine.joint_positions - start
        assert moved[0, joint] > 0.1 > 0.05 > moved[1, joint] >= 0.0
        others = np.delete(np.arange(16), joint)
        np.testing.assert_allclose(moved[1, others], moved[0, others], rtol=0.2)
        engine.set_parameters(joint_friction=np.zeros((2, 16)))
        engine.set_state(joint_positions=start)
        engine.step(still(engine, 0.5), 20)
        np.testing.assert_allclose(engine.joint_positions[1], engine.joint_positions[0], atol=1e-3)

    def test_parameters_of_some_worlds_leave_the_others(self):
        plain, mixed = self.ready([CAN] * 4), self.ready([CAN] * 4)
        rng = np.random.default_rng(0)
        mixed.set_parameters(
            np.array([1, 3]),
            object_mass=np.array([0.7, 0.2]),
            friction=np.array([0.3, 0.4]),
            table_height=np.array([-0.02, -0.01]),
            table_tilt=np.array([[0.01, 0.0], [0.0, 0.02]]),
            object_center=np.array([[0.01, 0.0, 0.06], [0.0, 0.01, 0.05]]),
            object_inertia=np.tile(2e-4 * np.eye(3), (2, 1, 1)),
            joint_friction=rng.uniform(0, 0.05, (2, 16)),
            joint_damping=rng.uniform(0.5, 2, (2, 16)),
            servo_stiffness=rng.uniform(0.5, 2, (2, 16)),
            servo_damping=rng.uniform(0.5, 2, (2, 16)),
            wrist_stiffness=np.array([0.5, 2.0]),
        )
        for engine in (plain, mixed):
            goal = compose(engine.wrist_frame, pose(4, 0.0, 0.0, 0.05))
            engine.step(engine.controls(goal, np.zeros((4, 3)), np.full((4, 16), 0.5)), 20)
        np.testing.assert_array_equal(plain.positions[[0, 2]], mixed.positions[[0, 2]])
        assert (np.abs(plain.positions - mixed.positions)[[1, 3]].max(axis=1) > 1e-4).all()

    def test_factors_do_not_compound_and_the_last_counts(self):
        once, often = self.ready([CAN]), self.ready([CAN])
        names = ("joint_damping", "servo_stiffness", "servo_damping")
        last = {name: np.full((1, 16), 0.7) for name in names} | {"wrist_stiffness": np.array([0.7])}
        once.set_parameters(**last)
        for factors in ({name: 3.0 * value for name, value in last.items()}, last, last):
            often.set_parameters(**factors)
        plain, again = self.ready([CAN]), self.ready([CAN])
        again.set_parameters(**last)
        again.set_parameters(**{name: np.ones_like(value) for name, value in last.items()})
        for pair in ((once, often), (plain, again)):
            for engine in pair:
                goal = compose(engine.wrist_frame, pose(1, 0.0, 0.0, 0.05))
                engine.step(engine.controls(goal, np.zeros((1, 3)), np.full((1, 16), 0.6)), 20)
            np.testing.assert_array_equal(pair[0].positions, pair[1].positions)
        assert np.abs(plain.positions - once.positions).max() > 1e-3

    @pytest.mark.parametrize("what", ["joint_damping", "servo_damping"])
    def test_heavier_damping_slows_the_joint_it_belongs_to(self, what):
        engine = self.ready([CAN, CAN], height=0.8)
        factor = np.ones((1, 16))
        factor[0, 5] = 8.0
        engine.set_parameters(np.array([1]), **{what: factor})
        start = engine.joint_positions
        engine.step(still(engine, 0.5), 8)
        moved = engine.joint_positions - start
        assert moved[1, 5] < 0.7 * moved[0, 5]
        others = np.delete(np.arange(16), 5)
        np.testing.assert_allclose(moved[1, others], moved[0, others], rtol=0.2)
        engine.step(still(engine, 0.5), 1000)
        np.testing.assert_allclose(engine.joint_positions[1], engine.joint_positions[0], atol=0.01)

    def test_a_finger_presses_as_hard_as_its_servo_is_stiff(self):
        """A fingertip on a slippery table: the torque is the servo's stiffness times how far it is from its
        target, and the lever arm is the same in both worlds."""
        factors = np.array([1.0, 0.5])
        engine = self.ready([CAN, CAN])
        joint = engine.scene.hand.joint_names.index("ffj1")
        stiffness = np.ones((2, 16))
        stiffness[:, joint] = factors
        engine.set_parameters(servo_stiffness=stiffness, friction=np.full(2, 0.01))
        engine.set_state(
            object_pose=pose(2, -0.5, 0.0, 0.06),
            wrist_frame=pose(2, 0.0, 0.0, 0.09, turn=PALM_DOWN),
            joint_positions=np.zeros((2, 16)),
        )
        fingers = np.zeros((2, 16))
        fingers[:, joint] = 0.8
        engine.step(still(engine, fingers), 600)
        tip = engine.scene.hand.link_names.index("index_distal")
        force = engine.table_forces[:, tip]
        assert (force > 0.5).all() and np.count_nonzero(engine.table_forces) == 2
        torque = factors * (0.8 - engine.joint_positions[:, joint])
        np.testing.assert_allclose(force[1] / force[0], torque[1] / torque[0], rtol=0.05)
        assert force[1] < 0.7 * force[0]

    def test_a_wrist_presses_as_hard_as_it_is_stiff(self):
        """Knuckles on the table, the wrist told to be below."""
        factors = np.array([1.0, 0.5])
        engine = self.ready([CAN, CAN])
        engine.set_parameters(wrist_stiffness=factors)
        engine.set_state(
            object_pose=pose(2, -0.5, 0.0, 0.06),
            wrist_frame=pose(2, 0.0, 0.0, 0.06, turn=PALM_DOWN),
            joint_positions=np.zeros((2, 16)),
        )
        goal = engine.wrist_frame
        goal[:, 2] = 0.01
        engine.step(engine.controls(goal, np.zeros((2, 3)), np.zeros((2, 16))), 800)
        missing = engine.palm_pose[:, 2] - goal[:, 2]
        expected = contract_scene().settings.wrist_stiffness[0] * factors * missing
        assert (expected > 1.0).all()
        np.testing.assert_allclose(engine.table_forces.sum(axis=1), expected, rtol=0.1)

    def test_a_push_lasts_until_it_is_taken_back_and_turns_nothing(self):
        engine = self.ready([CAN] * 3, height=1.0)
        mass = contract_objects()["can"].mass
        force = np.zeros((3, 3))
        force[1, 2] = mass * (9.81 + 1.0)
        engine.push_object(force)
        before, controls = engine.object_pose, still(engine)
        for _ in range(10):
            engine.step(controls, 10)
        moved = engine.object_pose - before
        assert moved[1, 2] == pytest.approx(0.5 * 1.0 * 0.5**2, rel=0.02)
        np.testing.assert_allclose(moved[1, [0, 1, 3, 4, 5, 6]], 0.0, atol=1e-6)
        np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-3)
        engine.push_object(np.zeros((3, 3)))
        engine.step(controls, 200)
        assert engine.object_on_table.all()

    def test_a_reset_takes_a_push_back(self):
        engine = self.ready([CAN, CAN])
        engine.push_object(np.array([[0.0, 0.0, 20.0]] * 2))
        engine.reset(np.array([1]))
        engine.set_state(object_pose=pose(2, 0.5, 0.0, 0.5), wrist_frame=pose(2, 0.0, 0.0, 0.8))
        engine.step(still(engine, 0.3), 10)
        assert engine.object_velocity[0, 2] > 0 > engine.object_velocity[1, 2]

    def test_an_object_in_the_hand_moves_with_it(self):
        """What is seen of the palm and of the object is in the same frame."""
        engine = self.ready([BALL], height=0.8)
        before = relative(engine.palm_pose, engine.object_pose)
        moved = compose(pose(1, 0.3, -0.2, 0.4, turn=np.array([0.8, 0.0, 0.0, 0.6])), engine.palm_pose)
        engine.set_state(wrist_frame=moved, object_pose=compose(moved, before))
        after = compose(invert(engine.palm_pose), engine.object_pose)
        np.testing.assert_allclose(after[:, :3], before[:, :3], atol=self.readback)
        np.testing.assert_allclose(
            rotation_vector(after[:, 3:]), rotation_vector(before[:, 3:]), atol=self.turned
        )
