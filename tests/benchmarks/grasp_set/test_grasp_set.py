"""The set of human grasps on which variants are compared: objects, parts, and the command that makes it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmark_runs import run_benchmark
from grasp_files import some_grasps

from benchmarks.grasp_set import objects
from benchmarks.grasp_set.generation import balance_residuals, made_grasps
from benchmarks.grasp_set.objects import SetObject, builtin_objects, drawn_objects, written_meshes
from benchmarks.grasp_set.parts import PARTS, load_part, split_objects
from benchmarks.grasp_set.shapes import DRAWN_KINDS
from benchmarks.grasp_set.specifications import STRENGTH, set_specifications
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import save_human_grasps
from fungrasp.objects import load_object
from fungrasp.objects.mesh_repair import vertex_components


def _object(name: str, number: int = 0) -> SetObject:
    return next(t for t in drawn_objects(number + 1, 0) if t.model.name == f"{name}-{number}")


def test_every_family_of_shapes_is_one_closed_body_of_a_mass_that_a_hand_lifts():
    drawn = drawn_objects(1, 7)
    assert {obj.stratum for obj in drawn} == set(DRAWN_KINDS)
    for obj in drawn:
        model = obj.model
        assert vertex_components(model.faces, len(model.vertices))[0] == 1, model.name
        assert model.mesh.is_watertight and 0.005 < model.mass < 1.6, model.name
        assert set(obj.tasks) <= set(model.parts), model.name
    again = {obj.model.name: obj.model.digest for obj in drawn_objects(1, 7)}
    other = {obj.model.name: obj.model.digest for obj in drawn_objects(1, 8)}
    assert all(again[obj.model.name] == obj.model.digest for obj in drawn)
    assert all(other[obj.model.name] != obj.model.digest for obj in drawn)


def test_written_meshes_are_read_closed_with_their_parts(tmp_path):
    # Scissors and a glass touch themselves along edges.
    glass = next(obj for obj in builtin_objects(1, 0) if obj.family == "wine_glass")
    for obj, read in zip(pair := [_object("scissors"), glass], written_meshes(pair, tmp_path), strict=True):
        assert not read.model.repairs and read.model.mesh.is_watertight
        assert read.model.mesh.volume == pytest.approx(obj.model.mesh.volume, rel=1e-3)
        for name, mask in obj.model.parts.items():
            area = obj.model.mesh.area_faces[mask].sum()
            same = read.model.mesh.area_faces[read.model.parts[name]].sum()
            assert same == pytest.approx(area, abs=0.02 * obj.model.mesh.area)


def test_parts_share_no_object_and_each_family_is_in_all():
    names = [f"{family}-{number}" for family in ("mug", "pen") for number in range(6)]
    families = [("handled" if name.startswith("mug") else "thin", name[:3]) for name in names]
    parts = split_objects(families, names, 0)
    for family in ("mug", "pen"):
        counts = [sum(parts[n] == part for n in names if n.startswith(family)) for part in PARTS]
        assert counts == [2, 2, 2]
    assert parts == split_objects(families, names, 0) != split_objects(families, names, 1)


def test_heavy_things_are_not_held_by_fingertips():
    block = _object("block")
    kinds = {spec.kind for spec in set_specifications(block, 0)}
    assert kinds & set(STRENGTH)
    heavy = replace(block, model=replace(block.model, mass=3.0))
    assert not {spec.kind for spec in set_specifications(heavy, 0)} & set(STRENGTH)


def test_grasps_oppose_each_other_and_one_sided_ones_are_told(tmp_path):
    obj = _object("ball")
    grasps = made_grasps([obj], 2, 0)
    assert len(grasps) == 2 and (balance_residuals(grasps, obj.model) < 0.05).all()
    only_index = np.zeros_like(grasps.link_contacts)
    only_index[:, 3] = True
    one_sided = replace(grasps, link_contacts=only_index)
    assert (balance_residuals(one_sided, obj.model) > 0.5).all()


def test_the_command_goes_on_and_gives_the_same(tmp_path, capsys, monkeypatch):
    balls = [_object("ball", number) for number in range(3)]
    monkeypatch.setattr(objects, "drawn_objects", lambda count, seed: balls)
    monkeypatch.setattr(objects, "builtin_objects", lambda count, seed: [])
    arguments = ("grasp_set", "--count", 1, "--out")

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as interrupted:
        interrupted.setattr("benchmarks.grasp_set.parts.save_set", stop)
        run_benchmark(capsys, *arguments, tmp_path / "a")
    kept = list((tmp_path / "a" / "grasps.partial").glob("*.npz"))
    assert len(kept) == 3
    with monkeypatch.context() as again:
        again.setattr("benchmarks.grasp_set.generation.synthesize_grasps", stop)
        status, out, _ = run_benchmark(capsys, *arguments, tmp_path / "a")
    assert status == 0 and "round" in out and not (tmp_path / "a" / "grasps.partial").exists()
    index = json.loads((tmp_path / "a" / "set.json").read_text())
    held = set()
    for name in PARTS:
        part = load_part(tmp_path / "a", name)
        assert part.stratum.tolist() == ["round"] and index["parts"][name]["grasps"] == 1
        assert part.objects[str(part.grasps.object_name[0])].mass == part.grasps.object_mass[0]
        held |= set(part.grasps.object_name.tolist())
    assert len(held) == 3
    (tmp_path / "a" / "test.npz").rename(tmp_path / "a" / "confirm.npz")
    index["parts"]["confirm"] = index["parts"].pop("test")
    (tmp_path / "a" / "set.json").write_text(json.dumps(index))
    assert len(load_part(tmp_path / "a", "test").grasps) == 1, "a set that was made with earlier names"
    save_human_grasps(tmp_path / "a" / "validation.npz", some_grasps())
    with pytest.raises(FungraspError, match=r"not the index of validation\.npz"):
        load_part(tmp_path / "a", "validation")
    with pytest.raises(FungraspError, match="part"):
        load_part(tmp_path / "a", "tested")


def test_what_is_missing_is_said(tmp_path, capsys):
    status, _, error = run_benchmark(capsys, "grasp_set", "--out", tmp_path, "--dexycb", tmp_path / "d.npz")
    assert status == 2 and "--objects" in error
    (tmp_path / "meshes").mkdir()
    status, _, error = run_benchmark(capsys, "grasp_set", "--out", tmp_path, "--objects", tmp_path / "meshes")
    assert status == 2 and "002_master_chef_can" in error


def test_a_can_may_be_held_as_it_lies():
    from fungrasp.synthesis.automatic_specifications import automatic_specifications

    can = load_object("can")
    ups = {spec.up for spec in automatic_specifications(can, (1.0, 0.0, 0.0))}
    assert all(abs(up[2]) < 0.1 for up in ups) and ups
