import dataclasses
from typing import Any

import numpy as np
import pytest
import trimesh
from object_views import object_views
from scipy.spatial import KDTree

from benchmarks.synthetic_captures.depth_cameras import DEPTH_CAMERAS
from fungrasp.core.errors import FungraspError
from fungrasp.objects import plain_shape
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.io.scene_folders import read_folder, write_folder
from fungrasp.perception.scan import ScanSettings, scan_object

LENS = Intrinsics(320, 240, 305.0, 305.0, 160.0, 120.0)
BOX = plain_shape("box:90x60x70", 0.3)


def surface_errors(scan: trimesh.Trimesh, truth: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Distances from one surface to the other and back [m], after the best turn and shift."""
    a = np.asarray(trimesh.sample.sample_surface(scan, 4000, seed=0)[0])
    b = np.asarray(trimesh.sample.sample_surface(truth, 8000, seed=1)[0])
    best = min((_placed(a, b, yaw) for yaw in np.radians(np.arange(0, 360, 10))), key=lambda found: found[0])
    moved = best[1]
    for _ in range(20):
        target = b[KDTree(b).query(moved)[1]]
        ca, cb = moved.mean(axis=0), target.mean(axis=0)
        u, _, vt = np.linalg.svd((moved - ca).T @ (target - cb))
        moved = (moved - ca) @ (u @ vt) + cb
    return KDTree(b).query(moved)[0], KDTree(moved).query(b)[0]


def _placed(a: np.ndarray, b: np.ndarray, yaw: float) -> tuple[float, np.ndarray]:
    c, s = np.cos(yaw), np.sin(yaw)
    moved = a @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    moved = moved + 0.5 * (b.max(axis=0) + b.min(axis=0) - moved.max(axis=0) - moved.min(axis=0))
    return float(KDTree(b).query(moved)[0].mean()), moved


@pytest.fixture(scope="module")
def views():
    rng = np.random.default_rng(0)
    return object_views(BOX, 9, rng, camera=DEPTH_CAMERAS["d435i"], intrinsics=LENS)


def test_a_box_is_scanned_to_within_the_errors_of_the_camera(views):
    captures, truth = views
    scan = scan_object(captures, ScanSettings(cell=0.003))
    np.testing.assert_allclose(np.degrees(scan.yaws), 40 * np.arange(9), atol=6)
    assert scan.mesh.is_watertight
    forth, back = surface_errors(scan.mesh, truth)
    assert max(forth.mean(), back.mean()) < 0.0025
    assert max(np.quantile(forth, 0.95), np.quantile(back, 0.95)) < 0.007
    assert scan.mesh.volume == pytest.approx(0.09 * 0.06 * 0.07, rel=0.15)
    # Cut off at the table, which does not belong to it.
    assert scan.mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-6)
    assert scan.mesh.extents.max() < 0.105
    bottom = scan.mesh.vertices[:, 2] < 0.001
    assert bottom.sum() > 4
    assert scan.residuals.max() < 0.003


def test_colors_are_those_of_the_views(views):
    captures, _ = views
    scan = scan_object(captures, ScanSettings(cell=0.004))
    visual: Any = scan.mesh.visual
    colors = np.asarray(visual.vertex_colors)[:, :3].astype(float)
    assert colors.std(axis=0).max() > 5
    assert (np.abs(colors - 128).max(axis=1) > 10).mean() > 0.5


def test_what_cannot_be_scanned_is_said(views):
    captures, _ = views
    with pytest.raises(FungraspError, match="2 views or more"):
        scan_object(captures[:1])
    with pytest.raises(FungraspError, match="cells are"):
        ScanSettings(cell=0.1)
    empty = [dataclasses.replace(one, depth=np.zeros_like(one.depth) + 0.01) for one in captures[:2]]
    with pytest.raises(FungraspError, match="view 1"):
        scan_object(empty)


def test_a_camera_over_a_plain_table_is_not_found_again(views):
    captures, _ = views
    plain = [Capture(np.full_like(one.color, 128), one.depth, one.intrinsics) for one in captures]
    with pytest.raises(FungraspError, match="newspaper"):
        scan_object(plain)


def test_the_command_reads_folders_and_writes_a_mesh(views, tmp_path, capsys):
    from fungrasp.cli.main import main

    captures, _ = views
    for i, capture in enumerate(captures):
        write_folder(capture, tmp_path / "views" / f"{i:02d}")
    assert read_folder(tmp_path / "views" / "00").depth.shape == (240, 320)
    out = tmp_path / "box.ply"
    assert (
        main(
            [
                "scan",
                "--folders",
                str(tmp_path / "views"),
                "--out",
                str(out),
                "--cell",
                "0.004",
            ]
        )
        == 0
    )
    assert "closed" in capsys.readouterr().out
    assert trimesh.load(out, force="mesh").extents.max() < 0.11
    assert main(["scan", "--folders", str(tmp_path / "views"), "--out", str(tmp_path / "box.xyz")]) == 2
