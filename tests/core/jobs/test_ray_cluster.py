"""Work on a Ray cluster gives what one process gives, whatever happens to the machines."""

import json
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from fungrasp.cli.main import main as fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import RayCluster
from fungrasp.grasps import (
    builtin_grasps,
    load_objects,
    load_robot_grasps,
    save_human_grasps,
    save_robot_grasps,
)
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget

ray = pytest.importorskip("ray", reason='needs Ray: pip install "fungrasp[ray]"')
pytestmark = pytest.mark.timeout(600)


def add(shared: int, a: int, b: int) -> int:
    if b < 0:
        raise FungraspError(f"{b} is negative")
    return shared + a + b


def slow(shared: None, number: int) -> int:
    time.sleep(0.5)
    return number


@pytest.fixture(autouse=True, scope="module")
def sent_along():
    """The functions of this file go to the machines, which can't import it."""
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    yield
    ray.cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


@pytest.fixture
def cluster():
    """Two machines with a processor each, and a head that does no work."""
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    made.killable = [made.add_node(num_cpus=1) for _ in range(2)][1]
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    human = builtin_grasps().select(np.arange(0, 120, 5))
    path = tmp_path_factory.mktemp("grasps") / "robot.npz"
    save_robot_grasps(path, retarget(human, load_objects(human), load_hand("allegro"), threads=2))
    return path


def kill_after(cluster, ready) -> threading.Thread:
    """Kills one machine as soon as there is a first result."""

    def kill() -> None:
        until = time.monotonic() + 300
        while not ready() and time.monotonic() < until:
            time.sleep(0.05)
        cluster.remove_node(cluster.killable, allow_graceful=False)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def test_every_job_is_done_once_on_this_machine():
    done = {}
    RayCluster().run(
        add, [(i, 2 * i) for i in range(20)], lambda job, result: done.update({job: result}), shared=5
    )
    assert done == {(i, 2 * i): 5 + 3 * i for i in range(20)}


def test_errors_of_the_work_are_ours():
    with pytest.raises(FungraspError, match="-1 is negative"):
        RayCluster().run(add, [(0, -1)], lambda job, result: None, shared=0)


def test_no_cluster_at_an_address():
    with pytest.raises(FungraspError, match="no Ray cluster at 'nobody:1'"):
        RayCluster("nobody:1").run(add, [(0, 0)], lambda job, result: None)


def where(shared: None) -> str:
    return str(Path.cwd())


@pytest.mark.slow
def test_relative_paths_mean_the_same(cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found: list[str] = []
    RayCluster(cluster.address).run(where, [()], lambda job, result: found.append(result))
    assert found == [str(tmp_path)]


@pytest.mark.slow
def test_jobs_of_a_lost_machine_are_done_again(cluster):
    done: list[int] = []
    killing = kill_after(cluster, lambda: len(done) >= 3)
    RayCluster(cluster.address).run(slow, ((i,) for i in range(16)), lambda job, result: done.append(result))
    killing.join()
    assert sorted(done) == list(range(16))


@pytest.mark.slow
def test_evaluation_with_a_machine_lost_equals_that_of_one_process(cluster, grasps, tmp_path, monkeypatch):
    monkeypatch.setattr("fungrasp.evaluation.lift_evaluation.EPISODES", (2, 2))
    command = ["evaluate", "--grasps", str(grasps), "--protocol", "reality", "--threads", "1"]
    assert fungrasp([*command, "--json", str(tmp_path / "one.json")]) == 0
    parts = tmp_path / "many.json.partial"
    killing = kill_after(cluster, lambda: parts.is_dir() and len(list(parts.glob("*.npz"))) >= 2)
    assert fungrasp([*command, "--json", str(tmp_path / "many.json"), "--ray", cluster.address]) == 0
    killing.join()
    one, many = (json.loads((tmp_path / name).read_text()) for name in ("one.json", "many.json"))
    assert one["trials"] == many["trials"] and len(one["trials"]) == 24
    assert not parts.exists()


@pytest.mark.slow
def test_retargeting_on_this_machine_equals_that_of_one_process(tmp_path):
    human = builtin_grasps()
    save_human_grasps(tmp_path / "g.npz", human.select(np.arange(260) % len(human)))
    command = ["retarget", "--grasps", str(tmp_path / "g.npz"), "--out"]
    assert fungrasp([*command, str(tmp_path / "one.npz")]) == 0
    assert fungrasp([*command, str(tmp_path / "many.npz"), "--ray"]) == 0
    one, many = (load_robot_grasps(tmp_path / name) for name in ("one.npz", "many.npz"))
    np.testing.assert_array_equal(one.joint_positions, many.joint_positions)
    np.testing.assert_array_equal(one.wrist_pose, many.wrist_pose)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["g.npz", "many.npz", "one.npz"]


@pytest.mark.slow
def test_synthesis_with_a_machine_lost_equals_that_of_one_process(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("fungrasp.synthesis.synthesize.BATCH_SIZE", 2)
    command = ["grasps", "make", "--objects", "tennis_ball", "--seed", "0", "1"]
    assert fungrasp([*command, "--out", str(tmp_path / "one.npz")]) == 0
    parts = tmp_path / "many.npz.partial"
    killing = kill_after(cluster, lambda: parts.is_dir() and any(parts.glob("*.npz")))
    assert fungrasp([*command, "--out", str(tmp_path / "many.npz"), "--ray", cluster.address]) == 0
    killing.join()
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "many.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["many.npz", "one.npz"]


def test_what_does_not_go_with_a_cluster(tmp_path, capsys):
    assert fungrasp(["evaluate", "--ray"]) == 2
    assert "give --json or --out too" in capsys.readouterr().err
    assert fungrasp(["retarget", "--out", str(tmp_path / "a.npz"), "--ray", "a", "b"]) == 2
    assert "takes one address" in capsys.readouterr().err
