"""``fungrasp demo``: what is shown, the film and the page, failures told, bad input refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import av
import numpy as np
import pytest

from fungrasp.cli.demo import FAVORITES
from fungrasp.cli.main import main
from fungrasp.grasps import builtin_grasps
from fungrasp.grasps.grasp_arguments import picked_rows
from fungrasp.media import demonstration
from fungrasp.perception import HandEstimate, ObjectEstimate, pipeline
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import builtin_truth, read_folder
from fungrasp.perception.perceived import Perceived


@pytest.fixture(autouse=True)
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demonstration, "FILM", replace(demonstration.FILM, fps=2.0, width=240, height=136))


def test_a_film_and_a_page_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "shown" / "here"
    assert main(["demo", "--grasp", "flashlight", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["film.mp4", "index.html"]
    said = capsys.readouterr()
    assert f"film: {out / 'film.mp4'}" in said.out
    assert f"page: {out / 'index.html'}" in said.out
    assert all(re.fullmatch(r"[\w ]+: \d+ %", line) for line in said.err.splitlines())
    with av.open(str(out / "film.mp4")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) > 8
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 2.0, "nothing moves"
    page = (out / "index.html").read_text()
    assert "Flashlight, to light" in page
    assert "allegro-student-free" in page, "the freely licensed student moves the hand"
    assert "data:video/mp4;base64," in page
    assert page.count("data:image/png;base64,") == 2
    assert not re.search(r"(src|href)=\"(?!data:|#)", page), "the page needs another file"
    assert "Use (press switch):" in page and "Use (press switch):" in said.out
    assert page.count("data:video/mp4;base64,") == 2, "the lift and the use"
    assert (
        ("wanted contacts reached" in page)
        and ("as shown" in page)
        and ("Place error" in page)
        and ("Slip" in page)
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--hand", "alegro"], "Did you mean 'allegro'?"),
        (["--grasp", "mugg"], "unknown grasp 'mugg'. Did you mean 'mug'?"),
        (["--grasp", "9999"], "--grasp 9999: the grasps are numbered 0 to"),
        (["--grasp", "mug", "mug"], "is picked twice"),
        (["--count", "0"], "--count must be at least 1"),
        (["--seed", "-1"], "--seed must be at least 0"),
        (["--policy", "allegro-studnt"], "Did you mean 'allegro-student-free'"),
        (["--grasps", "nowhere.npz"], "nowhere.npz"),
        (["--objects", "nowhere"], "nowhere"),
        (["--mesh", "mug"], "--mesh needs --from-image FOLDER"),
        (["--from-image", "--grasp", "mug"], "--grasp needs grasps, not an image"),
        (["--from-image", "--mesh", "mug"], "the built-in image has its own object"),
        (["--from-image", "nowhere"], "--mesh is missing"),
        (["--from-image", "nowhere", "--mesh", "mug"], "the folder nowhere does not exist"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["demo", "--out", str(out), *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_a_file_in_the_way_of_the_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("mine")
    assert main(["demo", "--out", str(tmp_path / "out")]) == 2
    assert str(tmp_path / "out") in capsys.readouterr().err
    assert (tmp_path / "out").read_text() == "mine"


def test_an_interruption_leaves_no_half_written_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fungrasp.media import episode_film as film

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(film, "captioned", interrupted)
    assert main(["demo", "--grasp", "flashlight", "--out", str(tmp_path / "out")]) == 130
    assert list((tmp_path / "out").iterdir()) == []


def test_the_favorites_exist_and_come_first() -> None:
    grasps = builtin_grasps()
    assert grasps.task is not None
    rows = picked_rows(grasps, (), 4, FAVORITES)
    shown = [f"{grasps.object_name[row]}:{grasps.task[row]}" for row in rows]
    assert shown == list(FAVORITES)


def test_more_than_the_favorites_are_of_other_objects_first() -> None:
    grasps = builtin_grasps()
    objects = len(set(grasps.object_name.tolist()))
    rows = picked_rows(grasps, (), objects, FAVORITES)
    assert len({grasps.object_name[row] for row in rows}) == objects
    assert sorted(picked_rows(grasps, (), 10_000, FAVORITES)) == list(range(len(grasps)))


def test_picks_keep_their_order_and_may_be_numbers() -> None:
    grasps = builtin_grasps()
    rows = picked_rows(grasps, ("3", "drill", "mug:hand over"), 1)
    assert rows[0] == 3
    assert grasps.object_name[rows[1]] == "drill"
    assert grasps.task is not None
    assert grasps.task[rows[2]] == "hand over"


@pytest.fixture
def see(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets the next image be seen as it truly is, without the hand models."""
    truth = builtin_truth()

    def set_up(side: Literal["right", "left"] = "right", score: float = 0.9) -> None:
        real = pipeline.perceive

        def seen(capture, model, **options) -> Perceived:
            pixels = read_folder(FOLDER).intrinsics.project(truth.joints_camera)
            covariance = np.tile(np.eye(3) * 0.004**2, (21, 1, 1))
            hand = HandEstimate(truth.joints_camera, pixels, np.full(21, 0.9), covariance, side, score)
            obj = ObjectEstimate(truth.pose_camera_object, 0.95, True)
            return real(capture, model, hand=hand, object_estimate=obj, **options)

        monkeypatch.setattr(pipeline, "perceive", seen)

    return set_up


@pytest.mark.slow
def test_from_the_built_in_image_to_the_lift(
    see: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    see()
    assert main(["demo", "--out", str(tmp_path), "--from-image"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "index.html"]
    assert "Spray bottle, to spray: " in capsys.readouterr().out
    page = (tmp_path / "index.html").read_text()
    parts = ("✓ Sure: ", "In the image", "How far it is from the truth", "data:video/mp4", "Place error")
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    assert not re.search(r"(src|href)=\"(?!data:|#)", page), "the page needs another file"


def test_what_is_not_sure_is_not_tried(
    see: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    see(score=0.2)
    arguments = ["--from-image", str(FOLDER), "--mesh", "spray_bottle", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as end:
        main(["demo", *arguments])
    assert end.value.code == 3
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    said = capsys.readouterr()
    assert "not sure: " in said.err
    assert "the robot does not try it" in said.err
    page = (tmp_path / "index.html").read_text()
    assert "? Not sure: " in page
    assert "from the truth" not in page


def test_without_the_hand_models_the_demo_says_what_to_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))
    assert main(["demo", "--from-image", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "run 'fungrasp setup perception' once" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()
