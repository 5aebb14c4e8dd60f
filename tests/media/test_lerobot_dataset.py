"""Recorded episodes as LeRobot's data sets: what is read back is what was written, pictures too."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recorded_episodes import HAND, episode

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.grasps import RobotGrasp, builtin_grasps, load_objects
from fungrasp.media.lerobot_dataset import episode_pictures, write_lerobot_dataset
from fungrasp.retargeting import retarget

HUMAN = builtin_grasps()[:1]
OBJECTS = load_objects(HUMAN)
THING = OBJECTS["mug"]


@cache
def grasp() -> RobotGrasp:
    return retarget(HUMAN, OBJECTS, HAND)[0]


def rising(index: int, size: int) -> Trajectory:
    """A hand that rises from a mug that stays on the table."""
    hand, mug, joints = (
        np.tile(values.astype(np.float32), (size, 1))
        for values in (grasp().wrist_pose, grasp().object_pose, grasp().joint_positions)
    )
    hand[:, 2] += 0.005 * np.arange(size)
    return replace(episode(index, "mug", size), palm_pose=hand, object_pose=mug, joint_positions=joints)


def numbered(one: Trajectory):
    """Pictures that tell the episode and the state."""
    for number in range(len(one.times)):
        yield np.full((32, 48, 3), 20 * number + one.index, np.uint8)


def test_a_lerobot_dataset_loses_nothing(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra lerobot is not installed")
    episodes = [episode(3), episode(4, "box", 5)]
    out = write_lerobot_dataset(episodes, tmp_path / "set")
    columns = parquet.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["fps"], info["total_frames"], info["total_episodes"]) == (50, 12, 2)
    for name, feature in info["features"].items():
        values = np.array(columns[name])
        assert values.shape[1:] == (tuple(feature["shape"]) if values.ndim > 1 else ())
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    one, other = episodes
    state = np.array(columns["observation.state"], dtype=np.float32)
    assert np.array_equal(state[:7], np.concatenate([one.palm_pose, one.joint_positions], axis=1))
    action = np.array(columns["action"], dtype=np.float32)
    assert np.array_equal(action[7:11], other.controls[1:]) and np.array_equal(action[11], other.controls[-1])
    assert np.array_equal(np.array(columns["observation.contacts"])[:7], one.link_contacts)
    assert columns["next.success"] == [False] * 6 + [True] + [False] * 5
    spans = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert spans["dataset_to_index"] == [7, 12] and spans["tasks"] == [["lift the mug"], ["lift the box"]]


def test_films_hold_a_picture_of_each_state(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra lerobot is not installed")
    import av

    episodes = [episode(3), episode(4, "box", 5)]
    out = write_lerobot_dataset(episodes, tmp_path / "set", {"front": numbered})
    info = json.loads((out / "meta/info.json").read_text())
    key = "observation.images.front"
    assert info["features"][key]["shape"] == [32, 48, 3]
    spans = parquet.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert spans[f"videos/{key}/from_timestamp"] == [0, 7 / 50]
    assert spans[f"videos/{key}/to_timestamp"] == [7 / 50, 12 / 50]
    film = out / info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
    with av.open(str(film)) as container:
        frames = list(container.decode(video=0))
    assert [frame.time for frame in frames] == pytest.approx([n / 50 for n in range(12)], abs=1e-4)
    seen = [frame.to_ndarray(format="rgb24").mean() for frame in frames]
    shown = [picture.mean() for one in episodes for picture in numbered(one)]
    assert np.allclose(seen, shown, atol=6)
    stats = json.loads((out / "meta/stats.json").read_text())[key]
    assert np.shape(stats["mean"]) == (3, 1, 1) and 0 < stats["mean"][0][0][0] < 1


def test_cameras_see_the_object():
    one = rising(3, 2)
    for camera in ("front", "wrist"):
        first, second = episode_pictures(one, HAND, THING, camera, (64, 48))
        assert first.shape == (48, 64, 3) and not np.array_equal(first, second)
        away = replace(one, object_pose=one.object_pose + np.float32([0, 0, -1, 0, 0, 0, 0]))
        assert not np.array_equal(next(episode_pictures(away, HAND, THING, camera, (64, 48))), first)
    with pytest.raises(FungraspError, match="front and wrist"):
        next(episode_pictures(one, HAND, THING, "side"))  # type: ignore[arg-type]


def test_the_command_draws_what_cameras_see(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    rising(3, 4).save(tmp_path / "in" / "0003_mug.npz")
    words = ["--cameras", "front", "wrist", "--size", "64", "48", "--out", str(tmp_path / "set"), "--json"]
    assert main(["export", str(tmp_path / "in"), *words]) == 0
    assert json.loads(capsys.readouterr().out)["written"] == [str(tmp_path / "set")]
    assert len(list((tmp_path / "set" / "videos").rglob("*.mp4"))) == 2


def test_lerobots_own_loader_takes_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    loader = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="LeRobot is not installed")
    out = write_lerobot_dataset([episode(3), episode(4, "box", 5)], tmp_path / "set", {"front": numbered})
    dataset = loader.LeRobotDataset("lift", root=out)
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (12, 2, 50)
    assert dataset[11]["task"] == "lift the box"
    for row, index, number in ((2, 3, 2), (9, 4, 2), (11, 4, 4)):
        picture = dataset[row]["observation.images.front"].numpy()
        assert picture.shape == (3, 32, 48) and abs(255 * picture.mean() - 20 * number - index) < 6


def test_what_can_not_be_exported_is_said(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    (tmp_path / "there").mkdir()
    cases = (
        ([], "x", "no episodes"),
        ([episode(), replace(episode(), hand="shadow")], "x", "of one hand"),
        ([replace(episode(), controls=None)], "x", "no controls"),
        ([replace(episode(), times=np.array([0, 1, 2, 3, 4, 5, 9.0]))], "x", "not evenly spaced"),
        ([episode()], "there", "already exists"),
    )
    for episodes, name, words in cases:
        with pytest.raises(FungraspError, match=words):
            write_lerobot_dataset(episodes, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there"]
    assert main(["export", str(tmp_path / "there"), "--out", str(tmp_path / "y")]) == 2
