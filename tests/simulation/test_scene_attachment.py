"""Where a hand's palm lies in its own file does not matter."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from lifted_grasps import allegro_hand, grasped_objects, human_grasps
from scipy.spatial.transform import Rotation

from fungrasp.evaluation import evaluate
from fungrasp.hands import Hand, load_hand
from fungrasp.retargeting import retarget
from fungrasp.task.outcome import Outcomes


def moved_hand(folder: Path, seed: int, stand: bool) -> Hand:
    """The Allegro hand, its palm moved in its file; with a stand, it hangs on a fixed body of its own."""
    rng = np.random.default_rng(seed)
    place = {
        "pos": rng.uniform(-1, 1, 3),
        "quat": Rotation.random(rng=rng).as_quat(scalar_first=True),
    }
    original = allegro_hand()
    spec = mujoco.MjSpec.from_file(str(original.model_path))
    if stand:
        base = mujoco.MjSpec()
        base.compiler.degree = spec.compiler.degree
        foot = base.worldbody.add_body(name="stand", **place)
        base.attach(spec, prefix="", suffix="", frame=foot.add_frame(pos=[0.0, 0.1, 0.0], quat=[0, 1, 0, 0]))
        spec = base
    else:
        spec.body(original.palm).pos, spec.body(original.palm).quat = place["pos"], place["quat"]
    folder.mkdir()
    spec.compile()
    (folder / original.model_path.name).write_text(spec.to_xml())
    (folder / "hand.toml").write_text(original.path.read_text())
    return load_hand(folder)


def lifted(hand: Hand) -> Outcomes:
    grasps = human_grasps().select(slice(0, None, 2))
    return evaluate(retarget(grasps, grasped_objects(), hand), grasped_objects()).outcomes


@pytest.fixture(scope="module")
def expected() -> Outcomes:
    return lifted(allegro_hand())


@pytest.mark.filterwarnings("ignore:Attaching a spec")
@pytest.mark.parametrize(("seed", "stand"), [(0, False), (2, True)])
def test_episodes_do_not_depend_on_the_palms_place_in_the_file(
    tmp_path: Path, seed: int, stand: bool, expected: Outcomes
):
    result = lifted(moved_hand(tmp_path / "moved", seed, stand))
    assert expected.success.any()
    np.testing.assert_array_equal(result.success, expected.success)
    np.testing.assert_allclose(result.lifted_height_m, expected.lifted_height_m, atol=1e-6)


@pytest.mark.filterwarnings("ignore:Attaching a spec")
def test_palm_of_the_model_lies_at_the_origin(tmp_path: Path):
    hand = moved_hand(tmp_path / "moved", 3, True)
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    np.testing.assert_allclose(data.body(hand.palm).xpos, 0.0, atol=1e-12)
    np.testing.assert_allclose(data.body(hand.palm).xquat, [1, 0, 0, 0], atol=1e-12)
