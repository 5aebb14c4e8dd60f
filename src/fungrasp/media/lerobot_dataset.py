"""Export of recorded episodes as a LeRobot dataset, with rendered cameras."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import Trajectory
from fungrasp.geometry.poses import rotate, transform_points
from fungrasp.hands import Hand, load_hand
from fungrasp.media.camera import Camera
from fungrasp.media.grasp_scenes import robot_grasp_scene, robot_scene_states
from fungrasp.media.render import Renderer
from fungrasp.media.video import write_video
from fungrasp.objects import ObjectModel

LEROBOT_VERSION = "v3.0"
"""Version of the LeRobot dataset format."""

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"

VIDEO_QUALITY = 20.0
"""Constant rate factor of the videos, better than LeRobot's 30 because networks are trained on them."""
VIDEO_KEYFRAMES = 2
"""Keyframe interval in frames, for random access, as in LeRobot's datasets."""
STATS_EVERY = 4
"""Color statistics use every fourth frame, and every fourth pixel in both directions."""

_INDICES = ("frame_index", "episode_index", "index", "task_index")

CameraName = Literal["front", "wrist"]
"""A fixed camera that looks at the initial place of the object, and a camera that moves with the palm."""

FRONT = (0.68, 0.32, 0.4)
"""Position of the fixed camera relative to the object's initial place: on the far side of the table, off to
one side [m]."""
FRONT_ABOVE = 0.12
"""Height of the fixed camera's target above the object's initial place [m]; a lift is 10 cm or more."""
WRIST = (-0.16, 0.1)
"""Position of the wrist camera from the palm's origin, along the fingers and along the palm normal [m]: on a
bracket at the wrist, clear of the fingers."""
WRIST_TARGET = (0.12, 0.05)
"""Target of the wrist camera in the same coordinates [m]: the point where the fingertips meet."""
WRIST_FOV = 65.0
"""Vertical field of view of the wrist camera [degrees]; small cameras have 60 to 90."""

Pictures = Callable[[Trajectory], Iterator[np.ndarray]]
"""Yields an image of each state of an episode, sRGB, shape [height, width, 3] uint8, all of one size."""


def write_lerobot_dataset(
    episodes: Sequence[Trajectory], folder: str | Path, cameras: Mapping[str, Pictures] | None = None
) -> Path:
    """Write a LeRobot dataset (v3.0) of episodes of one hand; ``LeRobotDataset(name, root=folder)`` loads it.

    ``observation.state`` is the palm pose and all joints, ``observation.environment_state`` the object pose,
    ``observation.contacts`` the links in contact. ``action`` is the servo controls that lead to the next
    state (the wrist's six joints, then the fingers). ``next.success`` is whether the episode succeeded, at
    its last state. ``observation.images.<camera>`` are H.264 videos.

    Args:
        episodes: lift tests of one hand, with controls.
        folder: output folder; must not exist.
        cameras: functions from an episode to its images, by camera name (``episode_pictures``). Default:
            none.

    Raises:
        FungraspError: pyarrow is not installed, no episodes, several hands, an episode without controls or
            with unevenly spaced states, or the folder exists or can't be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise FungraspError(
            f'LeRobot data sets need a package: pip install ".[lerobot]" in the clone ({error})'
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
        films = {name: _Film(name, see) for name, see in (cameras or {}).items()}
        for film in films.values():
            film.write(part, episodes, fps)
            features |= film.feature(fps)
        table = _episode_table(pa, episodes, spans, fps, [film.key for film in films.values()])
        pq.write_table(table, part / "meta/episodes/chunk-000/file-000.parquet")
        pq.write_table(_task_table(pa, tasks), part / "meta/tasks.parquet")
        stats = {name: _stats(values) for name, values in columns.items()}
        stats |= {film.key: film.stats() for film in films.values()}
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
            "video_path": VIDEO_PATH if films else None,
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
        raise FungraspError(f"{folder} already exists: give another name")
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
    """Return types, shapes and names of the columns."""
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
    """Return the columns of all states, and the first and last index of each episode."""
    parts: list[dict[str, np.ndarray]] = []
    spans, count = [], 0
    for number, episode in enumerate(episodes):
        size = len(episode.times)
        assert episode.controls is not None
        # Recorded controls lead to their state; an action follows its state.
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


class _Film:
    """Video of one camera with all episodes in one file."""

    def __init__(self, name: str, pictures: Pictures):
        self.key = f"observation.images.{name}"
        """Key of the feature."""
        self._pictures = pictures
        self._shape = 0, 0
        self._seen: list[np.ndarray] = []

    def write(self, folder: Path, episodes: Sequence[Trajectory], fps: float) -> None:
        """Write the video of all episodes to the dataset folder."""
        path = folder / VIDEO_PATH.format(video_key=self.key, chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        every = (picture for episode in episodes for picture in self._noted(episode))
        write_video(path, every, fps, quality=VIDEO_QUALITY, keyframes=VIDEO_KEYFRAMES)

    def _noted(self, episode: Trajectory) -> Iterator[np.ndarray]:
        count = 0
        for picture in self._pictures(episode):
            self._shape = picture.shape[:2]
            if count % STATS_EVERY == 0:
                self._seen.append(picture[::STATS_EVERY, ::STATS_EVERY].reshape(-1, 3) / 255)
            count += 1
            yield picture
        if count != len(episode.times):
            raise FungraspError(f"a camera has {count} pictures of {len(episode.times)} states")

    def feature(self, fps: float) -> dict[str, Any]:
        """Return the entry for ``info.json``."""
        height, width = self._shape
        told = {"height": height, "width": width, "channels": 3, "codec": "h264", "pix_fmt": "yuv420p"}
        info = {f"video.{name}": value for name, value in told.items()}
        info |= {"video.fps": fps, "video.is_depth_map": False, "has_audio": False}
        names = ["height", "width", "channels"]
        return {self.key: {"dtype": "video", "shape": [height, width, 3], "names": names, "info": info}}

    def stats(self) -> dict[str, Any]:
        """Return color statistics, 0 to 1, for each channel, shape [3, 1, 1] each."""
        found = _stats(np.concatenate(self._seen))
        shaped = {name: [[[number]] for number in numbers] for name, numbers in found.items()}
        return shaped | {"count": [len(self._seen)]}


def _episode_table(
    pa: Any,
    episodes: Sequence[Trajectory],
    spans: Sequence[tuple[int, int]],
    fps: float,
    films: Sequence[str],
) -> Any:
    zeros = [0] * len(episodes)
    of_films: dict[str, Any] = {}
    for key in films:
        of_films |= {f"videos/{key}/chunk_index": zeros, f"videos/{key}/file_index": zeros}
        for which, moments in zip(("from", "to"), zip(*spans, strict=True), strict=True):
            of_films[f"videos/{key}/{which}_timestamp"] = [moment / fps for moment in moments]
    return pa.table(
        {
            **of_films,
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
    """Return a table that pandas reads with the task text as index."""
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


def episode_pictures(
    episode: Trajectory,
    hand: Hand,
    obj: ObjectModel,
    camera: CameraName,
    size: tuple[int, int] = (320, 240),
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """Yield an image of each state of an episode of ``hand`` and ``obj``.

    Args:
        camera: name of the camera.
        size: width and height [pixels].
        threads: 0 for all CPUs; the result does not depend on it.

    Yields:
        sRGB, shape [height, width, 3] uint8.

    Raises:
        FungraspError: a state is not finite (the simulation diverged), or the camera is unknown.
    """
    wrist, joints, object_poses = episode.palm_pose, episode.joint_positions, episode.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], obj, object_poses[0])
    states = robot_scene_states(model, hand, wrist, joints, object_poses)
    width, height = size
    if camera == "front":
        foot = np.array([*object_poses[0, :2], 0.0], dtype=float)
        at, target = foot + FRONT, foot + np.array([0.0, 0.0, FRONT_ABOVE])
        views = Camera(_three(at), _three(target), width=width, height=height)
    elif camera == "wrist":
        across = np.stack([hand.palm_fingers, hand.palm_normal])
        places = transform_points(wrist, np.array([WRIST, WRIST_TARGET]) @ across)
        ups = rotate(wrist[:, 3:], np.tile(hand.palm_normal, (len(wrist), 1)))
        views = [
            Camera(_three(at), _three(target), _three(up), WRIST_FOV, width, height)
            for (at, target), up in zip(places, ups, strict=True)
        ]
    else:
        raise FungraspError(f"there is no camera '{camera}'; there are front and wrist")
    return Renderer(model, threads=threads).stream(states, views)


def _three(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
