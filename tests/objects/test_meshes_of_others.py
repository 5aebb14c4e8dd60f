"""Meshes of others: right, or refused with the true reason."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object, object_registry
from fungrasp.objects.mesh_file import mesh_doubts

FOREIGN = Path(__file__).parents[3] / "shared" / "data" / "foreign" / "files"

MUG, BOTTLE = (0.113, 0.082, 0.095), (0.107, 0.062, 0.254)
"""True sizes [m]."""

MESHES: dict[str, tuple[float, float, float] | str] = {
    "glb_two_factors": MUG,
    "mesh_mirrored_scale": MUG,
    "mesh_mtl_missing": MUG,
    "mesh_obj_double_sided": MUG,
    "mesh_texture_missing": MUG,
    "tex_backslash": MUG,
    "tex_image_broken": MUG,
    "tex_missing_kd": MUG,
    "tex_mtl_broken": MUG,
    "tex_options": MUG,
    "mesh_off_15cm": BOTTLE,
    "mesh_open_scan": "rebuilt the open surface as a shell",
    "mesh_points": "has no faces",
    "mesh_inch": "254 mm if it is in inches",
    "mesh_mm": "254 mm if it is in mm",
    "mesh_x10": "larger than the table",
    "mug_cm": "113 mm if it is in cm",
    "mug_inch": "113 mm if it is in inches",
    "mug_mm": "113 mm if it is in mm",
    "mug_cm_after_hint": "11.3 mm long, and a hand holds things of 20 to 600 mm",
    "mug_inch_after_hint": "4.47 mm long, and a hand holds things of 20 to 600 mm",
    "mesh_two_things": "separate bodies with 73 mm between them",
    "mesh_table_included": "a flat piece of 400 x 400 mm",
    "mesh_unit": "1e+03 mm long, and a hand holds things of 20 to 600 mm",
}
"""Size [m], or what is said: a refusal or a warning."""


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the files of others in ../shared/data/foreign")
@pytest.mark.parametrize("name", MESHES)
def test_meshes_of_others_are_right_or_refused(name: str, caplog: pytest.LogCaptureFixture) -> None:
    # A mesh that another test has loaded in this process is not read again, and says nothing.
    object_registry._from_file.cache_clear()
    object_registry._mesh.cache_clear()
    kinds = (".obj", ".ply", ".glb", ".stl")
    (path,) = (path for path in (FOREIGN / name).iterdir() if path.suffix in kinds)
    expected = MESHES[name]
    if not isinstance(expected, str):
        np.testing.assert_allclose(load_object(path, 0.3).mesh.extents, expected, atol=0.001)
        return
    try:
        load_object(path, 0.3)
        said = caplog.text
    except FungraspError as error:
        said = str(error)
    assert expected in said


def test_the_table_is_told_in_any_position() -> None:
    """A cup on a piece of the table that is 8 mm thick; without it, and on a foot, nothing is said."""
    cup = trimesh.creation.cylinder(0.04, 0.1)
    for size, told in ((0.35, True), (0.1, False)):
        plate = trimesh.creation.box((size, size, 0.008))
        whole: Any = trimesh.util.concatenate([cup, plate.apply_translation([0.05, 0.02, -0.053])])
        turn = trimesh.transformations.rotation_matrix(1.0, [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
        for place in (np.eye(4), turn):
            mesh = whole.copy()
            mesh.apply_transform(place)
            said = list(mesh_doubts(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
            assert bool(said) == told
            if told:
                terms, least = re.search(r"all with (.*) < (-?[\d.]+) m", said[0]).groups()  # type: ignore[union-attr]
                factors = {
                    term.split()[-1]: float(term.split()[0]) for term in terms.split(" + ") if " " in term
                }
                normal = np.array([factors.get(axis, float(axis == terms)) for axis in "xyz"])
                kept = mesh.vertices @ normal >= float(least)
                # What is left is the cup.
                np.testing.assert_array_equal(kept[: len(cup.vertices)], cup.vertices[:, 2] > -0.049)
                assert not kept[len(cup.vertices) :].any()
