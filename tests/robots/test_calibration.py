"""Where a camera stands: from a board in the hand, on made-up observations."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_from_rotation_vector,
    rotation_vector,
    transform_points,
)
from fungrasp.hands import load_hand
from fungrasp.perception import Intrinsics
from fungrasp.robots.calibration.camera import (
    Board,
    BoardView,
    CameraCalibration,
    board_pose,
    calibrate_from_board,
    save_calibration,
)
from fungrasp.robots.cell import check_calibrated, load_cell
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp.robots.kinematics.reach import arm_postures, random_starts

LENS = Intrinsics(640, 480, 615.0, 615.0, 319.5, 239.5)


def pose_error(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses of shape [7]."""
    between = compose(invert(one), other)
    return float(np.linalg.norm(between[:3])), float(np.linalg.norm(rotation_vector(between[3:])))


def looking_at(place: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Pose of a camera somewhere that looks at a point, its x axis level."""
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1))
    return np.concatenate([place, turn.as_quat(scalar_first=True)])


CAMERA = looking_at(np.array([0.75, 0.1, 0.6]), np.array([0.05, 0.0, 0.25]))
BOARD_ON_PALM = np.array([0.02, 0.01, 0.08, *quaternion_from_rotation_vector(np.array([0.1, -0.2, 0.4]))])


def grid(board: Board) -> np.ndarray:
    x, y = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
    return board.square * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)


def board_views(
    rng: np.random.Generator, count: int, pixels: float, place: float, turn: float
) -> list[BoardView]:
    """Views with errors of corners [pixels] and of the palm's pose [m], [rad]."""
    points, views = grid(Board()), []
    while len(views) < count:
        # The board about 0.6 m before the camera, turned by up to 35 degrees.
        tilt = quaternion_from_rotation_vector(rng.uniform(-0.6, 0.6, 3))
        shift = np.append(rng.uniform(-0.12, 0.12, 2) - 0.08, rng.uniform(0.5, 0.7))
        in_camera = np.concatenate([shift, tilt])
        palm = compose(compose(CAMERA, in_camera), invert(BOARD_ON_PALM))
        error = np.concatenate(
            [place * rng.normal(size=3), quaternion_from_rotation_vector(turn * rng.normal(size=3))]
        )
        seen = LENS.project(transform_points(in_camera, points))
        views.append(BoardView(compose(palm, error), points, seen + pixels * rng.normal(size=seen.shape)))
    return views


def test_a_board_in_exact_views_gives_the_camera_exactly() -> None:
    views = board_views(np.random.default_rng(0), 6, 0.0, 0.0, 0.0)
    found = calibrate_from_board(views, LENS)
    place, turn = pose_error(found.pose_world_camera, CAMERA)
    assert place < 1e-6 and turn < 1e-6
    assert found.residual < 1e-7


def test_a_boards_pose_is_that_of_its_homography() -> None:
    view = board_views(np.random.default_rng(1), 1, 0.0, 0.0, 0.0)[0]
    truth = compose(compose(invert(CAMERA), view.palm), BOARD_ON_PALM)
    place, turn = pose_error(board_pose(view, LENS), truth)
    assert place < 1e-9 and turn < 1e-9


@pytest.mark.slow
def test_noisy_views_give_the_camera_within_what_they_say() -> None:
    """Fifteen images, corners 0.2 pixels, the palm 0.3 mm and 0.5 mrad off: 1 mm and 2 mrad, and what the
    calibration says of itself is true within a factor of three."""
    places, turns, said = [], [], []
    for seed in range(10):
        found = calibrate_from_board(board_views(np.random.default_rng(seed), 15, 0.2, 3e-4, 5e-4), LENS)
        place, turn = pose_error(found.pose_world_camera, CAMERA)
        places.append(place)
        turns.append(turn)
        said.append((found.position_deviation, found.rotation_deviation))
    assert np.median(places) < 1.5e-3 and max(places) < 4e-3
    assert np.median(turns) < 2e-3 and max(turns) < 5e-3
    ratio = np.sqrt(np.mean(np.square(places))) / np.mean(said, axis=0)[0]
    assert 1 / 3 < ratio < 3


def test_wrong_corners_in_one_image_hardly_matter() -> None:
    views = board_views(np.random.default_rng(3), 15, 0.2, 0.0, 0.0)
    views[4].pixels[2:5] += 40.0
    place, turn = pose_error(calibrate_from_board(views, LENS).pose_world_camera, CAMERA)
    assert place < 2e-3 and turn < 3e-3


def test_too_few_views_or_turns_about_one_axis_are_refused() -> None:
    views = board_views(np.random.default_rng(0), 4, 0.1, 0.0, 0.0)
    with pytest.raises(FungraspError, match="only 4 images show the board"):
        calibrate_from_board(views, LENS)
    level = []
    points = grid(Board())
    for i in range(8):
        in_camera = np.array([0.02 * i - 0.15, -0.05, 0.6, 1.0, 0.0, 0.0, 0.0])
        palm = compose(compose(CAMERA, in_camera), invert(BOARD_ON_PALM))
        noise = 0.2 * np.random.default_rng(i).normal(size=(len(points), 2))
        level.append(BoardView(palm, points, LENS.project(transform_points(in_camera, points)) + noise))
    with pytest.raises(FungraspError, match="turn"):
        calibrate_from_board(level, LENS)


def test_a_cell_takes_the_file_and_refuses_a_camera_without_one(tmp_path: Path) -> None:
    out = tmp_path / "camera.toml"
    save_calibration(out, CameraCalibration(CAMERA, 1e-3, 1e-3, 1e-3), "a test")
    cell = tmp_path / "cell.toml"
    cell.write_text('hand = "allegro"\n[tracker]\ndriver = "pose-stream"\ncalibration = "camera.toml"\n')
    read = load_cell(cell)
    np.testing.assert_allclose(read.tracker.pose_world_camera, CAMERA, atol=1e-6)
    check_calibrated(read)
    cell.write_text('hand = "allegro"\n[tracker]\ndriver = "pose-stream"\n')
    with pytest.raises(FungraspError, match="no calibration of the camera: run 'fungrasp robots calibrate'"):
        check_calibrated(load_cell(cell))
    out.write_text("pose_world_camera = [0, 0, 0]\n")
    cell.write_text('hand = "allegro"\n[tracker]\ncalibration = "camera.toml"\n')
    with pytest.raises(FungraspError, match="'calibration_residual' is missing"):
        load_cell(cell)


def test_the_command_calibrates_from_images_of_a_charuco_board(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason='OpenCV is not installed: pip install "fungrasp[calibration]"')
    cell, rng, board = load_cell("ur5e-allegro"), np.random.default_rng(0), Board()
    arm = ArmKinematics(cell, load_hand(cell.hand))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard((7, 5), board.square, board.marker, dictionary).generateImage((1400, 1000))
    camera = looking_at(np.array([0.6, 0.0, 0.5]), np.array([0.1, 0.0, 0.35]))
    joints = {}
    while len(joints) < 10:
        in_camera = np.concatenate(
            [
                np.append(rng.uniform(-0.08, 0.08, 2) - 0.09, rng.uniform(0.45, 0.6)),
                quaternion_from_rotation_vector(rng.uniform(-0.5, 0.5, 3)),
            ]
        )
        palm = compose(compose(camera, in_camera), invert(BOARD_ON_PALM))
        found = arm_postures(arm, palm, random_starts(arm, 12, rng))
        if not len(found):
            continue
        corners = 0.03 * np.array([[0, 0, 0], [7, 0, 0], [7, 5, 0], [0, 5, 0]])
        to = LENS.project(transform_points(in_camera, corners)).astype(np.float32)
        at = np.array([[-0.5, -0.5], [1399.5, -0.5], [1399.5, 999.5], [-0.5, 999.5]], np.float32)
        turned = cv2.getPerspectiveTransform(at, to)
        gray = cv2.warpPerspective(drawn, turned, (640, 480), flags=cv2.INTER_AREA, borderValue=150)
        name = f"{len(joints):02d}.png"
        Image.fromarray(np.repeat(gray[..., None], 3, axis=2)).save(tmp_path / name)
        joints[name] = found[0].tolist()
    (tmp_path / "arm.json").write_text(json.dumps(joints))
    lens = {"width": 640, "height": 480, "fx": 615.0, "fy": 615.0, "cx": 319.5, "cy": 239.5}
    (tmp_path / "camera.json").write_text(json.dumps(lens))
    out = tmp_path / "camera.toml"
    main(["robots", "calibrate", "ur5e-allegro", "--images", str(tmp_path), "--out", str(out)])
    text = out.read_text()
    numbers = text.split("pose_world_camera = [")[1].split("]")[0]
    place, turn = pose_error(np.array([float(n) for n in numbers.split(",")]), camera)
    assert place < 3e-3 and turn < 5e-3
