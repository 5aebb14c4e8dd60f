"""Meshes of others: right, or refused with the true reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object

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
    "mug_cm_after_hint": (0.0113, 0.0082, 0.0095),
    "mug_inch_after_hint": (0.0045, 0.0032, 0.0037),
    "mesh_two_things": "separate bodies with 73 mm between them",
    "mesh_table_included": (0.4, 0.4, 0.105),
    "mesh_unit": (0.421, 0.243, 1.0),
}
"""Size [m], or what is said: a refusal or a warning. Nothing tells a bottle of 1 m, or a mug on a plate of
40 cm, from a right one before an image is seen."""


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the files of others in ../shared/data/foreign")
@pytest.mark.parametrize("name", MESHES)
def test_meshes_of_others_are_right_or_refused(name: str, caplog: pytest.LogCaptureFixture) -> None:
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
