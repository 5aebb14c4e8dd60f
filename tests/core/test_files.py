"""Files are written whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, cache_folder, cache_path, check_writable, remove_leftovers


def contents(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_new_file_appears_at_the_end(tmp_path: Path):
    target = tmp_path / "deep" / "er" / "grasps.npz"
    with atomic_path(target) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".npz"
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert contents(target.parent) == ["grasps.npz"]


@pytest.mark.parametrize("what", [RuntimeError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path, what: type[BaseException]):
    target = tmp_path / "grasps.npz"
    target.write_text("old")
    with pytest.raises(what), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise what
    assert target.read_text() == "old"
    assert contents(tmp_path) == ["grasps.npz"]


def test_full_disk_while_writing_is_one_line(tmp_path: Path):
    target = tmp_path / "grasps.npz"
    target.write_text("old")
    with pytest.raises(FungraspError) as caught, atomic_path(target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert str(caught.value) == f"cannot write {target}: No space left on device"
    assert target.read_text() == "old"
    assert contents(tmp_path) == ["grasps.npz"]


def test_full_disk_while_publishing_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", full)
    target = tmp_path / "grasps.npz"
    target.write_text("old")
    with pytest.raises(FungraspError, match="No space left"), atomic_path(target) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "old"
    assert contents(tmp_path) == ["grasps.npz"]


@pytest.mark.parametrize("place", ["file/grasps.npz", "folder"])
def test_where_nothing_can_be_written_nothing_is_left(tmp_path: Path, place: str):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with (
        pytest.raises(FungraspError, match=f"cannot write .*{place}: "),
        atomic_path(tmp_path / place) as new,
    ):
        new.write_text("new")
    assert contents(tmp_path) == ["file", "folder"]


def test_permissions_follow_the_umask(tmp_path: Path):
    before = os.umask(0o027)
    try:
        with atomic_path(tmp_path / "a.txt") as temporary:
            temporary.write_text("x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def test_writers_at_once_leave_one_whole_file(tmp_path: Path):
    target = tmp_path / "shared.txt"

    def write(text: str) -> None:
        with atomic_path(target) as temporary:
            temporary.write_text(text * 1000)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, "abcdefgh" * 5))
    assert len(set(target.read_text())) == 1
    assert len(target.read_text()) == 1000
    assert contents(tmp_path) == ["shared.txt"]


def test_cache_folder_obeys_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "ours"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "everybody"))
    assert cache_folder("pieces") == tmp_path / "ours" / "pieces"
    monkeypatch.delenv("FUNGRASP_CACHE")
    assert cache_folder("pieces") == tmp_path / "everybody" / "fungrasp" / "pieces"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder("pieces") == tmp_path / "home" / ".cache" / "fungrasp" / "pieces"
    assert cache_folder("pieces").is_dir()


def test_cache_folder_that_cannot_be_made_or_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "file"))
    assert cache_path("pieces") == tmp_path / "file" / "pieces"
    with pytest.raises(FungraspError, match=r"cannot make the cache folder .*; set FUNGRASP_CACHE to"):
        cache_folder("pieces")
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    # Permissions mean nothing to root.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(FungraspError, match=r"cannot write to the cache folder .*; set FUNGRASP_CACHE to"):
        cache_folder("pieces")


def test_no_home_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def no_home() -> Path:
        raise RuntimeError("could not determine home directory")

    for name in ("FUNGRASP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    with pytest.raises(FungraspError, match="FUNGRASP_CACHE"):
        cache_folder("pieces")


def test_what_killed_processes_left_is_removed_when_the_file_is_written_again(tmp_path: Path):
    target = tmp_path / "grasps.npz"
    code = (
        "import os, signal, sys; from fungrasp.core.files import atomic_path\n"
        "with atomic_path(sys.argv[1]) as path:\n"
        "    path.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    for _ in range(2):
        subprocess.run([sys.executable, "-c", code, str(target)], check=False)
        assert len(contents(tmp_path)) == 1 and not target.exists()
    with atomic_path(target) as mine:
        remove_leftovers(target)
        assert mine.exists(), "of a process that lives"
    assert contents(tmp_path) == ["grasps.npz"]


def test_paths_that_cannot_be_written_are_told_before(tmp_path: Path, monkeypatch):
    (tmp_path / "file").write_text("old")
    check_writable({"--out": tmp_path / "new" / "deep" / "a.npz", "--json": tmp_path / "file"})
    assert contents(tmp_path) == ["file"]
    for bad, words in (
        ({"--out": tmp_path}, "(--out): it is a folder"),
        ({"--out": tmp_path / "file" / "a.npz"}, "file is a file"),
        ({"--out": tmp_path / "a", "--report": tmp_path / "a"}, "--out and --report are the same file"),
    ):
        with pytest.raises(FungraspError, match=re.escape(words)):
            check_writable(bad)
    # Whoever runs this may write everywhere.
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(FungraspError, match="can't be written to"):
        check_writable({"--out": tmp_path / "a.npz"})
