"""What pages are made of, without a browser; and what can not be viewed, in a line each."""

from __future__ import annotations

import json
import socket
from dataclasses import replace

import numpy as np
import pytest

import fungrasp
from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose
from fungrasp.grasps import builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.objects import builtin_object
from fungrasp.viewer.choose_page import choose_page
from fungrasp.viewer.episode_stage import EpisodeState, EpisodeStates
from fungrasp.viewer.page import Worker
from fungrasp.viewer.plan_page import planned_states
from fungrasp.viewer.result_page import AS_SHOWN, FAILED, HELD, OTHERWISE, ShownResult, _kind, _reason
from fungrasp.viewer.robot_view import RobotView, quality_rows

pytest.importorskip("viser", reason="the extra viewer is not installed")


def test_single_grasps_and_plans_have_pages(tmp_path):
    robot = fungrasp.retarget(builtin_grasps()[50])
    plans = fungrasp.plan(robot)
    plans.save(tmp_path / "plan.npz")
    for what, title in (
        (builtin_grasps()[0], "Grasps"),
        (robot, "Robot grasps"),
        (plans, "Plans"),
        (tmp_path / "plan.npz", "Plans"),
    ):
        assert choose_page(what, None, "allegro").title == title
    states = planned_states(plans, 0, load_hand("allegro"))
    first, last = states[0], states[len(states) - 1]
    start = compose(plans.object_pose, plans.palm_setpoint_object[:, 0])[0]
    np.testing.assert_allclose(first.palm_pose, start)
    assert last.phase == "lift" and last.object_pose[2] - first.object_pose[2] == pytest.approx(0.1, abs=0.05)
    with pytest.raises(FungraspError, match="unknown object 'thing'"):
        choose_page(replace(plans, object_name=np.array(["thing"])), None, "allegro")


def test_a_port_in_use_is_said():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(
            FungraspError, match=f"127.0.0.1:{port}: Address already in use; choose another port"
        ):
            fungrasp.view("allegro", port=port, wait=False)


def test_it_listens_where_only_this_machine_reaches_it():
    with fungrasp.view("allegro", port=0, wait=False) as viewer:
        assert "only this machine" in viewer.summary
        port = int(viewer.url.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=5):
            pass
        own = socket.gethostbyname(socket.gethostname())
        if own != "127.0.0.1":
            with pytest.raises(OSError), socket.create_connection((own, port), timeout=2):
                pass


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_imitates_follows_and_is_judged(side, request):
    """What the page of a grasp does with a hand, in a scene of no browser."""
    import viser

    server = viser.ViserServer("127.0.0.1", port=0, verbose=False)
    request.addfinalizer(server.stop)
    human, model = builtin_grasps().select(np.array([0]))[0], builtin_object(builtin_grasps().object_name[0])
    hand = load_hand("inspire")
    hand = hand if side == "right" else replace(hand, side="left")
    view = RobotView(server.scene, "/robot", np.zeros(3), hand, model)
    view.imitate(human, "angle-copy")
    before, quality = view.grasp, view.quality(human)
    assert view.touch is not None and quality is not None and view.marks is not None
    assert view.marks.shown.mean() == pytest.approx(quality.shown_share[0])
    rows = dict(quality_rows([view], [quality]))
    assert rows["As shown"] == ("yes ✓" if quality.held_as_shown[0] else "no ✗")
    assert rows["Place error"] == f"{quality.place_error_mm[0]:.2f} mm"
    assert len(view._marks._places) == 3
    away = human.object_pose + np.array([0.1, 0, 0, 0, 0, 0, 0])
    view.follow(replace(human, object_pose=away, hand_joints=human.hand_joints + np.array([0.1, 0, 0])))
    moved = view.grasp.wrist_pose[:3] - before.wrist_pose[:3]
    assert 0.05 < np.linalg.norm(moved) < 0.2
    assert len(view.grasp_set()) == 1
    assert view.marks is None and not view._marks._places, "the person's places have moved on"


def test_episodes_are_told_apart_by_how_they_were_held():
    known = {"success": True, "place_error_mm": 12.0}
    episodes = [
        {"success": False, "reason": "held too low", "place_error_mm": 12.0},
        {"success": True, "place_error_mm": None},
        known | {"held_as_shown": False, "not_as_shown": "fingers do not touch"},
        known | {"held_as_shown": True},
    ]
    assert [_kind(e) for e in episodes] == [FAILED, HELD, OTHERWISE, AS_SHOWN]
    assert [_reason(e) for e in episodes] == ["held too low", "", "fingers do not touch", ""]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("nothing.npz", None, "there is no file, folder or hand"),
        ("damaged.npz", b"PK\x03\x04 not really", "damaged.npz"),
        ("damaged.json", b'{"rows": ', "damaged.json"),
        ("other.json", b'{"trials": [{"a": 1}]}', "no episodes of a lift test"),
        ("short.mcap", b"\x89MCAP0\r\n", "ends before a plan was made"),
        ("text.txt", b"words", "can be viewed"),
    ],
)
def test_what_is_damaged_is_said_in_a_line(name, content, words, tmp_path, capsys):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert main(["view", str(path)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_options_that_do_not_fit_are_said(capsys):
    assert main(["view", "--mesh", "mug"]) == 2
    assert main(["view", "--grasps", "a.npz"]) == 2
    assert main(["view", "allegro", "--objects", "meshes"]) == 2
    assert capsys.readouterr().err.count("error: ") == 3
    with pytest.raises(FungraspError, match="expected human or robot grasps, not a list"):
        choose_page([1], None, "allegro")


def test_a_result_without_recordings_or_grasps_says_why(tmp_path):
    trials = [{"index": 0, "object": "mug", "success": False, "reason": "dropped", "seed": 0}]
    (tmp_path / "result.json").write_text(
        json.dumps({"hand": "allegro", "command": "fungrasp evaluate --grasps gone.npz", "trials": trials})
    )
    from fungrasp.evaluation import read_result

    shown = ShownResult.read(tmp_path / "result.json", read_result(tmp_path / "result.json"))
    assert shown.grasps is None and shown.recordings is None
    assert "the grasp file was moved" in shown.missing


def test_curves_of_an_episode():
    frames = EpisodeStates()
    pose = np.array([0.0, 0, 0.1, 1, 0, 0, 0])

    def up(height: float) -> np.ndarray:
        return np.array([0, 0, height, 0, 0, 0, 0])

    base = EpisodeState(0.0, "approach", pose, pose, np.zeros(2), np.zeros(3, dtype=bool))
    lifted = replace(base, time=1.0, phase="lift", object_pose=pose + up(0.1))
    slipped = replace(lifted, time=2.0, palm_pose=pose + up(0.03))
    for frame in (base, lifted, slipped):
        frames.add(frame)
    curves = frames.curves()
    assert curves.height == pytest.approx([0, 100, 100]) and curves.slip == pytest.approx([0, 0, 30])
    assert np.isnan(curves.force).all()
    assert [frames.index_at(t) for t in (-1, 0.5, 1.0, 9)] == [0, 0, 1, 2]


def test_of_jobs_of_a_kind_the_last_counts():
    import threading

    began, go, done, failed = threading.Event(), threading.Event(), [], []
    worker = Worker(failed.append)

    def wait() -> None:
        began.set()
        go.wait(10)

    worker.ask("a", wait)
    assert began.wait(10)
    for number in range(5):
        worker.ask("b", lambda number=number: done.append(number))

    def fail() -> None:
        raise FungraspError("a reason")

    worker.ask("c", fail)
    last = threading.Event()
    worker.ask("d", last.set)
    go.set()
    assert last.wait(10)
    assert done == [4] and failed == ["a reason"]
    worker.close()
    worker._thread.join(5)
    assert not worker._thread.is_alive()
