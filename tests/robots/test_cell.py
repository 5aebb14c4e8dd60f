"""Cell files: what they hold, and what is refused."""

from pathlib import Path

import pytest

from fungrasp.errors import FungraspError
from fungrasp.robots.cell import cell_files, load_cell

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
        (GOOD + "[limits]\npalm_speed = 0.5\n", "'palm_speed' may be at most 0.25, not 0.5"),
        (GOOD + "[limits]\npalm_speed = -0.1\n", "'palm_speed' must be positive"),
        (GOOD + "[limits]\npalm_sped = 0.1\n", "Did you mean 'limits.palm_speed'"),
        (GOOD + "[limits]\npalm_speed = 'fast'\n", "'limits.palm_speed' must be a finite number"),
        (GOOD + "[limits]\npalm_speed = nan\n", "'limits.palm_speed' must be a finite number"),
        (GOOD + "[workspace]\nlower = [0, 0, 0.95]\n", "'workspace.lower' must be below"),
        (GOOD + "[workspace]\nlower = [0, 0]\n", "must have 3 numbers"),
        (GOOD + "[arm]\nmodel = 'ur6'\n", "unknown arm 'ur6'. Did you mean 'ur5'?"),
        (GOOD + "[arm]\npose_world_base = [0, 0, 0, 2, 0, 0, 0]\n", "unit quaternion"),
        (
            GOOD + "[arm]\ndriver = 'ur-rtde'\naddress = '192.168.0.10'\n",
            "'mount.pose_flange_hand' is missing",
        ),
        (GOOD + "[mount]\npose_flange_hand = [0, 0, 0.1, 2, 0, 0, 0]\n", "unit quaternion"),
        (GOOD + "[mount]\nadapter_radius = 0.04\n", "'mount.adapter_length'"),
        (GOOD + "[watchdog]\noverrun = 0.01\n", "'watchdog.overrun' must be greater"),
        (GOOD + "arm = 3\n", "'arm' must be a table"),
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


def test_unknown_names() -> None:
    with pytest.raises(FungraspError, match="Did you mean 'ur5e-allegro'"):
        load_cell("ur5-allegro")


def test_a_wired_cell_that_says_how_its_hand_is_mounted(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    mount = "[mount]\npose_flange_hand = [0, 0, 0.156, 0.7071, 0, 0, 0.7071]\n"
    path.write_text(GOOD + "[arm]\ndriver = 'ur-rtde'\naddress = '192.168.0.10'\n" + mount)
    assert load_cell(path).mount.pose_flange_hand[2] == 0.156
