"""What the built-in hands look like: closed meshes about what collides, which stays as it is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from fungrasp.hands import load_hand
from fungrasp.hands.hand import read_hand_toml
from fungrasp.media.surfaces import drawn_geoms
from fungrasp.media.visual_meshes import dressed_model, dressed_spec


@pytest.mark.parametrize("name", ["allegro", "faive", "inspire", "leap", "shadow"])
def test_a_hand_is_dressed(name):
    hand = load_hand(name)
    model, bare = dressed_model(hand), hand.model
    visual = model.geom_contype + model.geom_conaffinity == 0
    for mesh in range(model.nmesh):
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        first, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        vertices = model.mesh_vert[start : start + count]
        solid = trimesh.Trimesh(vertices, model.mesh_face[first : first + number], process=False)
        assert solid.is_watertight and solid.volume > 0, f"{name}: part {mesh} is open or inside out"
    # Drawn is one or the other, and what collides is as it was.
    assert np.array_equal(drawn_geoms(model), visual)
    assert model.nq == bare.nq and int((~visual).sum()) == bare.ngeom
    assert model.body_mass == pytest.approx(bare.body_mass)
    assert _farthest(model, visual) < 0.026, "a mesh stands far off what collides"


def _farthest(model: mujoco.MjModel, visual: np.ndarray) -> float:
    """Largest distance of a visual mesh from what collides [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = np.flatnonzero(~visual)
    worst = 0.0
    for geom in np.flatnonzero(visual):
        distance = [mujoco.mj_geomDistance(model, data, int(geom), int(other), 0.1, None) for other in solid]
        worst = max(worst, min(distance))
    return worst


def test_a_hand_of_ones_own_is_shown_as_it_is(tmp_path):
    source = load_hand("allegro")
    (tmp_path / "allegro.xml").write_bytes(source.model_path.read_bytes())
    (tmp_path / "hand.toml").write_text(source.path.read_text().replace('name = "allegro"', 'name = "own"'))
    own = read_hand_toml(tmp_path / "hand.toml")
    assert dressed_spec(own).compile().ngeom == own.model.ngeom
    assert drawn_geoms(dressed_model(own)).all()
