"""The prior of hidden fingers is learned from synthesized grasps."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fungrasp.grasps import builtin_grasps  # noqa: E402
from fungrasp.objects import builtin_object  # noqa: E402
from fungrasp.perception.hand.finger_prior import FingerPrior, to_free  # noqa: E402
from fungrasp.synthesis.varied_grasps import varied_object  # noqa: E402
from fungrasp.training.finger_examples import FingerPriorSettings, finger_examples  # noqa: E402
from fungrasp.training.finger_prior import fit_finger, save_weights  # noqa: E402

SETTINGS = FingerPriorSettings(copies=2, epochs=6, hidden=(24, 16), components=2, minibatch=32)


@pytest.fixture(scope="module")
def examples():
    grasps = builtin_grasps()
    grasps = grasps.select(np.isin(grasps.object_name, ("can", "bottle")))
    objects = {name: builtin_object(name) for name in ("can", "bottle")}
    return finger_examples(grasps, objects, np.random.default_rng(0), SETTINGS)


def test_each_grasp_gives_its_copies(examples):
    grasps = np.isin(builtin_grasps().object_name, ("can", "bottle")).sum()
    assert len(examples.angles) == len(examples.surface) == SETTINGS.copies * grasps
    assert np.isfinite(examples.surface).all() and np.abs(examples.surface).max() <= 1.75 + 1e-6


def test_learning_lowers_the_loss_and_the_weights_say_the_same(examples, tmp_path):
    networks = []
    for finger in range(5):
        network, curve = fit_finger(finger, examples, examples, SETTINGS)
        assert len(curve) == SETTINGS.epochs and curve[-1][1] < curve[0][1] - 0.3
        networks.append(network)
    path = tmp_path / "prior.npz"
    with path.open("wb") as stream:
        save_weights(stream, networks)
    nothing_known = np.zeros(5, dtype=bool)
    mixture = FingerPrior.load(path).mixture(4, examples.surface[0], examples.angles[0], nothing_known)
    inputs = torch.from_numpy(np.concatenate([examples.surface[:1], np.zeros((1, 26))], axis=1)).float()
    truth = torch.from_numpy(to_free(4, examples.angles[:1, 4])).float()
    with torch.inference_mode():
        expected = float(networks[4](inputs, truth))
    # Components are wider here than where the network's gain ends.
    assert mixture.log_density(examples.angles[0, 4][None])[0] == pytest.approx(expected, abs=2e-3)


def test_objects_of_varied_grasps_are_found_by_name():
    assert varied_object("mug").name == "mug"
    half, whole = varied_object("mug x0.5"), builtin_object("mug")
    assert half.vertices.max() == pytest.approx(0.5 * whole.vertices.max())
    assert varied_object("box:60x28x30").size == pytest.approx([0.06, 0.028, 0.03])
