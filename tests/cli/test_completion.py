"""Completion in a shell: what bash offers after a few letters."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from fungrasp.cli.main import main

ASK = """
source "$0"; shift 0
COMP_WORDS=(fungrasp "$@"); COMP_CWORD=$#
_tyro_fungrasp fungrasp "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
echo "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes_commands_and_options(tmp_path, capsys):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)

    def offered(*words: str) -> list[str]:
        asked = ["bash", "-c", ASK, str(script), *words]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()

    assert offered("hand") == ["hands"]
    assert offered("hands", "ex") == ["export"]
    assert offered("retarget", "--ha") == ["--hand"]
