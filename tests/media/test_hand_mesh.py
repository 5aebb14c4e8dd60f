import numpy as np
import pytest
import trimesh
from flat_hand import FLAT_HAND

from fungrasp.core.errors import FungraspError
from fungrasp.media.hand_mesh import LINK_JOINTS, human_hand_mesh, surface_nets


def test_the_surface_of_a_ball_is_where_it_should_be():
    x, y, z = np.mgrid[:24, :24, :24] - 11.3
    vertices, faces = surface_nets(np.sqrt(x**2 + y**2 + z**2) - 8.0)
    radius = np.linalg.norm(vertices - 11.3, axis=1)
    assert np.abs(radius - 8.0).max() < 0.2
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_watertight
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.02)


def test_a_hand_is_one_closed_piece_round_its_joints():
    hand = human_hand_mesh(FLAT_HAND)
    mesh = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert 2e-4 < mesh.volume < 6e-4
    inner = FLAT_HAND[[0, 1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15, 17, 18, 19]]
    distance = np.linalg.norm(hand.vertices[:, None] - inner, axis=-1).min(0)
    assert (distance > 0.004).all()
    assert (distance < 0.03).all()


def test_fingertips_end_at_the_tip_joints():
    hand = human_hand_mesh(FLAT_HAND)
    for tip in (4, 8, 12, 16, 20):
        assert np.linalg.norm(hand.vertices - FLAT_HAND[tip], axis=1).min() < 0.004


def test_vertices_belong_to_the_link_they_surround():
    hand = human_hand_mesh(FLAT_HAND)
    np.testing.assert_allclose(hand.links.sum(1), 1.0, atol=1e-6)
    for link, (near, far) in enumerate(LINK_JOINTS[1:], start=1):
        middle = 0.5 * (FLAT_HAND[near] + FLAT_HAND[far])
        closest = np.argsort(np.linalg.norm(hand.vertices - middle, axis=1))[:5]
        assert (hand.links[closest].argmax(1) == link).all()


@pytest.mark.parametrize("joints", [np.zeros((20, 3)), np.full((21, 3), np.nan), 1000 * FLAT_HAND])
def test_what_is_no_hand_is_refused(joints):
    with pytest.raises(FungraspError, match="hand"):
        human_hand_mesh(joints)
