"""The package of ``examples`` with LeRobot itself, where that is installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_robots import twin_robot

from fungrasp.robots.device import RobotError
from fungrasp.robots.twin.world import TwinWorld

lerobot = pytest.importorskip("lerobot.robots", reason="LeRobot is not installed: pip install lerobot")
pytest.importorskip("mink")

EXAMPLE = Path(__file__).parents[2] / "examples" / "lerobot_robot_fungrasp"


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLE))
    import lerobot_robot_fungrasp

    return lerobot_robot_fungrasp


@pytest.fixture
def robot(package: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, TwinWorld]]:
    """LeRobot's own factory makes it; a twin stands in for the wires."""
    from lerobot.robots import make_robot_from_config

    robot, world = twin_robot()
    module = sys.modules["lerobot_robot_fungrasp.fungrasp_robot"]
    monkeypatch.setattr(module, "wired_robot", lambda *a: robot)
    config = package.FungraspRobotConfig(id="one", calibration_dir=tmp_path)
    made = make_robot_from_config(config)
    yield made, world
    if made.is_connected:
        made.disconnect()


def test_it_is_a_robot_of_lerobot(package: Any, robot: tuple[Any, TwinWorld]) -> None:
    made, _ = robot
    assert isinstance(made, lerobot.Robot)
    assert made.robot_type == "fungrasp"
    assert lerobot.RobotConfig.get_choice_class("fungrasp") is package.FungraspRobotConfig
    assert made.is_calibrated
    made.calibrate()
    made.configure()


def test_it_observes_and_acts_as_lerobots_loop_asks(robot: tuple[Any, TwinWorld]) -> None:
    made, world = robot
    with pytest.raises(RobotError, match="not connected"):
        made.get_observation()
    with made:
        assert made.is_connected
        world.advance(world.time + 0.2)
        seen = made.get_observation()
        assert list(seen) == list(made.observation_features)
        assert all(isinstance(value, float) for value in seen.values())
        action = {name: seen.get(name, 0.0) for name in made.action_features}
        action["palm.y"] += 0.05
        for _ in range(15):
            sent = made.send_action(action)
            world.advance(world.time + 0.02)
        assert list(sent) == list(made.action_features)
        assert sent["palm.y"] == pytest.approx(action["palm.y"], abs=1e-3)
        world.advance(world.time + 0.3)
        assert made.get_observation()["palm.y"] == pytest.approx(action["palm.y"], abs=5e-3)
        with pytest.raises(RobotError, match="lacks lift"):
            made.send_action({name: value for name, value in action.items() if name != "lift"})
    assert not made.is_connected


def test_a_frame_of_a_data_set_holds_its_numbers(robot: tuple[Any, TwinWorld]) -> None:
    from lerobot.datasets.utils import build_dataset_frame, hw_to_dataset_features

    made, world = robot
    features = hw_to_dataset_features(made.observation_features, "observation")
    names = features["observation.state"]["names"]
    assert names == list(made.observation_features)
    with made:
        world.advance(world.time + 0.2)
        seen = made.get_observation()
    frame = build_dataset_frame(features, seen, prefix="observation")
    np.testing.assert_allclose(frame["observation.state"], [seen[name] for name in names], rtol=1e-6)
