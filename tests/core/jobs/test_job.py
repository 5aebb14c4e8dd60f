"""Long work in parts: gone on with where it was, grouped, and the same whatever is kept already."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job

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
    monkeypatch.setattr("fungrasp.core.jobs.job.VERSIONS", ("0.0.0", "3"))
    assert len({one, *others, part_key("a", [np.arange(3), Thing("x")])}) == 4


def test_a_cluster_gives_the_same(tmp_path, monkeypatch):
    pytest.importorskip("ray", reason='needs Ray: pip install "fungrasp[ray]"')
    monkeypatch.setenv("PYTHONPATH", HERE)
    job, seen, store = Squares(5), [], PartStore(tmp_path)
    assert job.made_once
    run_job(Squares(2), store)
    cluster = RayCluster()
    assert squares(run_job(job, store, ray=cluster, progress=seen.append)) == [0, 1, 4, 9, 16]
    assert (
        job.ran == [] and seen == [0.4, 0.6, 0.8, 1.0] and cluster.use is not None and cluster.use.jobs == 3
    )


def test_a_killed_process_is_gone_on_with(tmp_path):
    script = (
        "import os, signal\n"
        "from test_job import Squares, run_job, PartStore\n"
        "done = lambda count: os.kill(os.getpid(), signal.SIGKILL) if count >= 0.3 else None\n"
        f"run_job(Squares(9), PartStore({str(tmp_path)!r}), progress=done)\n"
    )
    there = {**os.environ, "PYTHONPATH": HERE}
    ended = subprocess.run([sys.executable, "-c", script], env=there, check=False)
    assert ended.returncode == -signal.SIGKILL
    job = Squares(9)
    assert squares(run_job(job, PartStore(tmp_path))) == [n**2 for n in range(9)]
    assert job.ran[0] == [3, 4, 5]


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
