"""Short series of ``kill_series``: long work that is killed ends as if it had not been."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")


@pytest.mark.slow
@pytest.mark.parametrize("what", ["evaluate", "plan", "train", "distill"])
def test_killed_work_goes_on_to_the_same_result(what: str):
    script = Path(__file__).with_name("kill_series.py")
    done = subprocess.run(
        [sys.executable, str(script), what, "2"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["kills"] >= 2
