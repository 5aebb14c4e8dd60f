"""Checkpoints: whole, checked, never lost."""

from __future__ import annotations

import re

import pytest
import torch

from fungrasp.core.errors import FungraspError
from fungrasp.training.folder import read_checkpoint, write_checkpoint


@pytest.fixture
def kept(tmp_path):
    path = tmp_path / "checkpoint.pt"
    write_checkpoint(path, {"steps": 7, "weights": torch.arange(5000.0)})
    return path


def test_what_is_written_is_read(kept):
    state = read_checkpoint(kept)
    assert state["steps"] == 7 and torch.equal(state["weights"], torch.arange(5000.0))


@pytest.mark.parametrize("at", [30, 90, 500, -1])
def test_a_changed_byte_is_found(kept, at):
    data = bytearray(kept.read_bytes())
    data[at] ^= 1
    kept.write_bytes(data)
    with pytest.raises(FungraspError, match=rf"{re.escape(str(kept))} is damaged or was changed"):
        read_checkpoint(kept)


@pytest.mark.parametrize("length", [0, 10, 60, 3000])
def test_a_file_cut_short_is_found(kept, length):
    kept.write_bytes(kept.read_bytes()[:length])
    with pytest.raises(FungraspError, match="checkpoint"):
        read_checkpoint(kept)


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "other.pt"
    torch.save({"steps": 1}, path)
    with pytest.raises(FungraspError, match="is not a checkpoint of this version"):
        read_checkpoint(path)
    with pytest.raises(FungraspError, match=r"the checkpoint .* does not exist|cannot read the checkpoint"):
        read_checkpoint(tmp_path / "none.pt")


class Evil:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_reading_runs_no_code(tmp_path):
    path, trace = tmp_path / "evil.pt", tmp_path / "trace"
    write_checkpoint(path, {"evil": Evil(trace)})
    with pytest.raises(FungraspError, match=r"the checkpoint .* does not exist|cannot read the checkpoint"):
        read_checkpoint(path)
    assert not trace.exists()
