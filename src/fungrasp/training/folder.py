"""The folder of a training: settings, progress, and checkpoints, from which a training can continue.

A checkpoint consists of a line with the format, the SHA-256 of the rest, and the output of ``torch.save``.
Truncated or modified files are detected before they are parsed. Reading never runs code from the file.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes
from fungrasp.core.formats.text_files import parse_json, read_json
from fungrasp.core.provenance import git_revision, machine
from fungrasp.training.environment import TrainingEnvironment

LARGEST_PROGRESS = 1_000_000_000
LARGEST_CHECKPOINT = 2_000_000_000
"""Largest sizes of files that are read [bytes]."""

MAGIC = b"fungrasp checkpoint 2\n"
"""First line of a checkpoint; its number increases with the format."""
DIGITS = 64
"""Length of the digest in hexadecimal digits."""

NAMED = 5
"""Largest number of differences listed in an error message."""


class RunFolder:
    """The files of one training.

    ``config.json`` contains ``settings``, which must not change, and values that may change between calls.
    """

    def __init__(self, path: Path):
        """path: path of the folder, which need not exist."""
        self.path = path
        self.config = path / "config.json"
        self.checkpoint = path / "checkpoint.pt"
        self.progress = path / "progress.jsonl"

    def claim(self, settings: Mapping[str, Any], **more: Any) -> None:
        """Write ``config.json``, or continue the training in the folder.

        Args:
            settings: settings of the training, JSON values.

        Raises:
            FungraspError: the folder has a training with other settings or a checkpoint without settings, or
                can't be written to.
        """
        wanted = json.loads(json.dumps(settings, allow_nan=False))
        if self.config.is_file():
            found = list(_differences(self.read_config()["settings"], wanted))
            if found:
                rest = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
                raise FungraspError(
                    f"{self.path} holds a training with other settings: {'; '.join(found[:NAMED])}{rest}. "
                    "Give the same settings to go on, or another folder"
                )
        elif self.checkpoint.exists():
            raise FungraspError(f"{self.path} holds a checkpoint and no config.json: give another folder")
        made_by = {"version": __version__, "git_revision": git_revision(), "machine": machine()}
        with atomic_path(self.config) as part:
            part.write_text(json.dumps(more | {"made_by": made_by, "settings": wanted}, indent=1) + "\n")

    def read_config(self) -> dict[str, Any]:
        """Read the file written by ``claim``.

        Raises:
            FungraspError: the file is missing or damaged.
        """
        if not self.config.is_file():
            raise FungraspError(f"{self.path} is not the folder of a training: it has no {self.config.name}")
        config = read_json(self.config, "settings of a training")
        if isinstance(config, dict) and isinstance(config.get("settings"), dict):
            return config
        raise FungraspError(f"{self.config} is damaged, or not of a training")

    def forget_progress_after(self, steps: int) -> None:
        """Remove lines of progress that an interrupted training wrote after its last checkpoint.

        Raises:
            FungraspError: the file can't be written.
        """
        if not self.progress.is_file():
            return
        kept = []
        text = read_bytes(self.progress, "progress of a training", LARGEST_PROGRESS).decode(errors="replace")
        for line in text.splitlines(keepends=True):
            with contextlib.suppress(FungraspError, KeyError, TypeError):
                if parse_json(line, str(self.progress))["steps"] <= steps:
                    kept.append(line)
        with atomic_path(self.progress) as part:
            part.write_text("".join(kept))

    def add_progress(self, numbers: Mapping[str, Any]) -> None:
        """Append a line of progress.

        Raises:
            FungraspError: the file can't be written.
        """
        try:
            with self.progress.open("a") as stream:
                stream.write(json.dumps(numbers) + "\n")
        except OSError as error:
            raise FungraspError(f"cannot write {self.progress}: {error.strerror or error}") from error


def _differences(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """Describe each difference in words."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in dict.fromkeys([*there, *here]):
            yield from _differences(there.get(key), here.get(key), f"{name}.{key}".strip("."))
    elif there != here:
        yield f"{name} is {_short(there)} there, {_short(here)} here"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def write_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state of tensors, numbers, text and nested dictionaries atomically.

    Raises:
        FungraspError: the file can't be written.
    """
    buffer = io.BytesIO()
    torch.save(dict(state), buffer)
    payload = buffer.getvalue()
    with atomic_path(path) as part, part.open("wb") as stream:
        stream.write(MAGIC + hashlib.sha256(payload).hexdigest().encode() + b"\n" + payload)
        stream.flush()
        os.fsync(stream.fileno())


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a state written by ``write_checkpoint``.

    Raises:
        FungraspError: the file is missing, damaged, or not a checkpoint of this version.
    """
    data = read_bytes(path, "checkpoint", LARGEST_CHECKPOINT)
    if not data.startswith(MAGIC):
        raise FungraspError(f"{path} is not a checkpoint of this version of fungrasp")
    said, payload = data[len(MAGIC) : len(MAGIC) + DIGITS], data[len(MAGIC) + DIGITS + 1 :]
    found = hashlib.sha256(payload).hexdigest()
    if said != found.encode():
        raise FungraspError(
            f"the checkpoint {path} is damaged or was changed since it was saved: its SHA-256 is "
            f"{found[:12]}..., it says {said.decode('ascii', errors='replace')[:12]}..."
        )
    try:
        state = torch.load(io.BytesIO(payload), map_location="cpu", weights_only=True)
    except Exception as error:
        raise FungraspError(f"cannot read the checkpoint {path}: {' '.join(str(error).split())}") from error
    if not isinstance(state, dict):
        raise FungraspError(f"{path} is not a checkpoint of this version of fungrasp")
    return state


def environment_state(environment: TrainingEnvironment) -> dict[str, Any]:
    """Return identifying data, success rates and random state of an environment."""
    device = torch.as_tensor(environment.observations.robot).device
    return {
        "hand": environment.hand.name,
        "layout_name": environment.settings.layout,
        "layout": _layout(environment),
        "success_of_group": torch.from_numpy(environment.success_of_group.copy()),
        "diverged": environment.diverged,
        "environment_steps": environment.steps,
        "random": json.dumps(environment.rng.bit_generator.state),
        "torch_random": torch.get_rng_state(),
        "device_random": None if device.type == "cpu" else torch.cuda.get_rng_state(device),
    }


def check_environment(path: Path, state: Mapping[str, Any], environment: TrainingEnvironment) -> None:
    """Check that a checkpoint fits an environment.

    Raises:
        FungraspError: the checkpoint is for another hand or other observations.
    """
    hand = environment.hand.name
    if state.get("hand") != hand:
        raise FungraspError(f"the checkpoint {path} is of the hand '{state.get('hand')}', not of '{hand}'")
    name, wanted = state.get("layout_name"), environment.settings.layout
    if name != wanted:
        raise FungraspError(
            f"the checkpoint {path} was trained with the observation layout '{name}', not '{wanted}'"
        )
    if state.get("layout") != _layout(environment):
        raise FungraspError(f"the checkpoint {path} was trained on other observations")


def restore_environment(state: Mapping[str, Any], environment: TrainingEnvironment) -> None:
    """Restore success rates and random state from a checkpoint, and begin new episodes."""
    rates = state["success_of_group"].numpy()
    if rates.shape == environment.success_of_group.shape:
        environment.success_of_group[:] = rates
    environment.steps = int(state.get("environment_steps", 0))
    environment.diverged = int(state.get("diverged", 0))
    environment.rng.bit_generator.state = json.loads(state["random"])
    torch.set_rng_state(state["torch_random"])
    if state.get("device_random") is not None and torch.cuda.is_available():
        torch.cuda.set_rng_state(state["device_random"])
    environment.restart()


def _layout(environment: TrainingEnvironment) -> str:
    return json.dumps([environment.layout, environment.privileged_layout, environment.value_layout])
