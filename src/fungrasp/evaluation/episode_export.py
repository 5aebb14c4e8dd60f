"""Recorded episodes for other programs: a LeRobot data set, or MCAP files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.evaluation.trajectory import Trajectory
from fungrasp.files import atomic_path
from fungrasp.hands import load_hand
from fungrasp.version import __version__

LEROBOT_VERSION = "v3.0"
"""Of the format of LeRobot's data sets that is written."""

TOPIC = "/state"
"""Of the messages of an MCAP file; each is one state."""

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

_INDICES = ("frame_index", "episode_index", "index", "task_index")


def write_mcap_episodes(episodes: Sequence[Trajectory], folder: str | Path) -> list[Path]:
    """One MCAP file for each episode: a message for each state, with all its numbers; what belongs to the
    whole episode is its metadata. ``read_mcap_episode`` reads it back.

    Args:
        episodes: of any hands.
        folder: is made; files are called ``<row>_<object>.mcap``.

    Raises:
        FungraspError: mcap is not installed, or a file can't be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise FungraspError(f"MCAP files need a package: pip install 'fungrasp[deploy]' ({error})") from error
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
    """An episode that ``write_mcap_episodes`` has written.

    Raises:
        FungraspError: mcap is not installed, or it is no such file.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ImportError as error:
        raise FungraspError(f"MCAP files need a package: pip install 'fungrasp[deploy]' ({error})") from error
    try:
        with Path(path).open("rb") as stream:
            reader = make_reader(stream)
            found = {record.name: record.metadata for record in reader.iter_metadata()}
            states = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=[TOPIC])]
        whole = {name: json.loads(value) for name, value in found["episode"].items()}
        columns = {name: [state[name] for state in states] for name in states[0]}
    except (OSError, McapError, KeyError, IndexError, ValueError) as error:
        raise FungraspError(f"{path} is no episode that was exported: {error}") from error
    kinds = {"link_contacts": bool, "phase": np.int8}
    arrays: dict[str, Any] = {}
    for name, rows in columns.items():
        arrays[name] = np.array(rows, dtype=kinds.get(name, np.float32))
    whole["wrist_reference"] = np.array(whole["wrist_reference"], dtype=np.float32)
    return Trajectory(**whole, **arrays)


def write_lerobot_dataset(episodes: Sequence[Trajectory], folder: str | Path) -> Path:
    """A LeRobot data set (v3.0) of episodes of one hand; ``LeRobotDataset(name, root=folder)`` loads it.

    ``observation.state`` is the palm's pose and all joints, ``observation.environment_state`` the object's
    pose, ``observation.contacts`` which links touch; ``action`` is what the servos were told before the next
    state (the wrist's six joints, then the fingers), and ``next.success`` whether the episode succeeded, at
    its last state.

    Args:
        episodes: lift tests of one hand, with controls.
        folder: must not exist.

    Raises:
        FungraspError: pyarrow is not installed, no episodes, several hands, an episode without controls or
            with states that are not evenly spaced, or the folder exists or can't be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise FungraspError(
            f"LeRobot data sets need a package: pip install 'fungrasp[lerobot]' ({error})"
        ) from error
    folder = Path(folder)
    _check(episodes, folder)
    hand = load_hand(episodes[0].hand)
    features = _features(episodes[0], hand.joint_names, tuple(hand.actuators), hand.link_names)
    tasks = sorted({_task(episode) for episode in episodes})
    columns, spans = _columns(episodes, tasks)
    fps = round(1 / float(np.diff(episodes[0].times).mean()))
    part = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(part, ignore_errors=True)
    try:
        for name in ("data/chunk-000", "meta/episodes/chunk-000"):
            (part / name).mkdir(parents=True)
        table = pa.table({name: _arrow(pa, values) for name, values in columns.items()})
        pq.write_table(table, part / "data/chunk-000/file-000.parquet")
        pq.write_table(_episode_table(pa, episodes, spans), part / "meta/episodes/chunk-000/file-000.parquet")
        pq.write_table(_task_table(pa, tasks), part / "meta/tasks.parquet")
        stats = {name: _stats(columns[name]) for name in features}
        (part / "meta/stats.json").write_text(json.dumps(stats, indent=1) + "\n")
        info = {
            "codebase_version": LEROBOT_VERSION,
            "robot_type": hand.name,
            "total_episodes": len(episodes),
            "total_frames": len(columns["index"]),
            "total_tasks": len(tasks),
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": fps,
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": features,
        }
        (part / "meta/info.json").write_text(json.dumps(info, indent=1) + "\n")
        part.rename(folder)
    except OSError as error:
        raise FungraspError(f"cannot write {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def _check(episodes: Sequence[Trajectory], folder: Path) -> None:
    if not episodes:
        raise FungraspError("there are no episodes to export")
    if folder.exists():
        raise FungraspError(f"{folder} exists already: give another name")
    hands = sorted({episode.hand for episode in episodes})
    if len(hands) > 1:
        raise FungraspError(f"a data set is of one hand, not of {', '.join(hands)}")
    for episode in episodes:
        where = f"episode {episode.index}, {episode.object_name}"
        if episode.controls is None:
            raise FungraspError(f"{where}: the recording holds no controls (a use test, or an old one)")
        steps = np.diff(episode.times)
        if len(steps) == 0 or np.ptp(steps) > 1e-3:
            raise FungraspError(f"{where}: its states are not evenly spaced")


def _task(episode: Trajectory) -> str:
    return f"lift the {episode.object_name.replace('_', ' ')}"


def _features(
    episode: Trajectory, joints: Sequence[str], servos: Sequence[str], links: Sequence[str]
) -> dict[str, Any]:
    """Types, shapes and names of the columns."""
    wrist = [f"wrist {name}" for name in ("x", "y", "z", "rx", "ry", "rz")]
    named = {
        "observation.state": ("float32", [*(f"palm {name}" for name in POSE), *joints]),
        "observation.environment_state": ("float32", [f"object {name}" for name in POSE]),
        "observation.contacts": ("bool", list(links)),
        "action": ("float32", [*wrist, *servos]),
    }
    found: dict[str, Any] = {
        name: {"dtype": kind, "shape": [len(names)], "names": names} for name, (kind, names) in named.items()
    }
    single = {"next.success": "bool", "timestamp": "float32", **dict.fromkeys(_INDICES, "int64")}
    return found | {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in single.items()}


def _columns(
    episodes: Sequence[Trajectory], tasks: Sequence[str]
) -> tuple[dict[str, np.ndarray], list[tuple[int, int]]]:
    """Columns of all states, and where each episode begins and ends."""
    parts: list[dict[str, np.ndarray]] = []
    spans, count = [], 0
    for number, episode in enumerate(episodes):
        size = len(episode.times)
        assert episode.controls is not None
        # Recorded is what led to a state; an action is what follows it.
        action = np.concatenate([episode.controls[1:], episode.controls[-1:]])
        success = np.zeros(size, dtype=bool)
        success[-1] = episode.success
        parts.append(
            {
                "observation.state": np.concatenate([episode.palm_pose, episode.joint_positions], axis=1),
                "observation.environment_state": episode.object_pose,
                "observation.contacts": episode.link_contacts,
                "action": action,
                "next.success": success,
                "timestamp": (episode.times - episode.times[0]).astype(np.float32),
                "frame_index": np.arange(size),
                "episode_index": np.full(size, number),
                "index": count + np.arange(size),
                "task_index": np.full(size, tasks.index(_task(episode))),
            }
        )
        spans.append((count, count + size))
        count += size
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, spans


def _arrow(pa: Any, values: np.ndarray) -> Any:
    kind = {"f": pa.float32(), "b": pa.bool_(), "i": pa.int64()}[values.dtype.kind]
    if values.ndim == 1:
        return pa.array(values, type=kind)
    flat = pa.array(np.ascontiguousarray(values).ravel(), type=kind)
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1]).cast(pa.list_(kind, values.shape[1]))


def _episode_table(pa: Any, episodes: Sequence[Trajectory], spans: Sequence[tuple[int, int]]) -> Any:
    zeros = [0] * len(episodes)
    return pa.table(
        {
            "episode_index": list(range(len(episodes))),
            "tasks": [[_task(episode)] for episode in episodes],
            "length": [end - start for start, end in spans],
            "data/chunk_index": zeros,
            "data/file_index": zeros,
            "dataset_from_index": [start for start, _ in spans],
            "dataset_to_index": [end for _, end in spans],
            "meta/episodes/chunk_index": zeros,
            "meta/episodes/file_index": zeros,
        }
    )


def _task_table(pa: Any, tasks: Sequence[str]) -> Any:
    """A frame of pandas whose index is the task in words."""
    index = "__index_level_0__"
    table = pa.table({"task_index": list(range(len(tasks))), index: list(tasks)})
    kinds = (("task_index", "task_index", "int64", "int64"), (None, index, "unicode", "object"))
    described = [
        {"name": name, "field_name": column, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, column, kind, numpy in kinds
    ]
    pandas = {"index_columns": [index], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    return table.replace_schema_metadata({b"pandas": json.dumps(pandas).encode()})


def _stats(values: np.ndarray) -> dict[str, Any]:
    numbers = values.astype(np.float64)
    numbers = numbers[:, None] if numbers.ndim == 1 else numbers
    found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(numbers)]}


def _whole(episode: Trajectory) -> dict[str, Any]:
    """What belongs to all of an episode."""
    names = ("hand", "object_name", "object_mass", "index", "success", "reason", "differs")
    whole = {name: getattr(episode, name) for name in names}
    return whole | {"wrist_reference": np.asarray(episode.wrist_reference, dtype=float).tolist()}


def _states(episode: Trajectory) -> list[dict[str, Any]]:
    """What belongs to each state."""
    names = ["times", "qpos", "object_pose", "palm_pose", "joint_positions", "link_contacts", "phase"]
    names += [] if episode.controls is None else ["controls"]
    columns = {name: np.asarray(getattr(episode, name)).tolist() for name in names}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
