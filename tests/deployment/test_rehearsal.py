"""The whole way of a plan, seen by the safety filter and drawn before anything moves."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_cells import cell_and_hand, deploy, grasp_and_object

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import PreparedGrasp
from fungrasp.deployment.rehearsal import Motion, rehearse
from fungrasp.deployment.spec import Phase
from fungrasp.robots.cell import Obstacle
from fungrasp.robots.kinematics.arm_model import ClearanceModel
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.devices import TwinArm, TwinHand

pytest.importorskip("mink")


class Rehearsing(DeploymentObserver):
    """Rehearses what is planned, with another cell if there is one."""

    def __init__(self, **changed: Any):
        self._changed = changed
        self.motion: Any = None
        self.arm = np.zeros(0)

    def planned(self, robot: Robot, prepared: PreparedGrasp) -> None:
        usual, self.arm = robot.cell, robot.arm.read().positions
        robot.cell = replace(usual, **self._changed)
        try:
            self.motion = rehearse(robot, grasp_and_object()[0], prepared)
        finally:
            robot.cell = usual


@pytest.fixture(scope="module")
def motion() -> Motion:
    sent: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for device in (TwinArm, TwinHand):
            patch.setattr(device, "command", lambda self, *given: sent.append(self.name))
        observer = Rehearsing()
        assert deploy(observer, until="plan").fault == "" and not sent
    np.testing.assert_allclose(observer.motion.arm[[0, -1]], [observer.arm, observer.arm], atol=1e-3)
    return observer.motion


def test_a_rehearsal_sends_nothing_and_goes_the_whole_way(motion: Motion) -> None:
    phases = list(dict.fromkeys(motion.phases.tolist()))
    assert phases == ["move to start", "grasp", "lift", "hold", "put down", "home"]
    height = motion.object_pose[:, 2] - motion.object_pose[0, 2]
    assert height.max() == pytest.approx(0.15, abs=0.01) and abs(height[-1]) < 1e-9
    assert (np.diff(motion.times) > 0).all()


def test_on_the_way_back_fingers_are_as_they_were_there_on_the_way_in(motion: Motion) -> None:
    there = np.flatnonzero(motion.phases == "grasp")
    back = np.flatnonzero(motion.phases == "put down")[::5]
    apart = np.linalg.norm(motion.palm[back, None, :3] - motion.palm[None, there, :3], axis=2)
    # Once the hand has left the object, which stopped its fingers.
    away = np.linalg.norm(motion.palm[back, :3] - motion.palm[there[-1], :3], axis=1) > 0.05
    off = np.abs(motion.fingers[back] - motion.fingers[there[apart.argmin(axis=1)]]).max(axis=1)
    assert away.sum() > 5 and off[away & (apart.min(axis=1) < 0.005)].max() < 0.13


def test_nothing_is_collected_for_long_while_a_robot_moves() -> None:
    frozen: list[int] = []

    class Watching(DeploymentObserver):
        def setpoint(self, *_: Any) -> None:
            frozen.append(gc.get_freeze_count())

    assert deploy(Watching(), until="approach").fault == ""
    assert min(frozen) > 1000 and gc.get_freeze_count() == 0


def test_what_is_carried_out_is_what_was_rehearsed() -> None:
    class Watching(Rehearsing):
        rows: list[np.ndarray] = []  # noqa: RUF012

        def setpoint(self, phase: Phase, state: Any, command: Any) -> None:
            self.rows.append(command.arm)

    observer = Watching()
    deploy(observer, until="home")
    away = [np.abs(observer.motion.arm - posture).max(axis=1).min() for posture in observer.rows[::5]]
    # The arm begins within the twin's noise of where it was.
    assert max(away) < 0.01


def test_a_plan_that_the_safety_filter_would_stop_is_refused(motion: Motion) -> None:
    cell, hand = cell_and_hand()
    gaps = ClearanceModel(cell, hand)
    # Hands that opened at once over an object that was put down reached 27 mm into the table.
    down = motion.phases == Phase.PUT_DOWN
    reached = [gaps.measure(a, f).hand for a, f in zip(motion.arm[down], motion.fingers[down], strict=True)]
    assert min(reached) > -cell.workspace.hand_depth
    above = Rehearsing(workspace=replace(cell.workspace, hand_depth=-0.005))
    with pytest.raises(FungraspError, match=r"the safety filter would stop this plan while 'grasp'.*table"):
        deploy(above)


def test_a_real_robot_moves_for_nobody_who_is_not_asked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(
        'hand = "allegro"\n[arm]\ndriver = "ur-rtde"\naddress = "192.0.2.1"\n'
        "[mount]\npose_flange_hand = [0.0, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0]\n"
        '[hand_device]\ndriver = "allegro-can"\naddress = "can0"\n'
        '[tracker]\ndriver = "pose-stream"\naddress = "tcp://192.0.2.2:5556"\ncalibration_residual = 0.002\n'
    )
    assert main(["deploy", "--robot", str(cell), "--log", str(tmp_path / "log.mcap")]) == 2
    assert "run it in a terminal, or give --yes" in capsys.readouterr().err


def test_a_picture_is_drawn(motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    from fungrasp.media import plan_picture

    monkeypatch.setattr(plan_picture, "WIDTH", 160)
    monkeypatch.setattr(plan_picture, "HEIGHT", 120)
    (cell, hand), obj = cell_and_hand(), grasp_and_object()[1]
    pedestal = Obstacle((-0.5, 0.0, 0.14), (0.25, 0.25, 0.28))
    cell = replace(cell, obstacles=(pedestal,))
    rows = [int(np.argmax(motion.phases == phase)) for phase in dict.fromkeys(motion.phases)]
    few = replace(motion, **{name: value[rows] for name, value in vars(motion).items()})
    plan_picture.write_plan_picture(tmp_path / "lift.png", few, cell, hand, obj)
    seen = np.asarray(Image.open(tmp_path / "lift.png")).astype(int)
    assert seen.std() > 10
    # The pedestal is drawn: nothing else is as red.
    red, green, blue = np.moveaxis(seen, -1, 0)
    assert ((red > green + 25) & (red > blue + 25)).sum() > 200
