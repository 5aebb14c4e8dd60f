"""What native libraries write to stderr."""

import os
import sys

import pytest

from fungrasp.perception.hand.mediapipe_models import filtered_native_output


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
