"""Recorded episodes as MCAP files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.evaluation.trajectory import Trajectory

TOPIC = "/state"
"""Topic of messages in an MCAP file; each message is one state."""


def write_mcap_episodes(episodes: Sequence[Trajectory], folder: str | Path) -> list[Path]:
    """Write one MCAP file per episode, with one message per state and the episode's data as metadata.
    ``read_mcap_episode`` reads it.

    Args:
        folder: folder for the files ``<row>_<object>.mcap``; it is created.

    Raises:
        FungraspError: mcap is not installed, or a file can't be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise FungraspError(
            f'MCAP files need mcap: pip install ".[deploy]" in the clone ({error})'
        ) from error
    folder, written = Path(folder), []
    folder.mkdir(parents=True, exist_ok=True)
    for episode in episodes:
        use = "_use" if episode.is_use_test else ""
        path = folder / f"{episode.index:04d}_{episode.object_name}{use}.mcap"
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="", library=f"fungrasp {__version__}")
            schema = writer.register_schema("object", "jsonschema", b'{"type": "object"}')
            channel = writer.register_channel(TOPIC, "json", schema)
            writer.add_metadata(
                "episode", {name: json.dumps(value) for name, value in _whole(episode).items()}
            )
            for number, (time, state) in enumerate(zip(episode.times, _states(episode), strict=True)):
                stamp = round(float(time) * 1e9)
                writer.add_message(channel, stamp, json.dumps(state).encode(), stamp, number)
            writer.finish()
        written.append(path)
    return written


def read_mcap_episode(path: str | Path) -> Trajectory:
    """Read an episode written by ``write_mcap_episodes``.

    Raises:
        FungraspError: mcap is not installed, or the file is not an exported episode.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ImportError as error:
        raise FungraspError(
            f'MCAP files need mcap: pip install ".[deploy]" in the clone ({error})'
        ) from error
    try:
        with Path(path).open("rb") as stream:
            reader = make_reader(stream)
            found = {record.name: record.metadata for record in reader.iter_metadata()}
            states = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=[TOPIC])]
        whole = {name: json.loads(value) for name, value in found["episode"].items()}
        columns = {name: [state[name] for state in states] for name in states[0]}
    except (OSError, McapError, KeyError, IndexError, ValueError) as error:
        raise FungraspError(f"{path} is not an exported episode: {error}") from error
    kinds = {"link_contacts": bool, "phase": np.int8}
    arrays: dict[str, Any] = {}
    for name, rows in columns.items():
        arrays[name] = np.array(rows, dtype=kinds.get(name, np.float32))
    whole["wrist_reference"] = np.array(whole["wrist_reference"], dtype=np.float32)
    return Trajectory(**whole, **arrays)


def _whole(episode: Trajectory) -> dict[str, Any]:
    """Return the data of the whole episode."""
    names = ("hand", "object_name", "object_mass", "index", "success", "reason", "differs")
    whole = {name: getattr(episode, name) for name in names}
    return whole | {"wrist_reference": np.asarray(episode.wrist_reference, dtype=float).tolist()}


def _states(episode: Trajectory) -> list[dict[str, Any]]:
    """Return the data of each state."""
    names = ["times", "qpos", "object_pose", "palm_pose", "joint_positions", "link_contacts", "phase"]
    names += [] if episode.controls is None else ["controls"]
    columns = {name: np.asarray(getattr(episode, name)).tolist() for name in names}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
