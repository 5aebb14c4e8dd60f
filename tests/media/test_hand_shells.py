"""What the built-in hands look like: closed parts, small, about what collides, which stays as it is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from fungrasp.hands import load_hand
from fungrasp.hands.hand import read_hand_toml
from fungrasp.media.hand_shells import dressed_model, dressed_spec
from fungrasp.media.hand_shells.dressing import DRESSED
from fungrasp.media.hand_shells.shapes import ball, bullet, disc, housing, plate
from fungrasp.media.model_surfaces import drawn_geoms

MOST_BYTES = 300_000
"""Of a hand's shells: positions and indices of 4 bytes."""


@pytest.mark.parametrize(
    ("solid", "volume"),
    [
        (housing(0.03, 0.01, 0.008, 0.0001, 0.00005), 0.03 * 0.02 * 0.016),
        (disc(0.01, 0.02, 0.0001, count=64), np.pi * 0.01**2 * 0.02),
        (ball(0.01, 64, 33), 4 / 3 * np.pi * 0.01**3),
        (bullet(0.03, 0.01, 0.01, 0.01, steps=20), np.pi * 0.01**2 * (0.02 + 2 / 3 * 0.01)),
        (plate(np.array([(0, 0), (0.04, 0), (0.04, 0.02), (0, 0.02)]), 0, 0.01, 0.0001, 0.0001), 8e-6),
    ],
)
def test_solids_are_closed_and_of_their_size(solid, volume):
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.07)


@pytest.mark.parametrize("name", DRESSED)
def test_a_hand_is_dressed(name):
    hand = load_hand(name)
    model, bare = dressed_model(hand), hand.model
    shells = model.geom_contype + model.geom_conaffinity == 0
    assert 12 * (int(model.mesh_vertnum.sum()) + int(model.mesh_facenum.sum())) <= MOST_BYTES
    for mesh in range(model.nmesh):
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        first, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        solid = trimesh.Trimesh(
            model.mesh_vert[start : start + count], model.mesh_face[first : first + number]
        )
        assert solid.is_watertight and solid.volume > 0, f"{name}: part {mesh} is open or inside out"
    # Drawn is one or the other, and what collides is as it was.
    assert np.array_equal(drawn_geoms(model, ground=True), shells)
    assert model.nq == bare.nq and int((~shells).sum()) == bare.ngeom
    assert model.body_mass == pytest.approx(bare.body_mass)
    assert _farthest(model, shells) < 0.026, "a shell stands far off what collides"


def _farthest(model: mujoco.MjModel, shells: np.ndarray) -> float:
    """Largest distance of the middle of a shell from what collides of its body and the bodies next to it."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = np.flatnonzero(~shells)
    worst = 0.0
    for geom in np.flatnonzero(shells):
        distance = [mujoco.mj_geomDistance(model, data, int(geom), int(other), 0.1, None) for other in solid]
        worst = max(worst, min(distance))
    return worst


def test_a_hand_of_ones_own_is_shown_as_it_is(tmp_path):
    source = load_hand("allegro")
    (tmp_path / "allegro.xml").write_bytes(source.model_path.read_bytes())
    (tmp_path / "hand.toml").write_text(source.path.read_text().replace('name = "allegro"', 'name = "own"'))
    own = read_hand_toml(tmp_path / "hand.toml")
    assert dressed_spec(own).compile().ngeom == own.model.ngeom
    assert drawn_geoms(dressed_model(own), ground=True).all()
