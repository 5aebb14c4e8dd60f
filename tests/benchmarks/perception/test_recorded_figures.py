import json
from pathlib import Path

import numpy as np
import pytest
from object_pose_scenes import scene

from benchmarks.perception.recorded_captures import read_recorded, recorded_folders
from benchmarks.perception.recorded_figures import (
    hinted_captures,
    measure_recorded,
    recorded_figures,
    recorded_rows,
    recorded_table,
    smaller_mask,
    wrong_meshes,
)
from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.capture import Box
from fungrasp.perception.io.scene_folders import write_folder

MUG = load_object("mug")
SCENE = scene(MUG, MUG.rest_pose(0.3), np.array([0.05, 0.0, 0.04]))


class StandIn:
    def __init__(self, *hands: DetectedHand):
        self.hands = list(hands)

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        return self.hands


SHAPE = SCENE.hand.joints_camera - SCENE.hand.joints_camera.mean(axis=0)
HAND = StandIn(DetectedHand(SCENE.hand.pixels, SHAPE, "right", 1.0, 0.9))


def written(folder: Path, **truth: object) -> Path:
    write_folder(SCENE.capture.with_object(mask=SCENE.mask), folder)
    (folder / "truth.json").write_text(json.dumps(truth))
    return folder


@pytest.mark.slow
def test_a_set_is_measured_with_every_hint(tmp_path: Path) -> None:
    joints = [None if i == 3 else row for i, row in enumerate(SCENE.hand.joints_camera.tolist())]
    written(
        tmp_path / "one",
        object="mug",
        object_pose_camera_wxyz=SCENE.pose.tolist(),
        joints_camera_m=joints,
        table_plane_camera=SCENE.table.tolist(),
    )
    (folder,) = recorded_folders(tmp_path)
    recorded = read_recorded(folder)
    assert recorded.joints_camera is not None and np.isnan(recorded.joints_camera[3]).all()
    result = measure_recorded(recorded, HAND)
    hints = [answer.hint for answer in result.objects]
    assert hints == ["none", "box", "click", "mask", "mask larger", "mask smaller"]
    right = {answer.hint: answer.right for answer in result.objects}
    assert right["mask"] and right["box"]
    assert result.hand_found is True and result.pixel_error < 1e-6
    figures = recorded_figures([result], [True])
    assert figures["lifted"]["rate"] == 1.0
    assert figures["object"]["mask"]["right"]["rate"] == 1.0
    assert figures["hand"]["found"]["rate"] == 1.0
    assert len(recorded_table(figures)) == 1 + len(hints)
    json.dumps(recorded_rows([result]), allow_nan=False)


def test_without_a_hand_there_is_no_answer(tmp_path: Path) -> None:
    folder = written(tmp_path / "one", object="mug", object_pose_camera_wxyz=SCENE.pose.tolist())
    result = measure_recorded(read_recorded(folder), StandIn())
    assert not any(answer.right or answer.accepted for answer in result.objects)
    figures = recorded_figures([result])
    assert figures["object"]["mask"]["right"]["rate"] == 0.0 and figures["no_hand_sure"]["rate"] == 0.0
    assert len(recorded_table(figures)) == 7
    json.dumps(recorded_rows([result]), allow_nan=False)


def test_without_a_mask_or_an_object_less_is_measured(tmp_path: Path) -> None:
    folder = written(tmp_path / "one")
    recorded = read_recorded(folder)
    assert recorded.model is None and measure_recorded(recorded, StandIn()).objects == ()
    assert list(hinted_captures(recorded)) == ["none", "box", "click", "mask", "mask larger", "mask smaller"]


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        ({"object": "no_such_thing"}, "neither a mesh file"),
        ({"object": 300 * "9"}, "neither a mesh file"),
        ({"object": "mug", "object_pose_camera_wxyz": [0, 0, 1]}, "object_pose_camera_wxyz must be numbers"),
        ({"object": "mug", "object_pose_camera_wxyz": [0, 0, 1, 2, 0, 0, 0]}, "must have length 1"),
        ({"object_pose_camera_wxyz": [0, 0, 1, 1, 0, 0, 0]}, 'a pose without "object"'),
        ({"joints_camera_m": [[0, 0, 1]]}, "joints_camera_m must be numbers"),
        ({"table_plane_camera": "flat"}, "table_plane_camera must be numbers"),
    ],
)
def test_bad_truth_is_named(tmp_path: Path, truth: dict[str, object], words: str) -> None:
    with pytest.raises(FungraspError, match=words):
        read_recorded(written(tmp_path / "one", **truth))


def test_an_empty_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(FungraspError, match="has no captures"):
        recorded_folders(tmp_path)


def test_wrong_meshes_are_other_shapes() -> None:
    sizes = [float(np.linalg.norm(one.size / MUG.size)) for one in wrong_meshes(MUG)]
    assert len(sizes) == 11 and min(abs(size - 3**0.5) for size in sizes) > 0.1


def test_smaller_masks_do_not_vanish() -> None:
    thick, thin = np.zeros((2, 60, 60), dtype=bool)
    thick[10:50, 10:50] = True
    thin[20:24, 5:55] = True
    assert smaller_mask(thick).sum() == 28 * 28, "6 pixels less on each side"
    assert 0.3 * thin.sum() <= smaller_mask(thin).sum() < thin.sum()
