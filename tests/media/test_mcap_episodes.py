"""Recorded episodes for other programs: what is read back is what was written."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from recorded_episodes import episode

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.media.mcap_episodes import read_mcap_episode, write_mcap_episodes


@pytest.mark.parametrize("controls", [True, False])
def test_mcap_loses_nothing(controls, tmp_path):
    pytest.importorskip("mcap", reason="the extra deploy is not installed")
    first = episode() if controls else replace(episode(), controls=None)
    path, other = write_mcap_episodes([first, episode(4, "box")], tmp_path)
    back = read_mcap_episode(path)
    for field in fields(Trajectory):
        assert np.array_equal(getattr(back, field.name), getattr(first, field.name)), field.name
    assert other.name == "0004_box.mcap"


def test_a_damaged_mcap_is_said(tmp_path):
    pytest.importorskip("mcap", reason="the extra deploy is not installed")
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n damaged")
    with pytest.raises(FungraspError, match="not an exported episode"):
        read_mcap_episode(tmp_path / "bad.mcap")


def test_the_command_writes_both(tmp_path, capsys):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    episode().save(tmp_path / "in" / "0003_mug.npz")
    assert main(["export", str(tmp_path / "in"), "--out", str(tmp_path / "set")]) == 0
    assert main(["export", str(tmp_path / "in"), "--format", "mcap", "--out", str(tmp_path / "mcap")]) == 0
    assert "1 episodes" in capsys.readouterr().out and (tmp_path / "mcap" / "0003_mug.mcap").is_file()
