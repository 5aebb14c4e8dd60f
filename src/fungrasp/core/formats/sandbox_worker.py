"""Server process of ``sandbox``: it reads requests from stdin and forks a child for each."""

from __future__ import annotations

import importlib.util
import io
import json
import math
import os
import re
import signal
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

HEAD = struct.Struct("<BQ")
"""Header of an answer: status and number of following bytes."""

DONE, REFUSED, SLOW, LARGE, CRASHED = range(5)
"""Status of an answer."""

LONGEST_REASON = 300

PICKLES = "fungrasp.core.formats.pickle_file"
"""Module name, because that module imports ``sandbox``."""

SPARED = ("networkx", "scipy")
"""Optional dependencies of trimesh, whose import takes longer than reading a mesh."""


def read_triangles(path: str) -> bytes:
    """Return vertices [V, 3] and faces [F, 3] of a mesh file, as an ``.npz`` file."""
    import numpy as np

    mesh = _load_mesh(path, skip_materials=True)
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError("a face has a corner that does not exist")
    result = io.BytesIO()
    np.savez(result, vertices=vertices, faces=faces.astype(np.int32))
    return result.getvalue()


def read_colored_triangles(path: str) -> bytes:
    """Return vertices and faces of a mesh file, with uint8 "vertex_colors" [V, 3], "face_colors" [F, 3] or
    "texture" [H, W, 3] and "uv" [V, 2] if it has colors, as an ``.npz`` file."""
    import numpy as np

    mesh = _load_mesh(path)
    arrays = {"vertices": np.asarray(mesh.vertices, np.float64), "faces": np.asarray(mesh.faces, np.int32)}
    visual = mesh.visual
    if visual.kind == "face":
        arrays["face_colors"] = np.asarray(visual.face_colors)[:, :3]
    elif visual.kind == "vertex":
        arrays["vertex_colors"] = np.asarray(visual.vertex_colors)[:, :3]
    elif visual.kind == "texture" and visual.uv is not None:
        material = visual.material
        image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
        if image is None:
            # The texture is missing or can't be read; use the material's color.
            arrays["vertex_colors"] = np.tile(
                np.asarray(material.main_color)[:3], (len(arrays["vertices"]), 1)
            )
        else:
            arrays["uv"] = np.asarray(visual.uv, np.float64)
            arrays["texture"] = np.asarray(image.convert("RGB"))
    vertices, faces = len(arrays["vertices"]), len(arrays["faces"])
    wanted = {"vertex_colors": (vertices, 3), "face_colors": (faces, 3), "uv": (vertices, 2)}
    if any(name in arrays and arrays[name].shape != shape for name, shape in wanted.items()):
        raise ValueError("its colors are not as many as its vertices or faces")
    corners = arrays["faces"]
    if faces and not 0 <= corners.min() <= corners.max() < vertices:
        raise ValueError("a face has a corner that does not exist")
    result = io.BytesIO()
    np.savez(result, **arrays)  # pyright: ignore[reportArgumentType]
    return result.getvalue()


def _load_mesh(path: str, **options: bool) -> Any:
    """Load a mesh file with trimesh, first without ``SPARED`` if it was imported so, because valid files
    rarely need them."""
    try:
        return _trimesh_load(path, **options)
    except Exception:
        if "trimesh" not in _lighter:
            raise
    for name in [name for name in sys.modules if name.split(".")[0] == "trimesh"]:
        del sys.modules[name]
    return _trimesh_load(path, **options)


def _trimesh_load(path: str, **options: bool) -> Any:
    """Load a mesh file with trimesh. Binary PLY files with mixed face sizes are converted to text, because
    trimesh reads them only as text."""
    import trimesh

    load: Any = trimesh.load
    if path.lower().endswith(".dae"):
        if importlib.util.find_spec("collada") is None:
            raise ValueError(
                'a .dae file needs pycollada: pip install ".[collada]" in the clone, or convert it to .obj'
            )
        return _as_collada_says(load(path, force="mesh", process=False, **options), Path(path).read_bytes())
    try:
        return load(path, force="mesh", process=False, **options)
    except ValueError as error:
        if "PLY is unexpected length" not in str(error):
            raise
        text = io.BytesIO(ply_as_text(Path(path).read_bytes()))
        return load(text, file_type="ply", force="mesh", process=False, **options)


def _as_collada_says(mesh: Any, data: bytes) -> Any:
    """Convert the mesh of a .dae file to meters and z up, according to its declared unit and axis. The axis
    is ignored in files of MeshLab, which writes coordinates unchanged."""
    unit = re.search(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)", data)
    axis = re.search(rb"<up_axis>\s*([XY])_UP", data)
    if unit is not None and math.isfinite(float(unit[1])) and float(unit[1]) > 0:
        mesh.apply_scale(float(unit[1]))
    if axis is not None and b"MeshLab" not in data and b"VCGLab" not in data:
        up = {b"Y": [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]}
        up[b"X"] = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
        mesh.apply_transform(up[axis[1]])
    return mesh


_PLY_NAMES = (
    "char uchar short ushort int uint float double int8 uint8 int16 uint16 int32 uint32 float32 float64"
)
_PLY_TYPES: dict[str, str] = dict(zip(_PLY_NAMES.split(), 2 * "bBhHiIfd", strict=True))
"""``struct`` codes of PLY types by both of their names."""


def ply_as_text(data: bytes) -> bytes:
    """Convert a binary PLY file to text (G. Turk, The PLY Polygon File Format, 1994).

    Raises:
        ValueError: the file is truncated, or its header is invalid.
    """
    end = data.index(b"\n", data.index(b"end_header")) + 1
    header = data[:end].decode("ascii").splitlines()
    order = "<" if "format binary_little_endian 1.0" in header else ">"
    elements: list[tuple[int, list[list[str]]]] = []
    for words in (line.split() for line in header):
        if words[:1] == ["element"]:
            elements.append((int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][1].append(words[1:-1])
    lines = [" ".join(line.split()) for line in header]
    lines = ["format ascii 1.0" if line.startswith("format ") else line for line in lines]
    place = end

    def take(kind: str, count: int) -> tuple[Any, ...]:
        nonlocal place
        code = f"{order}{count}{_PLY_TYPES[kind]}"
        begin, place = place, place + struct.calcsize(code)
        if place > len(data):
            raise ValueError("the PLY file ends too early")
        return struct.unpack_from(code, data, begin)

    for count, properties in elements:
        for _ in range(count):
            row: list[Any] = []
            for kind in properties:
                if kind[0] == "list":
                    (number,) = take(kind[1], 1)
                    row += [number, *take(kind[2], number)]
                else:
                    row += take(kind[0], 1)
            lines.append(" ".join(map(str, row)))
    return "\n".join([*lines, ""]).encode()


def compile_model(path: str) -> bytes:
    """Parse and compile a model file with MuJoCo. Returns nothing."""
    import mujoco

    mujoco.set_mju_user_warning(lambda _: None)
    try:
        spec = mujoco.MjSpec.from_file(path)
    except ValueError:
        return b""  # The caller gets the same error and can report more about it.
    try:
        mujoco.MjData(spec.compile())
    except ValueError:
        # The caller may continue without the meshes.
        for geom in list(spec.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        with suppress(ValueError):
            mujoco.MjData(spec.compile())
    return b""


def run_network(path: str) -> bytes:
    """Run a network for two worlds with ONNX Runtime. Returns nothing."""
    import numpy as np
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # Weights must be in the file itself.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(int64)": np.int64}
    kinds |= {"tensor(int32)": np.int32, "tensor(bool)": np.bool_}
    feed = {
        put.name: np.zeros([size if isinstance(size, int) else 2 for size in put.shape], kinds[put.type])
        for put in session.get_inputs()
        if put.type in kinds
    }
    session.run(None, feed)
    return b""


def try_pickle(path: str) -> bytes:
    """Read a pickle of arrays. Returns nothing."""
    importlib.import_module(PICKLES).unpickled(Path(path).read_bytes())
    return b""


JOBS: dict[str, tuple[Callable[[str], bytes], tuple[str, ...]]] = {
    "triangles": (read_triangles, ("numpy", "trimesh")),
    "colored triangles": (read_colored_triangles, ("numpy", "trimesh")),
    "model": (compile_model, ("mujoco",)),
    "network": (run_network, ("numpy", "onnxruntime")),
    "pickle": (try_pickle, (PICKLES,)),
}
"""Jobs by name, with modules that are imported once before the fork."""

_lighter: set[str] = set()
"""Modules that were imported without ``SPARED``."""


def work(job: str, path: str) -> tuple[int, bytes]:
    """Run a job and return status and answer."""
    try:
        return DONE, JOBS[job][0](path)
    except MemoryError:
        return LARGE, b""
    except Exception as error:
        if "bad_alloc" in str(error) or "bad allocation" in str(error) or "llocate memory" in str(error):
            return LARGE, b""
        reason = " ".join(str(error).split()) or type(error).__name__
        return REFUSED, reason[:LONGEST_REASON].encode(errors="backslashreplace")


def serve() -> None:
    """Answer requests until stdin ends."""
    answers = os.dup(1)
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        request = json.loads(line)
        import_for(request["job"])
        _send(answers, *_forked(request))


def import_for(job: str) -> None:
    """Import the modules of a job; trimesh without ``SPARED`` if they are not imported yet."""
    missing: Any = None
    for module in JOBS[job][1]:
        spared = () if module != "trimesh" or module in sys.modules else set(SPARED) - set(sys.modules)
        sys.modules.update(dict.fromkeys(spared, missing))
        importlib.import_module(module)
        for name in spared:
            del sys.modules[name]
            _lighter.add(module)


def _forked(request: dict[str, Any]) -> tuple[int, bytes]:
    here, there = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(here)
        _limit(request["seconds"], request["memory"])
        _send(there, *work(request["job"], request["path"]))
        os._exit(0)
    os.close(there)
    with os.fdopen(here, "rb") as stream:
        answer = stream.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == 0 and len(answer) >= HEAD.size:
        return answer[0], answer[HEAD.size :]
    if code in (-signal.SIGXCPU, -signal.SIGALRM, -signal.SIGKILL):
        return SLOW, b""
    return CRASHED, (signal.Signals(-code).name if code < 0 else f"exit status {code}").encode()


def _limit(seconds: float, memory: int) -> None:
    import resource

    signal.setitimer(signal.ITIMER_REAL, 10 * seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 1))
    for name in ("RLIMIT_DATA", "RLIMIT_AS"):
        with suppress(ValueError, OSError):
            size = memory if name == "RLIMIT_DATA" else 2 * memory
            resource.setrlimit(getattr(resource, name), (size, size))
    for name in ("RLIMIT_FSIZE", "RLIMIT_CORE"):
        resource.setrlimit(getattr(resource, name), (0, 0))


def _send(to: int, status: int, answer: bytes) -> None:
    with os.fdopen(os.dup(to), "wb") as stream:
        stream.write(HEAD.pack(status, len(answer)))
        stream.write(answer)


if __name__ == "__main__":
    serve()
