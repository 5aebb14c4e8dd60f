"""Whether the base of an arm is where its cell says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from robot_cells import cell_and_hand

from fungrasp.cli.main import main
from fungrasp.errors import FungraspError
from fungrasp.robots.calibration.base_check import check_base
from fungrasp.robots.kinematics.arm_model import ArmKinematics

JOINTS = np.array([[turn, -1.5, 2.0, -2.0, -1.57, 0.0] for turn in (-0.6, 0.0, 0.7)])


def touched(file: Path, turn: float = 0.0, shift: float = 0.0) -> str:
    """What a person writes down where the base is turned about z, at its foot, and shifted along x."""
    cell, hand = cell_and_hand()
    kinematics, base = ArmKinematics(cell, hand), np.array(cell.arm.pose_world_base[:3])
    points = np.array([kinematics.flange_position(q) for q in JOINTS]) - base
    c, s = np.cos(turn), np.sin(turn)
    points = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + base + [shift, 0, 0]
    file.write_text(json.dumps({"joints": JOINTS.tolist(), "flange": points.tolist()}))
    return str(file)


def test_a_base_that_is_turned_or_shifted_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check = ["robots", "check", "ur5e-allegro", "--touched"]
    assert main([*check, touched(tmp_path / "a.json", shift=0.002)]) == 0
    assert "3 touched points within 2.0 mm" in capsys.readouterr().out
    # Heights are the same: points on the table alone do not show it.
    assert main([*check, touched(tmp_path / "b.json", turn=np.pi)]) != 0
    said = capsys.readouterr().err
    assert "180 degrees about z" in said and "the pendant's Base is turned by 180 degrees from ours" in said
    assert main([*check, touched(tmp_path / "c.json", shift=0.02)]) != 0
    assert "turned by 0 degrees about z, and off by (20, 0, 0) mm" in capsys.readouterr().err


def test_too_few_or_too_near_points_are_refused() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0]])
    with pytest.raises(FungraspError, match="3 touched points or more"):
        check_base(points[:2], points[:2])
    with pytest.raises(FungraspError, match="too near"):
        check_base(0.1 * points, 0.1 * points)
