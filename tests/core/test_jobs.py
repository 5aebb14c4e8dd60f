"""Long work in parts: kept, grouped, gone on with where it was, and the same on a Ray cluster."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fungrasp.cli.main import main as fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job
from fungrasp.grasps import (
    builtin_grasps,
    load_objects,
    load_robot_grasps,
    save_human_grasps,
    save_robot_grasps,
)
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget

pytestmark = pytest.mark.timeout(600)

HERE = os.pathsep.join([str(Path(__file__).parent), *sys.path])
"""Where other processes find the class of this file."""


@dataclass(frozen=True, eq=False)
class Squares(Job[int]):
    """Squares of numbers below ``count``, up to three at once."""

    count: int
    fails_at: int = 1000
    ran: list[list[int]] = field(default_factory=list)

    @cached_property
    def made_once(self) -> object:
        return lambda: "what can't be sent"

    def parts(self) -> list[int]:
        return list(range(self.count))

    def key(self, part: int) -> str:
        return part_key("square", part)

    def size(self, part: int) -> float:
        return 2.0

    def together(self, missing: list[int]) -> list[list[int]]:
        return [missing[i : i + 3] for i in range(0, len(missing), 3)]

    def run(self, parts: Sequence[int], progress: Callable[[float], None]) -> list[Arrays]:
        assert self.made_once
        if self.fails_at in parts:
            raise FungraspError(f"{self.fails_at} can't be squared")
        self.ran.append(list(parts))
        progress(1.0)
        return [{"square": np.array(part**2)} for part in parts]


def squares(found: list[Arrays]) -> list[int]:
    return [int(arrays["square"]) for arrays in found]


def test_parts_are_run_together_and_results_are_in_order():
    job, seen = Squares(7), []
    assert squares(run_job(job, progress=seen.append)) == [0, 1, 4, 9, 16, 25, 36]
    assert job.ran == [[0, 1, 2], [3, 4, 5], [6]]
    assert [14 * share for share in seen] == pytest.approx([0, 1, 6, 7, 12, 13, 14])


def test_what_was_finished_is_not_done_again(tmp_path):
    store = PartStore(tmp_path / "parts")
    with pytest.raises(FungraspError, match="4 can't be squared"):
        run_job(Squares(7, fails_at=4), store)
    assert len(list((tmp_path / "parts").iterdir())) == 3
    job, seen = Squares(7), []
    assert squares(run_job(job, store, progress=seen.append)) == [0, 1, 4, 9, 16, 25, 36]
    assert job.ran == [[3, 4, 5], [6]] and seen[0] == 6 / 14
    store.remove()
    assert list(tmp_path.iterdir()) == []


def test_what_was_left_elsewhere_must_be_there(tmp_path):
    class Recorded(Squares):
        def is_whole(self, part: int) -> bool:
            return part != 1

    store, job = PartStore(tmp_path), Recorded(3)
    run_job(Squares(3), store)
    assert squares(run_job(job, store)) == [0, 1, 4] and job.ran == [[1]]


def test_a_store_stays_where_its_block_is_interrupted(tmp_path):
    with pytest.raises(KeyboardInterrupt), PartStore.beside(tmp_path / "r.json") as store:
        run_job(Squares(3), store)
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["r.json.partial"]
    with PartStore.beside(tmp_path / "r.json") as store:
        assert squares(run_job(Squares(3, fails_at=1), store)) == [0, 1, 4]
    assert list(tmp_path.iterdir()) == []


def test_a_part_is_made_once(tmp_path):
    made, store = [], PartStore(tmp_path)

    def make() -> Arrays:
        made.append(1)
        return {"x": np.arange(3)}

    assert [store.kept("a", make)["x"].tolist() for _ in range(2)] == [[0, 1, 2]] * 2 and made == [1]


def test_keys_tell_inputs_and_versions_apart(monkeypatch):
    class Thing:
        def __init__(self, digest: str):
            self.digest = digest

    one = part_key("a", [np.arange(3), Thing("x")])
    assert one == part_key("a", [np.arange(3), Thing("x")])
    others = [part_key("a", [np.arange(4), Thing("x")]), part_key("a", [np.arange(3), Thing("y")])]
    monkeypatch.setattr("fungrasp.core.jobs.VERSIONS", ("0.0.0", "3"))
    assert len({one, *others, part_key("a", [np.arange(3), Thing("x")])}) == 4


def test_a_killed_process_is_gone_on_with(tmp_path):
    script = (
        "import os, signal\n"
        "from test_jobs import Squares, run_job, PartStore\n"
        "done = lambda count: os.kill(os.getpid(), signal.SIGKILL) if count >= 0.3 else None\n"
        f"run_job(Squares(9), PartStore({str(tmp_path)!r}), progress=done)\n"
    )
    there = {**os.environ, "PYTHONPATH": HERE}
    ended = subprocess.run([sys.executable, "-c", script], env=there, check=False)
    assert ended.returncode == -signal.SIGKILL
    job = Squares(9)
    assert squares(run_job(job, PartStore(tmp_path))) == [n**2 for n in range(9)]
    assert job.ran[0] == [3, 4, 5]


def add(shared: int, a: int, b: int) -> int:
    if b < 0:
        raise FungraspError(f"{b} is negative")
    return shared + a + b


def slow(shared: None, number: int) -> int:
    time.sleep(0.5)
    return number


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The package; workers find the functions of this file."""
    monkeypatch.setenv("PYTHONPATH", HERE)
    return pytest.importorskip("ray", reason='needs Ray: pip install "fungrasp[ray]"')


@pytest.fixture
def cluster(ray: Any):
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


def test_this_machine_does_every_job_once_and_says_errors(ray: Any, tmp_path):
    ray.init("local", include_dashboard=False, log_to_driver=False, num_cpus=2)
    try:
        done = {}
        jobs = [(i, 2 * i) for i in range(20)]
        RayCluster().run(add, jobs, lambda job, result: done.update({job: result}), shared=5)
        assert done == {(i, 2 * i): 5 + 3 * i for i in range(20)}
        with pytest.raises(FungraspError, match="-1 is negative"):
            RayCluster().run(add, [(0, -1)], lambda job, result: None, shared=0)
        job, seen, store = Squares(5), [], PartStore(tmp_path)
        assert job.made_once
        run_job(Squares(2), store)
        cluster = RayCluster()
        assert squares(run_job(job, store, ray=cluster, progress=seen.append)) == [0, 1, 4, 9, 16]
        assert job.ran == [] and seen == [0.4, 0.6, 0.8, 1.0]
        assert cluster.use is not None and cluster.use.jobs == 3
    finally:
        ray.shutdown()


def test_no_cluster_at_an_address(ray: Any):
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
def test_retargeting_on_this_machine_equals_that_of_one_process(ray: Any, tmp_path):
    human = builtin_grasps()
    save_human_grasps(tmp_path / "g.npz", human.select(np.arange(260) % len(human)))
    command = ["retarget", "--grasps", str(tmp_path / "g.npz"), "--out"]
    assert fungrasp([*command, str(tmp_path / "one.npz")]) == 0
    assert fungrasp([*command, str(tmp_path / "many.npz"), "--ray"]) == 0
    one, many = (load_robot_grasps(tmp_path / name) for name in ("one.npz", "many.npz"))
    np.testing.assert_array_equal(one.joint_positions, many.joint_positions)
    np.testing.assert_array_equal(one.wrist_pose, many.wrist_pose)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["g.npz", "many.npz", "one.npz"]


def test_what_does_not_go_with_a_cluster(tmp_path, capsys):
    assert fungrasp(["evaluate", "--ray"]) == 2
    assert "give --json or --out too" in capsys.readouterr().err
    assert fungrasp(["retarget", "--out", str(tmp_path / "a.npz"), "--ray", "a", "b"]) == 2
    assert "takes one address" in capsys.readouterr().err


def test_partial_results_survive_a_file_that_cannot_be_read(tmp_path):
    path = tmp_path / "x.partial"
    path.mkdir()
    (path / "a.npz").write_bytes(b"PK\x03\x04 cut short")
    store = PartStore(path)
    assert store.load("a") is None
    store.save("a", {"x": np.arange(3), "reason": np.array(["", "lost"])})
    again = PartStore(path)
    kept = again.load("a")
    assert kept is not None and kept["x"].tolist() == [0, 1, 2] and kept["reason"].tolist() == ["", "lost"]
    assert again.load("b") is None
    again.remove()
    assert not path.exists()
    again.remove()
