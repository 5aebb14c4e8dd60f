"""Checkpoints: all that a training needs to go on, in one file.

A file begins with a line that names the format, then the SHA-256 of the rest, then what ``torch.save`` gives;
a file that was cut off or changed is found before it is read. Reading never runs code of the file.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import read_bytes
from fungrasp.training.environment import TrainingEnvironment

MAGIC = b"fungrasp checkpoint 2\n"
"""Its number goes up when checkpoints change."""
LARGEST = 2_000_000_000
"""Bytes of the largest file that is read."""
DIGITS = 64
"""Length of the digest in hexadecimal digits."""


def write_checkpoint(path: Path, state: Mapping[str, Any]) -> None:
    """Keep a state: tensors, numbers, text and tables of these. An older file is there until the new one is
    whole.

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
    """What ``write_checkpoint`` kept.

    Raises:
        FungraspError: no such file, no checkpoint of this version, or one that is damaged.
    """
    data = read_bytes(path, "checkpoint", LARGEST)
    if not data.startswith(MAGIC):
        raise FungraspError(f"{path} is no checkpoint of this version of fungrasp")
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
        raise FungraspError(f"{path} is no checkpoint of this version of fungrasp")
    return state


def environment_state(environment: TrainingEnvironment) -> dict[str, Any]:
    """What tells an environment from others, and what it has learned and drawn so far."""
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
    """Refuse a checkpoint from another kind of environment.

    Raises:
        FungraspError: it is of another hand or of other observations.
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
    """Go on with the success rates and random numbers of a checkpoint; episodes begin anew."""
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
