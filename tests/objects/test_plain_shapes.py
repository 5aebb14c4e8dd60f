"""Objects that their names describe."""

from __future__ import annotations

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object


@pytest.mark.parametrize(
    ("name", "size", "volume"),
    [
        ("box:60x28x30", (0.060, 0.028, 0.030), 0.060 * 0.028 * 0.030),
        ("cylinder:66x115", (0.066, 0.066, 0.115), np.pi * 0.033**2 * 0.115),
        ("sphere:67.5", (0.0675,) * 3, 4 / 3 * np.pi * 0.03375**3),
    ],
)
def test_a_name_says_the_shape(name, size, volume):
    model = load_object(name, 0.2)
    np.testing.assert_allclose(model.size, size, rtol=3e-3)
    assert model.mesh.volume == pytest.approx(volume, rel=0.012)
    assert model.mesh.is_watertight and len(model.pieces) == 1
    np.testing.assert_allclose(model.center_of_mass, 0.0, atol=1e-9)
    assert (model.name, model.mass) == (name, 0.2)


def test_shapes_are_mirrored_like_other_objects():
    assert load_object("box:60x28x30_mirrored", 0.2).mesh.volume > 0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("box:60x28", "write box:LENGTHxWIDTHxHEIGHT"),
        ("box:60x28x-3", "no shape"),
        ("sphere:nan", "no shape"),
        ("cylinder:0.01x100", "1 to 1500 mm"),
        ("box:" + "9" * 5000, "no shape"),
        ("cone:3x4", "unknown object"),
        ("box:60x28x30" + "x1" * 100, "no shape"),
    ],
)
def test_other_names_are_refused_in_words(name, words):
    with pytest.raises(FungraspError, match=words):
        load_object(name, 0.2)


def test_a_shape_needs_a_mass():
    with pytest.raises(FungraspError, match="needs a mass"):
        load_object("box:60x28x30")
