"""The built-in everyday objects."""

from __future__ import annotations

import manifold3d
import mujoco
import numpy as np
import pytest
import trimesh

from fungrasp.objects import ObjectModel, builtin_object, object_names
from fungrasp.objects.mesh_repair import bodies, hull_solid, solid

NAMES = object_names()

REQUIRED_PARTS = {
    "mug": {"handle", "body", "rim"},
    "scissors": {"loops", "blades"},
    "hammer": {"grip", "head"},
    "spray_bottle": {"neck", "trigger", "body"},
    "drill": {"grip", "trigger", "chuck"},
    "pan": {"handle", "body"},
    "knife": {"handle", "blade"},
    "screwdriver": {"handle", "shaft"},
    "bottle": {"body", "neck", "cap"},
    "can": {"body"},
    "box": {"body"},
    "bowl": {"rim", "body"},
    "marker": {"barrel", "cap"},
    "brush": {"handle", "head"},
    "pitcher": {"handle", "body"},
    "clamp": {"jaws", "handles"},
}

HOLES = {"mug": 1, "pitcher": 1, "teapot": 1, "scissors": 2}
"""Loops that a finger or a string can go through, at least."""


def test_the_library_holds_what_it_promises():
    assert set(REQUIRED_PARTS) <= set(NAMES)
    for name, parts in REQUIRED_PARTS.items():
        assert parts <= set(builtin_object(name).parts), name


@pytest.mark.parametrize("name", NAMES)
def test_mesh_parts_and_inertia_are_those_of_a_body(name):
    """One closed surface of sensible size around the origin, whose faces the parts share out; a plausible
    density, and no principal moment larger than the sum of the others."""
    model = builtin_object(name)
    assert model.mesh.is_watertight and model.mesh.is_winding_consistent and model.mesh.volume > 0
    assert len(bodies(model.mesh)) == 1 and len(model.faces) <= 4000
    assert model.faces.dtype == np.int32 and model.vertices.dtype == np.float64
    assert 0.015 < np.median(model.size) < 0.3 and model.size.max() < 0.45
    np.testing.assert_allclose(model.vertices.min(axis=0) + model.vertices.max(axis=0), 0, atol=1e-12)
    masks = np.array(list(model.parts.values()))
    assert masks.dtype == bool and masks.any(axis=1).all()
    np.testing.assert_array_equal(masks.sum(axis=0), 1)
    np.testing.assert_allclose(model.inertia, model.inertia.T, atol=1e-12)
    moments = np.linalg.eigvalsh(model.inertia)
    assert moments[0] > 0
    assert moments[2] < moments[0] + moments[1]
    assert 200 < model.mass / model.mesh.volume < 4000


@pytest.mark.parametrize("name", NAMES)
def test_pieces_are_convex_and_are_the_object(name):
    model = builtin_object(name)
    assert len(model.pieces) <= 28
    for piece in model.pieces:
        shape = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        corners = piece.vertices[piece.faces[:, 0]]
        offsets = piece.vertices[None] - corners[:, None]
        distance = np.einsum("fk,fvk->fv", shape.face_normals, offsets)
        assert distance.max() < 1e-6
    hulls = [hull_solid(piece.vertices) for piece in model.pieces]
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    assert union.volume() == pytest.approx(model.mesh.volume, rel=1e-6)
    assert (union ^ solid(model.mesh)).volume() == pytest.approx(model.mesh.volume, rel=1e-3)


@pytest.mark.parametrize("name", sorted(HOLES))
def test_handles_can_be_reached_through(name):
    genus = 1 - builtin_object(name).mesh.euler_number // 2
    assert genus >= HOLES[name]


@pytest.mark.parametrize("name", ["mug", "bowl", "pitcher", "wine_glass"])
def test_vessels_are_hollow(name):
    """A ball lowered into the opening gets far down before it touches a piece."""
    model = builtin_object(name)
    top = model.vertices[:, 2].max()
    axis = model.vertices[np.isclose(model.vertices[:, 2], top, atol=0.01)].mean(axis=0)
    axis[0] = 0.0 if name in ("bowl", "wine_glass") else _opening_center(model)
    inside = [axis * [1, 1, 0] + [0, 0, top - depth] for depth in (0.01, 0.025, 0.035)]
    for point in inside:
        assert all(_outside(piece, point) > 0.01 for piece in model.pieces)


def _opening_center(model: ObjectModel) -> float:
    """x of the middle of the body, which the handle has moved away from the origin."""
    base = model.vertices[model.vertices[:, 2] < model.vertices[:, 2].min() + 1e-6]
    return float((base[:, 0].min() + base[:, 0].max()) / 2)


def _outside(piece, point) -> float:
    shape = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
    return float(np.max(np.einsum("fk,fk->f", shape.face_normals, point - piece.vertices[piece.faces[:, 0]])))


@pytest.mark.parametrize("name", NAMES)
def test_rests_where_it_lies(name):
    """Put on a table in MuJoCo as ``rest_pose`` says, it stays there."""
    model = builtin_object(name)
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.004
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    pose = model.rest_pose()
    body = spec.worldbody.add_body(pos=pose[:3], quat=pose[3:])
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos = model.mass, model.center_of_mass
    inertia = model.inertia
    body.fullinertia = [*inertia.diagonal(), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    for i, piece in enumerate(model.pieces):
        mesh = spec.add_mesh(name=f"piece_{i}")
        mesh.uservert = piece.vertices.ravel()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    for _ in range(250):
        mujoco.mj_step(compiled, data)
    np.testing.assert_allclose(data.qpos[:3], pose[:3], atol=0.002)
    up = np.empty(9)
    mujoco.mju_quat2Mat(up, data.qpos[3:])
    assert np.degrees(np.arccos(min(1.0, up[8]))) < 2
