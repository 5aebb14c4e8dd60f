"""What gets installed: the wheel holds every data file, and importing the package is light."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder

import fungrasp
from fungrasp.policies.checkpoint.checkpoint_file import read_card

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "fungrasp"

EXTRAS = (
    "allegro",
    "bench",
    "deploy",
    "dexycb",
    "fast",
    "ik",
    "inspire",
    "leap",
    "learning",
    "mano",
    "perception",
    "pose",
    "ray",
    "sysid",
    "ur",
    "wandb",
)
"""Of the product, not of its development."""

FREE = "Apache-2.0"
FOREIGN = re.compile(r"(mano_|dex-?ycb|research)(?!.*\.(py|md)$)", re.IGNORECASE)
"""Parts of the names of files (other than code and pages) and data sets that may not be shipped."""

IMPORTED_ELSEWHERE = {
    "ai_edge_litert",
    "daqp",
    "dynamixel_sdk",
    "msgpack",
    "pymodbus",
    "pyserial",
    "pyzmq",
    "ruckig",
    "tensorboard",
    "ur_rtde",
}
"""Declared, but imported by name at run time, or by torch or mink."""


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
    for suffix in (".xml", ".toml", ".npz", ".css", ".typed"):
        assert any(name.endswith(suffix) for name in shipped), suffix


def test_the_wheel_holds_licence_and_command(wheel: zipfile.ZipFile) -> None:
    names = wheel.namelist()
    assert any(name.endswith("licenses/LICENSE") for name in names)
    entry_points = next(name for name in names if name.endswith("entry_points.txt"))
    assert "fungrasp = fungrasp.cli.main:main" in wheel.read(entry_points).decode()
    metadata = next(name for name in names if name.endswith("METADATA"))
    needed = re.findall(r"^Requires-Dist: ([\w-]+)(.*)$", wheel.read(metadata).decode(), re.MULTILINE)
    core = {name for name, condition in needed if "extra ==" not in condition}
    assert not core & {"torch", "smplx", "mujoco", "ray", "warp-lang", "mediapipe"}


def test_the_wheel_is_small(wheel: zipfile.ZipFile) -> None:
    policies = [entry.compress_size for entry in wheel.infolist() if entry.filename.endswith(".onnx")]
    assert max(policies) < 2e6, "each policy a few MB at most"
    assert sum(entry.compress_size for entry in wheel.infolist()) - sum(policies) < 2e6


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
        ("fungrasp.evaluation", ("torch", "smplx", "av", "yaml")),
        ("fungrasp.grasps.importers.dexycb", ("torch", "smplx", "yaml")),
    ],
)
def test_importing_pulls_in_nothing_heavy(module: str, light_without: tuple[str, ...]) -> None:
    code = f"import sys, {module}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & set(light_without)


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == fungrasp.__version__
    assert f"version: {fungrasp.__version__}" in (ROOT / "CITATION.cff").read_text()


def test_the_imported_packages_are_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = [
        *project["dependencies"],
        *(need for extra in EXTRAS for need in project["optional-dependencies"][extra]),
    ]
    names = {re.split(r"[\[<>= ]", need)[0].lower().replace("-", "_") for need in declared}
    modules = {
        "can": "python_can",
        "mujoco": "mujoco_core",
        "PIL": "pillow",
        "rsl_rl": "rsl_rl_lib",
        "yaml": "pyyaml",
    }
    imported: set[str] = set()
    for path in SOURCE.rglob("*.py"):
        found = re.findall(r"^\s*(?:import (\w+)|from (\w+)[\w.]* import)", path.read_text(), re.MULTILINE)
        imported |= {name for names in found for name in names if name}
    third_party = imported - set(sys.stdlib_module_names) - {"fungrasp", "__future__"}
    assert {modules.get(name, name).lower() for name in third_party} <= names
    assert names - IMPORTED_ELSEWHERE <= {modules.get(name, name).lower() for name in third_party}


def test_the_makefile_names_modules_that_exist() -> None:
    modules = re.findall(r"from (fungrasp[\w.]*) import", (ROOT / "Makefile").read_text())
    assert modules and all(importlib.util.find_spec(name) for name in modules)
