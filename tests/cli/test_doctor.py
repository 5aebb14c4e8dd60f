"""``fungrasp doctor``: extras that are whole and that are not, devices, caches."""

from __future__ import annotations

import importlib.metadata
import json

from fungrasp.cli.main import main
from fungrasp.core.provenance import diagnose


def test_it_says_what_is_there(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "a").write_bytes(bytes(2_500_000))
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "mujoco-core" in text and "serial ports" in text and "2.5 MB" in text
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"programs", "extras", "devices", "caches"} == set(found)


def test_extras_that_lack_something_say_what(monkeypatch):
    needs = ["numpy>=2", 'viser>=999 ; extra == "viewer"', 'no-such-package ; extra == "all"']
    needs += ['fungrasp[viewer] ; extra == "all"', 'numpy>=1 ; extra == "whole"']
    needs += ['no-such-package ; python_version < "3" and extra == "whole"']
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: needs)

    class Metadata:
        def get_all(self, name):
            return ["viewer", "all", "whole"]

    monkeypatch.setattr(importlib.metadata, "metadata", lambda name: Metadata())
    monkeypatch.setattr(importlib.metadata, "version", lambda name: _version(name))
    extras = {extra.name: extra.missing for extra in diagnose().extras}
    old = "viser>=999 (is 1.0)"
    assert extras == {"viewer": (old,), "all": ("no-such-package", old), "whole": ()}


def _version(name: str) -> str:
    if name == "no-such-package":
        raise importlib.metadata.PackageNotFoundError(name)
    return "1.0"
