"""Variations of human grasps."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import bone_lengths, builtin_grasps, load_human_grasps, load_objects
from fungrasp.grasps.variation import FEWEST_LINKS, varied_grasps


def test_variations_move_the_whole_hand_and_follow_the_grasps():
    human = builtin_grasps().select(np.array([0, 9, 71]))
    objects = load_objects(human)
    varied = varied_grasps(human, objects, 2)
    np.testing.assert_array_equal(varied.hand_joints[:3], human.hand_joints)
    assert 3 < len(varied) <= 9
    rows = [human.object_name.tolist().index(name) for name in varied.object_name.tolist()]
    np.testing.assert_allclose(
        bone_lengths(varied.hand_joints), bone_lengths(human.hand_joints)[rows], atol=1e-6
    )
    moved = np.linalg.norm(varied.hand_joints - human.hand_joints[rows], axis=2).mean(axis=1)[3:]
    assert (moved > 0.002).all() and (moved < 0.06).all()
    assert (varied.link_contacts[3:, 1:].sum(axis=1) >= FEWEST_LINKS).all()
    np.testing.assert_array_equal(varied_grasps(human, objects, 2).hand_joints, varied.hand_joints)
    assert not np.array_equal(varied_grasps(human, objects, 2, seed=1).hand_joints, varied.hand_joints)
    with pytest.raises(FungraspError, match="negative"):
        varied_grasps(human, objects, -1)


def test_the_command_writes_grasps_and_variations(tmp_path, capsys):
    out = tmp_path / "varied.npz"
    assert main(["grasps", "vary", "builtin", "--count", "0", "--out", str(out)]) == 0
    assert len(load_human_grasps(out)) == len(builtin_grasps())
    assert str(out) in capsys.readouterr().out
