"""Two variants on the same grasps: what a variant may be, the statistics, and the command."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from benchmarks.choose.__main__ import record_use
from benchmarks.choose.measurement import MeasurementRequest
from benchmarks.choose.pairing import paired_interval, paired_means, paired_rates
from benchmarks.choose.variant import Variant
from benchmarks.grasp_set.parts import OBJECTS, save_set
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.statistics import wilson_interval


def test_a_variant_sets_fields_of_retargeting_motion_and_test():
    variant = Variant.parse(
        "contact,retarget.gap_unit=0.002,motion.approach.object_margin=0.004,lift.adapt=false"
    )
    assert variant.method == "contact" and variant.retarget.gap_unit == 0.002
    assert variant.motion.approach.object_margin == 0.004 and variant.lift.adapt is False
    assert Variant.parse("contact,lift.policy=plan").lift.policy == "plan"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("contcat", "Did you mean 'contact'"),
        ("contact,firm=1", "'firm=1' is no option"),
        ("contact,retarget.gap_unti=0", "did you mean 'gap_unit'"),
        ("contact,lift.protocol=robustness", "under one condition"),
        ("/nowhere::contact", "/nowhere is no checkout"),
    ],
)
def test_a_variant_that_cannot_be_is_told(text, words):
    with pytest.raises(FungraspError, match=words):
        Variant.parse(text)


def test_the_interval_counts_objects_not_grasps():
    rng = np.random.default_rng(0)
    objects = np.repeat(np.arange(40), 10)
    # All grasps of an object gain or lose together.
    gain = np.repeat(rng.choice([-1.0, 0.0, 1.0], 40), 10)
    low, high = paired_interval(np.zeros(400), gain, objects.astype(str))
    alone = paired_interval(np.zeros(400), gain, np.arange(400).astype(str))
    assert low < gain.mean() < high
    assert high - low == pytest.approx(np.sqrt(10) * (alone[1] - alone[0]), rel=0.15)
    # Of independent pairs, as wide as theory says.
    single = (np.arange(400) < 100).astype(float)
    low, high = paired_interval(np.zeros(400), single, np.arange(400).astype(str))
    assert (low, high) == pytest.approx(wilson_interval(100, 400), abs=0.01)
    assert paired_interval(single, single, objects.astype(str)) == (0.0, 0.0)


def test_rates_and_means_by_stratum():
    a = {"success": np.array([True, False, True, False]), "gap_mm": np.array([1.0, np.nan, 1.0, 2.0])}
    b = {"success": np.array([True, True, False, True]), "gap_mm": np.array([2.0, 1.0, 3.0, 2.0])}
    names, stratum = np.array(list("xxyz")), np.array(["flat", "flat", "thin", "thin"])
    flat, thin, everything = paired_rates(a, b, names, stratum)
    assert (flat.stratum, flat.grasps, flat.objects, flat.only_first, flat.only_second) == (
        "flat",
        2,
        1,
        0,
        1,
    )
    assert (thin.only_first, thin.only_second) == (1, 1)
    assert (everything.stratum, everything.first, everything.second) == ("all", 0.5, 0.75)
    (gap,) = paired_means(a, b, names)
    assert (gap.first, gap.second) == pytest.approx((4 / 3, 7 / 3))


def test_uses_of_the_test_part_are_counted(tmp_path):
    rate = paired_rates(
        {"success": np.array([True])}, {"success": np.array([True])}, np.array(["x"]), np.array(["flat"])
    )[-1]
    path = tmp_path / "uses.csv"
    assert record_use(path, "first, of two", "contact", "mink", rate) == 1
    assert record_use(path, "second", "contact", "contact,lift.adapt=false", rate) == 2
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["decision"] for row in rows] == ["first, of two", "second"] and rows[0][
        "a_percent"
    ] == "100.0"


@pytest.fixture(scope="module")
def small_set(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    grasps = some_grasps(("can", "tennis_ball", "box", "marker"))
    names = sorted(set(grasps.object_name.tolist()))
    parts = dict.fromkeys(names, "validation") | {names[0]: "train", names[1]: "test"}
    (folder / OBJECTS).mkdir()
    save_set(folder, grasps, np.array(["builtin"] * len(grasps)), parts, {})
    return folder


def test_what_was_measured_is_not_measured_again(small_set, tmp_path, capsys, monkeypatch):
    arguments = ("angle-copy,lift.adapt=false", "contact,lift.adapt=false", "--set", small_set)
    path = tmp_path / "c.json"
    status, out, _ = run_benchmark(capsys, "choose", *arguments, "--json", path)
    assert status == 0 and "builtin" in out and "contact_error_mm" in out
    header = json.loads(path.read_text())
    with path.with_suffix(".csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == header["rates"][-1]["grasps"] > 0
    assert header["rates"][-1]["second"] == np.mean([row["b_success"] == "True" for row in rows])

    def stop(*_: object, **__: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr("benchmarks.choose.measurement.evaluate", stop)
    assert run_benchmark(capsys, "choose", *arguments)[1] == out
    uses = tmp_path / "uses.csv"
    status, _, error = run_benchmark(capsys, "choose", *arguments, "--part", "test", "--uses", uses)
    assert status == 2 and "--decision" in error and not uses.exists()


def test_another_checkout_is_measured_by_its_own_package(small_set, tmp_path):
    package = tmp_path / "other" / "src" / "fungrasp"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(
        "import pathlib\npathlib.Path(__file__).with_name('imported').touch()\nraise SystemExit(3)\n"
    )
    here = ("validation", 1, "allegro", 0, str(tmp_path / "kept"))
    request = MeasurementRequest(f"{tmp_path / 'other'}::contact,any.thing=1", str(small_set), *here)
    with pytest.raises(FungraspError, match=r"measuring 'contact,any\.thing=1' failed"):
        request.measure()
    assert (package / "imported").exists()
