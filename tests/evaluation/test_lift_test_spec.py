"""What is asked of a lift test travels, and stands in its result."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_from_json
from fungrasp.evaluation import LiftTestSpec, evaluate, read_result
from fungrasp.sim2real import REALITY, Randomization
from fungrasp.task import LiftProtocol

SHORT = LiftProtocol(hold_time=0.3)


def test_a_result_says_what_was_asked_and_can_be_asked_again(good, things, tmp_path):
    spec = LiftTestSpec(randomization=Randomization(mass=(1.5, 2.0)), lift=SHORT, seeds=(3,))
    result = evaluate(good.select([0, 2]), things, spec=spec, threads=1)
    result.save(tmp_path / "r.json")
    found = json.loads((tmp_path / "r.json").read_text())
    assert record_from_json(LiftTestSpec, found["spec"], "r.json") == spec == result.spec
    assert [trial["success"] for trial in found["trials"]] == result.success.tolist()
    assert {"command", "version", "machine", "seconds"} <= set(found)
    result.save(tmp_path / "c.json", compact=True)
    one, compact = (read_result(tmp_path / name) for name in ("r.json", "c.json"))
    assert one.rows == compact.rows and len(compact.rows) == 2
    lines = result.table().splitlines()
    assert lines[0].split()[:2] == ["object", "episodes"]


def test_policy_and_protocol_take_the_place_of_those_asked(good, things):
    result = evaluate(
        good.select([0]), things, "reference", "reality", spec=LiftTestSpec(policy="student", lift=SHORT)
    )
    assert (result.policy, result.spec.protocol, result.randomization) == ("reference", "reality", REALITY)
    assert result.episodes == 1 and result.conditions == {}


def test_conditions_are_results_of_their_own(good, things, monkeypatch):
    some = {"nominal": Randomization(), "heavy": Randomization(mass=(2.0, 2.0))}
    monkeypatch.setattr("fungrasp.sim2real.randomization.ROBUSTNESS", some)
    result = evaluate(good.select([0]), things, spec=LiftTestSpec(protocol="robustness", lift=SHORT))
    assert list(result.conditions) == ["nominal", "heavy"] and result.episodes == 2
    np.testing.assert_array_equal(result.success, result.conditions["nominal"].success)
    assert result.json()["robustness"]["heavy"]["randomization"]["mass"] == [2.0, 2.0]
    assert result.table().splitlines()[0].split()[0] == "condition"


def test_what_earlier_versions_asked_is_read():
    asked = {"policy": "reference", "seeds": [3], "static": True}
    assert LiftTestSpec.read({**asked, "refine": 0}, "r.json") == LiftTestSpec(seeds=(3,), static=True)
    assert LiftTestSpec.read({**asked, "refine": 8}, "r.json") is None
    with pytest.raises(FungraspError, match="no field 'refines'"):
        LiftTestSpec.read({"refines": 8}, "r.json")


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"protocol": "realty"}, "protocol: expected 'nominal' or 'reality' or 'robustness', not 'realty'"),
        ({"protocol": Randomization()}, "protocol: expected 'nominal' or"),
        ({"seeds": 3}, "seeds: expected a list, not 3"),
        ({"seeds": ()}, "at least one value"),
        ({"seeds": (-1,)}, "must not be negative"),
        ({"attempts": 0}, "1 attempt or more"),
        ({"protocol": "reality", "randomization": Randomization(mass=(2.0, 2.0))}, "already defines"),
    ],
)
def test_what_can_not_be_asked(asked, words):
    with pytest.raises(FungraspError, match=words):
        LiftTestSpec(**asked)
