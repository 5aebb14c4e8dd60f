"""What gets installed: the wheel holds every data file, and importing the package is light."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import pytest
from hatchling.builders.sdist import SdistBuilder

import fungrasp
from fungrasp.policies.checkpoint.checkpoint_file import read_card

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "fungrasp"

BENCHMARKS = ("bench", "drake")
"""Extras of what measures the product."""
DEVELOPMENT = (*BENCHMARKS, "dev", "docs")
"""Extras that the product does not need."""

OWN = {"fungrasp", "fungrasp_emulators", "benchmarks"}
"""Packages of this repository."""

FREE = "Apache-2.0"
FOREIGN = re.compile(r"(mano_|dex-?ycb|research)(?!.*\.(py|md)$)", re.IGNORECASE)
"""Parts of the names of files (other than code and pages) and data sets that may not be shipped."""

IMPORTED_BY_OTHERS = {"mujoco", "daqp", "embreex", "pyserial", "tensorboard", "pycollada"}
"""Distributions that are declared for other packages: solver of mink, ray casts of trimesh, ports of pymodbus
and dynamixel_sdk, event files of torch; .dae meshes of trimesh; mujoco itself of mujoco-warp, beside
mujoco-core."""

DISTRIBUTIONS = {
    "warp": "warp-lang",
    "PIL": "pillow",
    "ai_edge_litert": "ai-edge-litert",
    "can": "python-can",
    "cv2": "opencv-python-headless",
    "dashboard_client": "ur-rtde",
    "dex_retargeting": "dex-retargeting",
    "dexi": "dexi-rs",
    "pydrake": "drake",
    "dynamixel_sdk": "dynamixel-sdk",
    "mujoco": "mujoco-core",
    "rsl_rl": "rsl-rl-lib",
    "rtde_control": "ur-rtde",
    "rtde_receive": "ur-rtde",
    "serial": "pyserial",
    "yaml": "pyyaml",
    "zmq": "pyzmq",
}
"""Distributions of the modules that are called otherwise."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel that pip builds from the repository."""
    folder = tmp_path_factory.mktemp("wheel")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *options, str(ROOT)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return zipfile.ZipFile(next(folder.glob("fungrasp-*.whl")))


@pytest.fixture(scope="module")
def source_distribution(tmp_path_factory: pytest.TempPathFactory) -> tarfile.TarFile:
    """The source distribution that a release would upload."""
    folder = str(tmp_path_factory.mktemp("sdist"))
    return tarfile.open(next(SdistBuilder(str(ROOT)).build(directory=folder)))


def test_the_wheel_holds_every_file_of_the_package(wheel: zipfile.ZipFile) -> None:
    shipped = {name.removeprefix("fungrasp/") for name in wheel.namelist() if name.startswith("fungrasp/")}
    wanted = {
        str(path.relative_to(SOURCE))
        for path in SOURCE.rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert shipped == wanted
    assert {name.split("/")[0].split("-")[0] for name in wheel.namelist()} == {"fungrasp"}, "and nothing else"
    for suffix in (".xml", ".toml", ".npz", ".css", ".typed"):
        assert any(name.endswith(suffix) for name in shipped), suffix


def test_the_wheel_holds_licence_and_command(wheel: zipfile.ZipFile) -> None:
    names = wheel.namelist()
    assert any(name.endswith("licenses/LICENSE") for name in names)
    entry_points = next(name for name in names if name.endswith("entry_points.txt"))
    assert "fungrasp = fungrasp.cli.start:start" in wheel.read(entry_points).decode()
    metadata = next(name for name in names if name.endswith("METADATA"))
    needed = re.findall(r"^Requires-Dist: ([\w-]+)(.*)$", wheel.read(metadata).decode(), re.MULTILINE)
    core = {name for name, condition in needed if "extra ==" not in condition}
    assert not core & {"torch", "smplx", "mujoco", "ray", "warp-lang", "mediapipe"}


def test_the_wheel_is_small(wheel: zipfile.ZipFile) -> None:
    policies = [entry.compress_size for entry in wheel.infolist() if entry.filename.endswith(".onnx")]
    assert max(policies) < 2e6, "each policy a few MB at most"
    assert sum(entry.compress_size for entry in wheel.infolist()) - sum(policies) < 2.2e6


def check_free(files: dict[str, bytes], folder: Path) -> None:
    """Refuse files whose terms forbid anything, and those of data sets that are under other licences.

    Args:
        files: contents by name.
        folder: an empty one, to write policies to.
    """
    policies = 0
    for name, content in files.items():
        assert not FOREIGN.search(name), name
        assert not name.endswith((".obj", ".stl", ".ply", ".glb", ".pkl", ".pt")), name
        if name.endswith(".onnx"):
            policies += 1
            path = folder / Path(name).name
            path.write_bytes(content)
            card = read_card(path)
            assert card.licence == FREE and card.training_data, name
            assert all(data.terms.startswith(FREE) for data in card.training_data), name
            assert not any(FOREIGN.search(data.name) for data in card.training_data), name
    assert policies


def test_the_wheel_holds_only_what_is_free(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    check_free({name: wheel.read(name) for name in wheel.namelist()}, tmp_path)
    licences = [name for name in wheel.namelist() if name.endswith("METADATA")]
    assert f"License-Expression: {FREE}\n" in wheel.read(licences[0]).decode()


def test_the_source_distribution_holds_only_what_is_free(
    source_distribution: tarfile.TarFile, tmp_path: Path
) -> None:
    contents: dict[str, bytes] = {}
    for member in source_distribution.getmembers():
        file = source_distribution.extractfile(member)
        if file is not None and Path(member.name).suffix not in (".py", ".md"):
            contents[member.name] = file.read()
    check_free(contents, tmp_path)


def test_the_check_finds_what_is_not_free(tmp_path: Path) -> None:
    for path in (ROOT / "research").glob("*.onnx"):
        with pytest.raises(AssertionError):
            check_free({path.name: path.read_bytes()}, tmp_path)
    for name in ("fungrasp/MANO_RIGHT.npz", "fungrasp/dexycb/labels.npz", "fungrasp/research/x.bin"):
        with pytest.raises(AssertionError):
            check_free({name: b""}, tmp_path)


@pytest.mark.parametrize(
    ("module", "light_without"),
    [
        ("fungrasp", ("numpy", "mujoco", "scipy", "trimesh", "tyro", "PIL", "av", "rich")),
        ("fungrasp.cli.main", ("numpy", "mujoco", "scipy", "trimesh", "PIL", "av", "rich")),
        ("fungrasp.cli.perceive", ("numpy", "scipy", "trimesh", "PIL")),
        # Numba imports PyYAML where it is installed.
        ("fungrasp.evaluation", ("torch", "smplx", "av")),
        ("fungrasp.grasps.importers.dexycb", ("torch", "smplx", "yaml")),
        # Each costs `fungrasp perceive` a sixth of a second or more, and is used later, or not at all.
        ("fungrasp.perception.pipeline", ("trimesh", "networkx", "numba", "mujoco", "torch", "av")),
    ],
)
def test_importing_pulls_in_nothing_heavy(module: str, light_without: tuple[str, ...]) -> None:
    code = f"import sys, {module}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & set(light_without)


def test_a_mesh_file_that_was_read_before_needs_no_trimesh(tmp_path: Path) -> None:
    path = tmp_path / "wedge.obj"
    corners = "v 0 0 0\nv 0.05 0 0\nv 0 0.06 0\nv 0 0 0.07\n"
    path.write_text(corners + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    code = f"import sys; from fungrasp.objects import resolve_object; resolve_object({str(path)!r}, 0.1); "
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code + "print(*sys.modules)"], capture_output=True, text=True, check=True
        )
    assert "trimesh" not in done.stdout.split()


def test_the_page_about_an_image_needs_nothing_that_simulates() -> None:
    code = "import sys, fungrasp.media.perception_page; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    rooms = {"evaluation", "planning", "policies", "retargeting", "simulation", "task"}
    assert not set(done.stdout.split()) & {f"fungrasp.{room}" for room in rooms}


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == fungrasp.__version__
    assert f"version: {fungrasp.__version__}" in (ROOT / "CITATION.cff").read_text()


IMPORTERS = ("import_module", "import_client")
"""Functions that are given a module's name."""


class Imports(NamedTuple):
    """What a file imports, and whether as soon as it is imported itself."""

    at_once: set[str]
    """Modules."""
    later: set[str]
    """Modules; those named in ``import_module`` and ``import_client`` too."""


def imports_of(path: Path) -> Imports:
    found = Imports(set(), set())

    def visit(node: ast.AST, names: set[str]) -> None:
        for child in ast.iter_child_nodes(node):
            inner = names
            typing = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            if typing or isinstance(child, ast.FunctionDef | ast.Lambda):
                inner = found.later
            elif isinstance(child, ast.Import):
                names |= {alias.name for alias in child.names}
            elif isinstance(child, ast.ImportFrom) and child.module:
                names |= {child.module, *(f"{child.module}.{alias.name}" for alias in child.names)}
            elif isinstance(child, ast.Call) and re.search(
                r"\bimport_(module|client)$", ast.unparse(child.func)
            ):
                words = [word.value for word in child.args[:1] if isinstance(word, ast.Constant)]
                found.later.update(word for word in words if isinstance(word, str))
            visit(child, inner)

    visit(ast.parse(path.read_text()), found.at_once)
    return found


def third_party(names: Iterable[str]) -> set[str]:
    """Distributions of imported modules."""
    tops = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - OWN
    return {DISTRIBUTIONS.get(top, top.replace("_", "-")) for top in tops}


def declared() -> tuple[set[str], dict[str, set[str]]]:
    """Distributions that are always installed, and those of each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def names(needs: Iterable[str]) -> set[str]:
        return {re.split(r"[\[<>=; ]", need)[0].lower() for need in needs} - {"fungrasp"}

    return names(project["dependencies"]), {
        extra: names(needs) for extra, needs in project["optional-dependencies"].items()
    }


@pytest.fixture(scope="module")
def imported() -> dict[str, Imports]:
    """Imports of each module of the package, by its name."""
    files = {path: path.relative_to(SOURCE.parent).with_suffix("").parts for path in SOURCE.rglob("*.py")}
    return {".".join(parts).removesuffix(".__init__"): imports_of(path) for path, parts in files.items()}


def test_what_is_imported_is_declared_and_what_is_declared_is_imported(imported: dict[str, Imports]) -> None:
    core, extras = declared()
    known = core.union(*(extras[extra] for extra in extras if extra not in DEVELOPMENT))
    used = third_party(name for found in imported.values() for name in found.at_once | found.later)
    assert used <= known, "undeclared"
    assert known - IMPORTED_BY_OTHERS <= used, "declared for nothing"
    benchmarks = {
        name for path in (ROOT / "benchmarks").rglob("*.py") for name in set().union(*imports_of(path))
    }
    assert third_party(benchmarks) <= known.union(*(extras[extra] for extra in BENCHMARKS))


def test_no_command_needs_an_extra_to_be_imported(imported: dict[str, Imports]) -> None:
    """Nor does a room: what needs one is imported when it is used, and asks for it in words."""
    core, _ = declared()
    todo = [name for name in imported if name.startswith("fungrasp.cli") or name.count(".") < 2]
    seen: set[str] = set()
    while todo:
        name = todo.pop()
        if name in seen or name not in imported:
            continue
        seen.add(name)
        assert third_party(imported[name].at_once) <= core, name
        todo += imported[name].at_once
    assert "fungrasp.cli.deploy" in seen and "fungrasp.training.ppo" not in seen


def test_no_module_is_named_like_a_test() -> None:
    found = [path for folder in (SOURCE, ROOT / "benchmarks") for path in folder.rglob("*_test.py")]
    assert not found
