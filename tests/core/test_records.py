"""Records of arrays and their files; records of settings as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import BatchRecord, record_from_json, record_to_json
from fungrasp.deployment.spec import DeploymentSpec
from fungrasp.evaluation import LiftTestSpec
from fungrasp.evaluation.contact_estimate import ContactEstimates
from fungrasp.grasps.as_shown import AsShown, ShownContacts
from fungrasp.grasps.conversion import Convention
from fungrasp.planning.attempts import AttemptRecord
from fungrasp.planning.selection.rollouts import RolloutResults
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.planning.withdrawal import Waypoints
from fungrasp.sim2real import PRESETS, EpisodeSample, Randomization
from fungrasp.task import Action, Belief, GraspPlan, Observation, Outcomes, Privileged
from fungrasp.task.attempt_judge import AttemptVerdict
from fungrasp.task.outcome import HoldMiddle
from fungrasp.task.use import UseOutcomes
from fungrasp.training.settings import TrainSpec

KINDS = (
    Action,
    AsShown,
    AttemptRecord,
    AttemptVerdict,
    Belief,
    ContactEstimates,
    EpisodeSample,
    GraspPlan,
    HoldMiddle,
    Observation,
    Outcomes,
    Privileged,
    RolloutResults,
    ShownContacts,
    UseOutcomes,
    Waypoints,
)
"""Every kind of record."""
STEPPED = ("palm_goal_object", "finger_targets", "palm_setpoint_object", "palm_velocity")
"""Fields of a plan with an axis of steps."""


def optional(kind: type[BatchRecord]) -> list[str]:
    """Fields that may be None."""
    return [f.name for f in fields(kind) if "None" in str(f.type)]  # pyright: ignore[reportArgumentType]


def made_up(
    kind: type[BatchRecord], seed: int, count: int, known: tuple[str, ...] = (), steps: int = 3
) -> BatchRecord:
    """A record of random arrays of all types. known: what is given of what may be None."""
    rng = np.random.default_rng(seed)
    values = {}
    for f in fields(kind):  # pyright: ignore[reportArgumentType]
        if f.name in kind.SCALARS:
            values[f.name] = "allegro" if "str" in str(f.type) else 0.1
        elif f.name in optional(kind) and f.name not in known:
            values[f.name] = None
        elif f.name in ("object_name", "reason", "motion"):
            values[f.name] = np.array([f"it {seed} {i}" for i in range(count)])
        elif f.name in STEPPED:
            values[f.name] = rng.normal(size=(count, steps, 7))
        else:
            values[f.name] = rng.normal(size=(count, 3)).astype(
                [np.float64, np.float32, bool, int][int(rng.integers(4))]
            )
    return kind(**values)


def assert_same(a: BatchRecord, b: BatchRecord) -> None:
    assert type(a) is type(b)
    for f in fields(a):  # pyright: ignore[reportArgumentType]
        one, other = getattr(a, f.name), getattr(b, f.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype or one.dtype.kind == "U", f.name
        assert type(one) is type(other), f.name
        np.testing.assert_array_equal(one, other, err_msg=f.name)


@st.composite
def records(draw, count: int | None = None):
    kind = draw(st.sampled_from(KINDS))
    known = tuple(name for name in optional(kind) if draw(st.booleans()))
    return made_up(kind, draw(st.integers(0, 999)), count or draw(st.integers(1, 5)), known)


def test_every_kind_of_record_is_tried():
    found, left = set(), list(BatchRecord.__subclasses__())
    while left:
        kind = left.pop()
        left += kind.__subclasses__()
        if kind.__module__.startswith("fungrasp"):
            found.add(kind)
    assert found == set(KINDS)


@settings(max_examples=40, deadline=None)
@given(record=records())
def test_a_file_brings_everything_back(record, tmp_path_factory):
    path = tmp_path_factory.mktemp("records") / "r.npz"
    record.save(path)
    assert_same(type(record).load(path), record)


@settings(max_examples=40, deadline=None)
@given(record=records(count=5), rows=st.lists(st.integers(0, 4), min_size=1, max_size=6))
def test_rows_are_the_same_of_everything(record, rows):
    some = record.select(np.array(rows))
    assert len(some) == len(rows)
    for name, value in record._rows().items():
        np.testing.assert_array_equal(getattr(some, name), value[rows], err_msg=name)
    flags = np.isin(np.arange(5), rows)
    assert_same(record.select(flags), record.select(np.flatnonzero(flags)))
    assert_same(record.select(slice(1, 3)), record.select(np.array([1, 2])))


@settings(max_examples=40, deadline=None)
@given(record=records(count=5), cut=st.integers(1, 4))
def test_parts_that_are_joined_are_the_whole(record, cut):
    parts = [record.select(slice(0, cut)), record.select(slice(cut, None))]
    assert_same(type(record).join(parts), record)


@settings(max_examples=40, deadline=None)
@given(record=records(count=5), rows=st.permutations(range(5)))
def test_rows_that_are_replaced_are_the_others_and_the_first_stays_as_it_was(record, rows):
    rows = np.array(rows[:2])
    before = record.select(slice(None))
    before = type(record).join([before.select(slice(0, 2)), before.select(slice(2, None))])
    other = record.select(np.array([4, 0]))
    mixed = record.replaced(rows, other)
    assert_same(mixed.select(rows), other)
    kept = np.setdiff1d(np.arange(5), rows)
    assert_same(mixed.select(kept), record.select(kept))
    assert_same(record, before)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if optional(kind)])
def test_records_that_know_different_things_do_not_mix(kind):
    name = optional(kind)[0]
    knows, does_not = made_up(kind, 0, 2, (name,)), made_up(kind, 0, 2)
    for call in (
        lambda: does_not.replaced(np.arange(2), knows),
        lambda: kind.join([does_not, knows]),
        lambda: kind.join([knows, does_not]),
    ):
        with pytest.raises(FungraspError, match=f"{name} is given in one of the two"):
            call()


def test_a_file_of_something_else_is_named(tmp_path):
    path = tmp_path / "r.npz"
    with pytest.raises(FungraspError, match="does not exist"):
        Action.load(path)
    made_up(Observation, 0, 2).save(path)
    with pytest.raises(FungraspError, match=r"r\.npz holds no Action: .*palm_goal_world"):
        Action.load(path)
    whole = path.read_bytes()
    for damaged in (b"", b"text", whole[: len(whole) // 2], whole[:-30]):
        path.write_bytes(damaged)
        with pytest.raises(FungraspError, match=r"r\.npz"):
            Observation.load(path)
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(FungraspError, match=r"one\.npy can't be read"):
        Action.load(tmp_path / "one.npy")
    with pytest.raises(KeyError, match="finger_targets"):
        Action.from_arrays({"palm_goal_world": np.zeros((1, 7)), "lift": np.zeros(1)})


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.FORMER_NAMES])
def test_files_with_former_names_are_read(kind, tmp_path):
    record, now = made_up(kind, 0, 2), {new: old for old, new in kind.FORMER_NAMES.items()}
    np.savez(tmp_path / "old.npz", **{now.get(name, name): v for name, v in record.arrays().items()})
    assert_same(kind.load(tmp_path / "old.npz"), record)


def test_what_is_written_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path, record = tmp_path / "r.npz", made_up(Action, 0, 2)
    record.save(path)
    before = path.read_bytes()
    monkeypatch.setattr(np, "savez_compressed", lambda stream, **arrays: stream.write(b"half") and 1 / 0)
    with pytest.raises(ZeroDivisionError):
        made_up(Action, 1, 2).save(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_python_is_not_run_by_reading(tmp_path):
    path = tmp_path / "r.npz"
    arrays = made_up(Action, 0, 1).arrays() | {"lift": np.array([Path("x")], dtype=object)}
    np.savez(path, allow_pickle=True, **arrays)  # pyright: ignore[reportArgumentType]
    with pytest.raises(FungraspError, match="only numbers, flags and text are read"):
        Action.load(path)


def test_a_field_that_is_only_shared_is_not_a_row():
    @dataclass(frozen=True, eq=False)
    class Pair(BatchRecord):
        SCALARS = ("unit",)
        unit: float
        values: np.ndarray

    pair = Pair(0.5, np.arange(3))
    assert len(pair) == 3 and pair.select(np.array([2])).unit == 0.5
    assert replace(pair, unit=0.1).arrays().keys() == {"unit", "values"}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_record_is_shown_in_a_line(kind: type[BatchRecord]):
    shown = repr(made_up(kind, 0, 3))
    assert shown.startswith(f"<{kind.__name__}: 3 rows of ") and len(shown) < 600


@dataclass(frozen=True)
class Inner:
    pair: tuple[float, int] = (1.0, 2)


@dataclass(frozen=True)
class Outer:
    name: str
    kind: Literal["a", "b"] = "a"
    rows: tuple[int, ...] = ()
    inner: Inner = field(default_factory=Inner)
    maybe: Inner | None = None
    file: Path | None = None
    factor: float = 1.0
    by_name: Mapping[str, float] = field(default_factory=dict)
    flag: bool = False


def back(record):
    return record_from_json(type(record), json.loads(json.dumps(record_to_json(record))), "record")


def test_there_and_back():
    one = Outer("x", "b", (1, 2), Inner((0.5, 3)), Inner(), Path("a/b"), 3, {"k": 2.5}, True)
    assert back(one) == one
    assert back(Outer("x")) == Outer("x")
    assert record_from_json(Outer, {"name": "y"}, "record") == Outer("y")


@pytest.mark.parametrize("name", PRESETS)
def test_settings_there_and_back(name):
    assert back(PRESETS[name]) == PRESETS[name]
    assert back(SelectionSettings.for_protocol("reality")) == SelectionSettings.for_protocol("reality")
    assert back(Randomization()) == Randomization()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([], "r: expected the fields of Outer, not []"),
        ({}, "r: the field 'name' is missing"),
        ({"name": "x", "knd": "a"}, "r: there is no field 'knd'; did you mean 'kind'?"),
        ({"name": 3}, "r: name: expected text, not 3"),
        ({"name": "x", "kind": "c"}, "r: kind: expected 'a' or 'b', not 'c'"),
        ({"name": "x", "rows": [1, 2.5]}, "r: rows[1]: expected a whole number, not 2.5"),
        ({"name": "x", "rows": 1}, "r: rows: expected a list, not 1"),
        ({"name": "x", "rows": [True]}, "r: rows[0]: expected a whole number, not True"),
        ({"name": "x", "inner": {"pair": [1]}}, "r: inner: pair: expected a list of 2, not [1]"),
        ({"name": "x", "maybe": 1}, "r: maybe: expected the fields of Inner, not 1"),
        ({"name": "x", "factor": "2"}, "r: factor: expected a number, not '2'"),
        ({"name": "x", "by_name": {"k": None}}, "r: by_name.k: expected a number, not None"),
        ({"name": "x", "flag": 1}, "r: flag: expected true or false, not 1"),
    ],
)
def test_what_is_wrong_is_named(data, words):
    with pytest.raises(FungraspError) as error:
        record_from_json(Outer, data, "r")
    assert str(error.value) == words


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Convention(quaternion="XYZW"), "quaternion: expected 'wxyz' or 'xyzw', not 'XYZW'"),
        (lambda: Convention(up="Z"), "up: expected 'z' or"),
        (lambda: LiftTestSpec(protocol="real"), "protocol: expected 'nominal' or"),
        (lambda: LiftTestSpec(randomization=Randomization(push_phase="end")), "push_phase: expected 'lift'"),
        (lambda: DeploymentSpec(until="lfit"), "until: expected 'plan' or"),
        (lambda: TrainSpec(device="gpu"), "device: expected 'cuda' or 'cpu-warp' or 'cpu', not 'gpu'"),
    ],
)
def test_fields_with_fixed_values_are_checked(make, words):
    with pytest.raises(FungraspError, match=words):
        make()


def test_what_json_can_not_hold():
    with pytest.raises(FungraspError, match="nan"):
        record_to_json(Outer("x", factor=float("nan")))
    with pytest.raises(FungraspError, match="a set can't be written"):
        record_to_json({"a": {1}})
