"""Readers of foreign files: what they take, and that they refuse the rest in words and within bounds."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import trimesh
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats import sandbox
from fungrasp.core.formats.checks import guarded, read_bytes
from fungrasp.core.formats.image_file import read_image
from fungrasp.core.formats.mesh_file import is_colorless, read_colored_mesh, read_mesh
from fungrasp.core.formats.mujoco_model import check_model_numbers, parse_model, read_model
from fungrasp.core.formats.numpy_files import read_npy, read_npz
from fungrasp.core.formats.onnx_file import check_operators, try_network
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.core.formats.text_files import (
    parse_json,
    parse_xml_text,
    read_json,
    read_toml,
    read_yaml,
    type_faults,
)

MANY = '<replicate count="9000000" offset="1 0 0"><geom size="1"/></replicate>'
SMALL = '<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>'


def refused(read: Callable[[Path], Any], path: Path, content: bytes | str, words: str = ".") -> None:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FungraspError, match=words) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def npy(header: str, body: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + body


def test_arrays_come_back_as_they_were(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["x", "yz"]), "c": np.array(True)}
    arrays["d"] = np.asfortranarray(np.arange(6, dtype=">i4").reshape(2, 3))
    np.savez_compressed(tmp_path / "x.npz", **arrays)
    found = read_npz(tmp_path / "x.npz", "file")
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
    assert list(read_npz(tmp_path / "x.npz", "file", "b".__eq__)) == ["b"]
    np.save(tmp_path / "x.npy", arrays["a"])
    found = read_npy(tmp_path / "x.npy", "file")
    found += 1  # It can be written to.
    np.testing.assert_array_equal(found, arrays["a"] + 1)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '<U1000000000', 'fortran_order': False, 'shape': (), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }",
        "[" * 5000,
        "{'descr",
    ],
)
def test_headers_that_lie(tmp_path, header):
    refused(lambda path: read_npy(path, "file"), tmp_path / "x.npy", npy(header, bytes(8)))


@pytest.mark.parametrize("point", [0x110000, 0xD800, 0xFFFFFFFF])
def test_text_of_what_is_no_character(tmp_path, point):
    for order in "<>":
        header = f"{{'descr': '{order}U2', 'fortran_order': False, 'shape': (), }}"
        body = struct.pack(f"{order}2I", ord("r"), point)
        refused(lambda path: read_npy(path, "file"), tmp_path / "x.npy", npy(header, body), "no characters")


def test_an_archive_that_unpacks_to_gigabytes_is_refused_at_once(tmp_path):
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("x.npy", "w", force_zip64=True) as stream,
    ):
        stream.write(npy("{'descr': '|b1', 'fortran_order': False, 'shape': (400000000,), }"))
        for _ in range(400):
            stream.write(bytes(1_000_000))
    start = time.monotonic()
    with pytest.raises(FungraspError, match="field 'x' takes more than 256 MB"):
        read_npz(tmp_path / "bomb.npz", "file")
    assert time.monotonic() - start < 2


def test_json(tmp_path):
    assert parse_json('{"a": [1, 2.5, null]}', "x") == {"a": [1, 2.5, None]}
    for text, words in (
        ("[" * 100_000, "nested too deeply"),
        ("[" * 40 + "]" * 40, "nested more than"),
        ("9" * 5000, "not valid JSON"),
        ("9" * 30, "more than 64 bits"),
        ('"\\ud800"', "half a character"),
        ("{", "not valid JSON"),
    ):
        refused(lambda path: read_json(path, "file"), tmp_path / "x.json", text, words)


def test_toml_and_types(tmp_path):
    for text, words in (
        ("x = " + "[" * 5000, "nested too deeply|not valid"),
        ("a." * 5000 + "b = 1", "more than 32 parts"),
        ('[x."a b" . c' + ".d" * 30 + "]", "more than 32 parts"),
        ("x = " + "9" * 5000, "not valid TOML"),
        ("x = 0x" + "f" * 5000, "more than 64 bits"),
        ("x = ", "not valid TOML"),
    ):
        refused(lambda path: read_toml(path, "file"), tmp_path / "x.toml", text, words)
    schema = {"name": str, "n": float, "list": [str], "of": {"*": {"tip": str}}}
    assert list(type_faults({"name": "x", "n": 1, "list": ["a"], "of": {"q": {"tip": "t"}}}, schema)) == []
    wrong = {"name": 1, "n": True, "list": ["a", 2], "of": {"q": {"tip": []}}, "other": 3}
    assert list(type_faults(wrong, schema)) == [
        "'name' must be a text, not 1",
        "'n' must be a number, not True",
        "'list[1]' must be a text, not 2",
        "'of.q.tip' must be a text, not []",
    ]


def test_yaml_takes_tuples_and_no_other_tag(tmp_path):
    pytest.importorskip("yaml")
    (tmp_path / "x.yml").write_text("a: !!python/tuple [1.0, 2.0]\n")
    assert read_yaml(tmp_path / "x.yml") == {"a": [1.0, 2.0]}
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
    for text in ("a: !!python/object/apply:os.system [ls]", bomb, "a: &a [*a]", "[" * 5000, "- 1"):
        refused(read_yaml, tmp_path / "x.yml", text)


def test_images(tmp_path):
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII5B", 13, b"IHDR", 1 << 20, 1 << 20, 8, 2, 0, 0, 0)
    for content in (b"", b"nonsense", header + bytes(100)):
        refused(lambda path: read_image(path, "mask"), tmp_path / "x.png", content)
    Image.new("L", (3, 2)).save(tmp_path / "x.png")
    assert read_image(tmp_path / "x.png", "mask").size == (3, 2)


def test_meshes(tmp_path):
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.obj")
    vertices, faces = read_mesh(tmp_path / "box.obj")
    assert vertices.shape == (8, 3) and faces.shape == (12, 3)
    refused(read_mesh, tmp_path / "x.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "cannot read|no faces")
    with pytest.raises(FungraspError, match="not a regular file"):
        read_mesh("/dev/zero")


@pytest.mark.parametrize(
    "text",
    [
        SMALL.replace("<worldbody>", '<size nuserdata="2000000000"/><worldbody>'),
        SMALL.replace('<geom size="1"/>', MANY),
        "<!DOCTYPE x [<!ENTITY a 'b'>]>" + SMALL,
        "<mujoco>" * 5000,
        "nonsense",
    ],
)  # fmt: skip
def test_models(tmp_path, text):
    (tmp_path / "good.xml").write_text(SMALL)
    assert read_model(tmp_path / "good.xml").compile().nbody == 2
    refused(read_model, tmp_path / "x.xml", text)


def network(*nodes: onnx.NodeProto, weights: int = 1) -> bytes:
    put = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", 1]) for name in "xy"]
    row = onnx.numpy_helper.from_array(np.ones((1, weights), np.float32), "row")
    column = onnx.numpy_helper.from_array(np.ones((weights, 1), np.float32), "column")
    graph = onnx.helper.make_graph(list(nodes), "g", put[:1], put[1:], [row, column])
    opset = onnx.helper.make_opsetid("", 17)
    return onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8).SerializeToString()


def test_networks_are_walked_and_tried():
    make = onnx.helper.make_node
    good = network(make("Relu", ["x"], ["y"]))
    check_operators(good)
    try_network(good)
    with pytest.raises(FungraspError, match="'RandomUniformLike' is none of"):
        check_operators(network(make("RandomUniformLike", ["x"], ["y"])))
    # A file of 1 MB that computes with a matrix of 60 GB.
    outer = make("Mul", ["row", "column"], ["outer"]), make("ReduceMean", ["outer"], ["mean"], keepdims=1)
    large = network(*outer, make("Add", ["x", "mean"], ["y"]), weights=120_000)
    check_operators(large)
    with pytest.raises(FungraspError, match=r"memory|cannot read|more than"):
        try_network(large)


def test_pickles_that_unfold_into_more_than_fits(tmp_path):
    # Lists of two names of the list before: 2^40 values.
    doubled = b"".join(b"](h%ch%ce\x94" % (n, n) for n in range(40))
    refused(load_arrays_pickle, tmp_path / "x.pkl", b"\x80\x04]\x94" + doubled + b".", "takes more than")


def test_the_child_process_ends_what_takes_too_long(tmp_path, monkeypatch):
    monkeypatch.setattr(sandbox, "SECONDS", 0.2)
    text = SMALL.replace('<geom size="1"/>', MANY)
    (tmp_path / "x.xml").write_text(text)
    with pytest.raises(FungraspError, match="was not read: it takes more than"):
        sandbox.run_limited("model", tmp_path / "x.xml", "model")
    monkeypatch.undo()
    (tmp_path / "x.xml").write_text(SMALL)
    assert sandbox.run_limited("model", tmp_path / "x.xml", "model") == b""


def test_models_with_numbers_that_make_no_sense(tmp_path):
    shifted = SMALL.replace("<body>", '<body name="b" pos="{} 0 0">')
    for value, words in (("nan", "not finite"), ("1e11", "is it in meters")):
        model = parse_model(shifted.format(value), "x").compile()
        with pytest.raises(FungraspError, match=f"x: the place of body 'b' is .*{words}"):
            check_model_numbers(model, "x")
    check_model_numbers(parse_model(shifted.format("1"), "x").compile(), "x")
    with pytest.raises(FungraspError, match=r"^x was not read|^x declares|^cannot read x"):
        parse_model(SMALL.replace('<geom size="1"/>', MANY), "x")


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_binary_ply_of_polygons_of_several_sizes(tmp_path: Path, order: str) -> None:
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4], [2, 4, 6]]
    name = {"<": "little", ">": "big"}[order]
    head = (
        f"ply\nformat binary_{name}_endian 1.0\ncomment a cube\nelement vertex 8\nproperty float x\n"
        f"property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(f"{order}3f3B", *p, 200, 100, 0) for p in corners)
    body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    (tmp_path / "cube.ply").write_bytes(head.encode() + body)
    vertices, triangles = read_mesh(tmp_path / "cube.ply")
    assert len(triangles) == 12
    assert trimesh.Trimesh(vertices, triangles).volume == pytest.approx(1.0)
    colored = read_colored_mesh(tmp_path / "cube.ply")
    assert colored is not None
    assert np.asarray(colored.visual.vertex_colors)[0].tolist() == [200, 100, 0, 255]

    (tmp_path / "short.ply").write_bytes(head.encode() + body[:-9])
    with pytest.raises(FungraspError, match="ends too early"):
        read_mesh(tmp_path / "short.ply")


def test_xml_that_is_nested_too_deeply():
    assert parse_xml_text("<a><b/></a>", "x").tag == "a"
    for text, words in (
        ("<a>" * 300 + "</a>" * 300, "nested more than"),
        ("<a>" * 100_000, "nested more than"),
        ("<a>", "not valid XML"),
        ("", "not valid XML"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><x>&a;</x>", "entities"),
    ):
        with pytest.raises(FungraspError, match=words):
            parse_xml_text(text, "x")


def test_colors_of_meshes(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.export(tmp_path / "plain.ply")
    assert read_colored_mesh(tmp_path / "plain.ply") is None
    colors = np.random.default_rng(0).integers(0, 255, (8, 4), dtype=np.uint8)
    box.visual.vertex_colors = colors
    box.export(tmp_path / "box.ply")
    found = read_colored_mesh(tmp_path / "box.ply")
    np.testing.assert_array_equal(found.visual.vertex_colors[:, :3], colors[:, :3])
    image = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    uv = np.random.default_rng(0).random((8, 2))
    box.visual = trimesh.visual.TextureVisuals(uv=uv, image=image)
    box.export(tmp_path / "box.glb")
    found = read_colored_mesh(tmp_path / "box.glb")
    assert found.visual.kind == "texture" and len(found.vertices) == len(found.visual.uv)
    refused(read_colored_mesh, tmp_path / "x.glb", (tmp_path / "box.glb").read_bytes()[:-200])


def test_files_that_say_at_once_that_they_have_no_colors(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    for suffix, plain in ((".ply", True), (".obj", True), (".stl", True), (".glb", False)):
        box.export(tmp_path / f"plain{suffix}")
        assert is_colorless(tmp_path / f"plain{suffix}") == plain, suffix
        assert read_colored_mesh(tmp_path / f"plain{suffix}") is None or not plain
    box.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (8, 4), dtype=np.uint8)
    for suffix in (".ply", ".obj"):
        box.export(tmp_path / f"painted{suffix}")
        assert not is_colorless(tmp_path / f"painted{suffix}")
    image = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    box.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)), image=image)
    for suffix in (".ply", ".obj"):
        box.export(tmp_path / f"textured{suffix}")
        assert not is_colorless(tmp_path / f"textured{suffix}")


def test_files_that_are_none(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "not a regular file"),
        (tmp_path / "no", "not exist"),
    ):
        with pytest.raises(FungraspError, match=words):
            read_bytes(path, "file", 10)
    (tmp_path / "large").write_bytes(bytes(20))
    with pytest.raises(FungraspError, match="at most 0 are read"):
        read_bytes(tmp_path / "large", "file", 10)


def test_what_readers_stumble_over_is_one_line():
    @guarded("thing")
    def read(path: str) -> None:
        raise TypeError("two\nlines")

    with pytest.raises(FungraspError, match=r"^the thing x makes no sense: two lines$"):
        read("x")


def test_meshes_are_read_without_what_is_slow_to_import(tmp_path: Path) -> None:
    """A child with a trimesh that found no SciPy reads the same, and asks the whole one before it refuses."""
    import trimesh

    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "right.ply")
    (tmp_path / "wrong.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 2\nend_header\n1\n")
    script = (
        "import io, sys, numpy as np\n"
        "from fungrasp.core.formats import sandbox_worker as worker\n"
        "worker.import_for('triangles')\n"
        "status, answer = worker.work('triangles', 'right.ply')\n"
        "assert status == worker.DONE and len(np.load(io.BytesIO(answer))['faces']) == 12\n"
        "assert not {'scipy', 'networkx'} & set(sys.modules)\n"
        "status, answer = worker.work('triangles', 'wrong.ply')\n"
        "assert status == worker.REFUSED and 'scipy' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path)
