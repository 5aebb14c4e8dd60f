"""Cell files: what they hold, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.robots.cell import RobotCell, cell_files, load_cell, write_new_cell
from fungrasp.robots.kinematics.arm_model import Clearance
from fungrasp.robots.safety import check_posture

GOOD = 'hand = "allegro"\n'


@pytest.mark.parametrize("name", sorted(cell_files()))
def test_shipped_cells_load(name: str) -> None:
    cell = load_cell(name)
    assert cell.name == name
    assert cell.limits.palm_speed <= 0.25


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "'hand' is missing"),
        (
            GOOD + "[limits]\npalm_speed = 0.5\n",
            "'limits.palm_speed' is in m/s and may be at most 0.25",
        ),
        (GOOD + "[limits]\npalm_speed = -0.1\n", "'palm_speed' must be positive"),
        (
            GOOD + "[limits]\npalm_sped = 0.1\n",
            "no field 'palm_sped'; did you mean 'palm_speed'?",
        ),
        (GOOD + "[limits]\npalm_speed = 'fast'\n", "limits: palm_speed: expected a number, not 'fast'"),
        (GOOD + "[limits]\npalm_speed = nan\n", "limits: palm_speed: expected a finite number"),
        (GOOD + "[workspace]\nlower = [0, 0, 0.95]\n", "'workspace.lower' must be below"),
        (GOOD + "[workspace]\nlower = [0, 0]\n", "workspace: lower: expected a list of 3, not [0, 0]"),
        (GOOD + "[arm]\nmodel = 'ur6'\n", "unknown arm 'ur6'. Did you mean 'ur5'?"),
        (GOOD + "[arm]\npose_world_base = [0, 0, 0, 2, 0, 0, 0]\n", "unit quaternion"),
        (
            GOOD + "[arm]\ndriver = 'ur-rtde'\naddress = '192.168.0.10'\n",
            "'mount.pose_flange_hand' is missing",
        ),
        (GOOD + "[mount]\npose_flange_hand = [0, 0, 0.1, 2, 0, 0, 0]\n", "unit quaternion"),
        (GOOD + "[mount]\nadapter_radius = 0.04\n", "'mount.adapter_length'"),
        (GOOD + "[tracker]\ncalibration_residual = 0.5\n", "is 500.0 mm, more than 5 mm"),
        (
            GOOD + "[limits]\nsetpoint_lead = 0.5\n",
            "setpoint_lead' is in rad and may be at most 0.35, not",
        ),
        (GOOD + "[[obstacles]]\ncenter = [0, 0, 0]\n", "obstacles[0]: the field 'size' is missing"),
        (GOOD + "[[obstacles]]\ncenter = [0, 0, 0]\nsize = [1, 1, 0]\n", "a size of positive numbers"),
        (GOOD + "[obstacles]\ncenter = [0, 0, 0]\n", "obstacles: expected a list"),
        (GOOD + "[watchdog]\noverrun = 0.01\n", "'watchdog.overrun' must be greater"),
        (GOOD + "arm = 3\n", "arm: expected the fields of ArmSettings, not 3"),
        (GOOD + "hand_dynamics = 'none.toml'\n", "run 'fungrasp identify fit'"),
        ("hand =", "is not valid TOML"),
    ],
)
def test_bad_cells_are_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(text)
    with pytest.raises(FungraspError) as error:
        load_cell(path)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("hand", ["allegro", "inspire", "leap"])
def test_a_new_cell_is_slow_and_refused_until_it_is_filled_in(tmp_path: Path, hand: str) -> None:
    path = tmp_path / "mine.toml"
    write_new_cell(path, hand)
    with pytest.raises(FungraspError, match="already exists"):
        write_new_cell(path, hand)
    text = path.read_text()
    filled = {
        'address = ""': 'address = "192.168.0.10"',
        "pose_world_base = []": "pose_world_base = [-0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]",
        "home = []": "home = [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]",
        "pose_flange_hand = []": "pose_flange_hand = [0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]",
    }
    for empty, measured in filled.items():
        with pytest.raises(FungraspError, match=r"missing|must be|must have"):
            load_cell(path)
        text = text.replace(empty, measured, 1)
        path.write_text(text)
    cell = load_cell(path)
    assert cell.limits.palm_speed <= 0.05 and cell.workspace.hand_depth < 0
    assert cell.tracker.calibration_residual < 0


@pytest.mark.parametrize("name", [name for name in cell_files() if "emulated" in name])
def test_an_emulators_cell_is_none_of_a_robot(tmp_path: Path, name: str) -> None:
    path = tmp_path / "copied.toml"
    text = cell_files()[name].read_text().replace("127.0.0.2", "192.168.0.10")
    path.write_text(text + "[mount]\npose_flange_hand = [0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0]\n")
    with pytest.raises(FungraspError, match=r"options.acceleration' is in rad/s\^2 and may be at most 10"):
        load_cell(path)


def test_a_cell_that_says_that_its_safety_filter_is_on_still_loads(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(GOOD + 'guard = "on"\n')
    assert load_cell(path).hand == "allegro"
    path.write_text(GOOD + 'guard = "off"\n')
    with pytest.raises(FungraspError, match="no field 'guard'"):
        load_cell(path)


def test_a_hand_stays_above_the_table_unless_its_cell_says_otherwise() -> None:
    box, palm = RobotCell("allegro").workspace, np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0])
    assert check_posture(palm, Clearance(0.03, 0.006, 0.03), box) == ""
    assert "too near" in check_posture(palm, Clearance(0.03, 0.004, 0.03), box)
    assert check_posture(palm, Clearance(0.03, -0.01, 0.03), load_cell("ur5e-allegro").workspace) == ""


def test_unknown_names() -> None:
    with pytest.raises(FungraspError, match="Did you mean 'ur5e-allegro'"):
        load_cell("ur5-allegro")


def test_a_wired_cell_that_says_how_its_hand_is_mounted(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    mount = "[mount]\npose_flange_hand = [0, 0, 0.156, 0.7071, 0, 0, 0.7071]\n"
    path.write_text(GOOD + "[arm]\ndriver = 'ur-rtde'\naddress = '192.168.0.10'\n" + mount)
    assert load_cell(path).mount.pose_flange_hand[2] == 0.156
