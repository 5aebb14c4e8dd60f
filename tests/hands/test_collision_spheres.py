"""The spheres cover the collision geometry."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.hands import Hand, hand_files, load_hand
from fungrasp.hands.collisions import CollisionSpheres, collision_spheres

HANDS = sorted(hand_files())
TYPES = mujoco.mjtGeom

EVERY_SHAPE = """<mujoco>
  <asset><mesh name="wedge" vertex="0 0 0  .03 0 0  0 .08 0  0 0 .05  .01 .01 .01"/></asset>
  <worldbody><body name="palm">
    <geom type="box" size=".04 .01 .05" euler="20 0 10"/>
    <geom type="ellipsoid" size=".03 .02 .05" pos=".02 0 .1"/>
    <geom type="mesh" mesh="wedge" pos="0 .1 0" euler="0 30 0"/>
    <geom type="sphere" size=".5" contype="0" conaffinity="0"/>
    <body name="finger" pos="0 0 .1">
      <joint name="bend" range="0 90" axis="0 1 0" limited="true"/>
      <geom type="cylinder" size=".03 .04"/>
      <body name="pad" pos="0 0 .05"><geom type="sphere" size=".012"/></body>
      <site name="tip" pos="0 0 .05"/>
    </body>
    <body name="thumb" pos=".05 0 0">
      <joint name="oppose" range="0 90" axis="0 0 1" limited="true"/>
      <geom type="capsule" size=".01 .03" pos="0 0 .03" euler="90 0 0"/>
      <site name="thumb_tip" pos="0 0 .06"/>
    </body>
  </body></worldbody>
</mujoco>"""

DESCRIPTION = """name = "claw"
model = "claw.xml"
palm = "palm"
fingers.index = { links = ["finger"], tip = "tip" }
fingers.thumb = { links = ["thumb"], tip = "thumb_tip" }
actuators = { kp = 1.0, kd = 0.1, force_limit = 1.0 }
"""


@pytest.fixture
def claw(tmp_path: Path) -> Hand:
    """A hand with a geom of every type."""
    (tmp_path / "claw.xml").write_text(EVERY_SHAPE)
    (tmp_path / "hand.toml").write_text(DESCRIPTION)
    return load_hand(tmp_path)


def colliding(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero((model.geom_bodyid > 0) & ((model.geom_contype > 0) | (model.geom_conaffinity > 0)))


def surface_points(model: mujoco.MjModel, geom: int, count: int = 400) -> np.ndarray:
    """Random points on a geom's surface, frame of its body [m], shape [count, 3]."""
    random = np.random.default_rng(geom)
    size, kind = model.geom_size[geom], model.geom_type[geom]
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if kind == TYPES.mjGEOM_SPHERE:
        local = size[0] * normal
    elif kind == TYPES.mjGEOM_CAPSULE:
        ends = size[0] * normal + np.outer(np.sign(normal[:, 2]) * size[1], [0, 0, 1])
        side = normal * [1, 1, 0] / np.linalg.norm(normal[:, :2], axis=1, keepdims=True)
        side = size[0] * side + np.outer(random.uniform(-size[1], size[1], count), [0, 0, 1])
        local = np.where(random.random((count, 1)) < 0.3, ends, side)
    elif kind == TYPES.mjGEOM_ELLIPSOID:
        local = size * normal
    elif kind == TYPES.mjGEOM_BOX:
        local = random.uniform(-size, size, (count, 3))
        axis = random.integers(0, 3, count)
        local[np.arange(count), axis] = size[axis] * random.choice([-1, 1], count)
    elif kind == TYPES.mjGEOM_CYLINDER:
        angle, cap = random.uniform(0, 2 * np.pi, count), random.random(count) < 0.5
        radius = np.where(cap, size[0] * np.sqrt(random.random(count)), size[0])
        height = np.where(
            cap, size[1] * random.choice([-1, 1], count), random.uniform(-size[1], size[1], count)
        )
        local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    else:
        mesh = model.geom_dataid[geom]
        faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        weights = random.dirichlet([1, 1, 1], count)
        local = np.einsum("pc,pci->pi", weights, vertices[faces[random.integers(0, len(faces), count)]])
    turn = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
    return model.geom_pos[geom] + turn.apply(local)


def uncovered(hand: Hand, spheres: CollisionSpheres, geom: int) -> float:
    """How far beyond the spheres of a geom its surface reaches [m]."""
    own = spheres.geom == geom
    between = surface_points(hand.model, geom)[:, None] - spheres.points.offsets[own]
    return float((np.linalg.norm(between, axis=-1) - spheres.radius[own]).min(axis=1).max())


@pytest.mark.parametrize("spacing", [0.006, 0.018])
@pytest.mark.parametrize("name", HANDS)
def test_balls_cover_our_hands(name: str, spacing: float):
    hand = load_hand(name)
    spheres, model = collision_spheres(hand, spacing), hand.model
    assert set(spheres.geom) == set(colliding(model))
    for geom in colliding(model):
        kind = model.geom_type[geom]
        dip = 1 - np.sqrt(1 - (0.75 / 2) ** 2)  # between spheres three quarters of their radius apart
        allowed = 1.02 * dip * model.geom_size[geom, 0] if kind == TYPES.mjGEOM_CAPSULE else 0.75 * spacing
        assert uncovered(hand, spheres, geom) <= allowed


@pytest.mark.parametrize("spacing", [0.006, 0.018])
def test_balls_cover_every_type_of_geom(claw: Hand, spacing: float):
    spheres = collision_spheres(claw, spacing)
    kinds = {int(claw.model.geom_type[geom]) for geom in colliding(claw.model)}
    assert len(kinds) == 6
    for geom in colliding(claw.model):
        assert uncovered(claw, spheres, geom) <= spacing, claw.model.geom_type[geom]


def test_balls_do_not_reach_beyond_the_geoms(claw: Hand):
    spheres, model = collision_spheres(claw), claw.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in colliding(model):
        own = spheres.geom == geom
        extent = np.abs(model.geom_aabb[geom, 3:]) + 1e-6
        turn = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
        local = turn.inv().apply(spheres.points.offsets[own] - model.geom_pos[geom])
        local = np.abs(local - model.geom_aabb[geom, :3]) + spheres.radius[own, None]
        assert np.all(local <= extent)


def test_balls_ride_on_their_geoms_body_and_count_for_its_link(claw: Hand):
    spheres, model = collision_spheres(claw), claw.model
    np.testing.assert_array_equal(spheres.points.bodies, model.geom_bodyid[spheres.geom])
    link = {
        model.body(int(b)).name: claw.link_names[i]
        for b, i in zip(spheres.points.bodies, spheres.link, strict=True)
    }
    assert link == {
        "palm": "palm",
        "finger": "index_proximal",
        "pad": "index_proximal",
        "thumb": "thumb_proximal",
    }
