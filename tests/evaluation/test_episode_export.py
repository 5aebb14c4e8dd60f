"""Recorded episodes for other programs: what is read back is what was written."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.evaluation.episode_export import (
    read_mcap_episode,
    write_lerobot_dataset,
    write_mcap_episodes,
)
from fungrasp.hands import load_hand

HAND = load_hand("inspire")


def episode(index: int = 3, name: str = "mug", size: int = 7) -> Trajectory:
    rng = np.random.default_rng(index)

    def numbers(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    joints, servos = len(HAND.joint_names), len(HAND.actuators)
    return Trajectory(
        hand="inspire",
        object_name=name,
        object_mass=0.35,
        index=index,
        success=index % 2 == 1,
        reason="" if index % 2 else "dropped during the hold",
        times=np.arange(size, dtype=np.float32) * np.float32(0.02),
        qpos=numbers(size, 20),
        wrist_reference=numbers(7),
        object_pose=numbers(size, 7),
        palm_pose=numbers(size, 7),
        joint_positions=numbers(size, joints),
        link_contacts=rng.random((size, len(HAND.links))) > 0.5,
        phase=np.array([0] * 3 + [1] * (size - 3), dtype=np.int8),
        controls=numbers(size, 6 + servos),
        differs="mass friction",
    )


@pytest.mark.parametrize("controls", [True, False])
def test_mcap_loses_nothing(controls, tmp_path):
    pytest.importorskip("mcap", reason="the extra deploy is not installed")
    first = episode() if controls else replace(episode(), controls=None)
    path, other = write_mcap_episodes([first, episode(4, "box")], tmp_path)
    back = read_mcap_episode(path)
    for field in fields(Trajectory):
        assert np.array_equal(getattr(back, field.name), getattr(first, field.name)), field.name
    assert other.name == "0004_box.mcap"


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


def test_lerobots_own_loader_takes_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    loader = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="LeRobot is not installed")
    out = write_lerobot_dataset([episode(3), episode(4, "box", 5)], tmp_path / "set")
    dataset = loader.LeRobotDataset("lift", root=out)
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (12, 2, 50)
    assert dataset[11]["task"] == "lift the box"


def test_what_can_not_be_exported_is_said(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    (tmp_path / "there").mkdir()
    cases = (
        ([], "x", "no episodes"),
        ([episode(), replace(episode(), hand="shadow")], "x", "of one hand"),
        ([replace(episode(), controls=None)], "x", "no controls"),
        ([replace(episode(), times=np.array([0, 1, 2, 3, 4, 5, 9.0]))], "x", "not evenly spaced"),
        ([episode()], "there", "exists already"),
    )
    for episodes, name, words in cases:
        with pytest.raises(FungraspError, match=words):
            write_lerobot_dataset(episodes, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there"]
    assert main(["export", str(tmp_path / "there"), "--out", str(tmp_path / "y")]) == 2
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n damaged")
    with pytest.raises(FungraspError, match="no episode that was exported"):
        read_mcap_episode(tmp_path / "bad.mcap")


def test_the_command_writes_both(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    episode().save(tmp_path / "in" / "0003_mug.npz")
    assert main(["export", str(tmp_path / "in"), "--out", str(tmp_path / "set")]) == 0
    assert main(["export", str(tmp_path / "in"), "--format", "mcap", "--out", str(tmp_path / "mcap")]) == 0
    assert "1 episodes" in capsys.readouterr().out and (tmp_path / "mcap" / "0003_mug.mcap").is_file()
