"""``fungrasp export``: write recorded episodes in other formats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult, progress_bar
from fungrasp.cli.options import ObjectsOption
from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    import numpy as np

    from fungrasp.evaluation import Trajectory


@dataclass(frozen=True)
class Export(ObjectsOption, Answering):
    """Write recorded episodes (evaluate --record) as a LeRobot data set or as MCAP files."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episode files (.npz) or folders."""
    out: Path = Path("dataset")
    """Folder to write."""
    format: Literal["lerobot", "mcap"] = "lerobot"
    """Output format."""
    cameras: tuple[Literal["front", "wrist"], ...] = ()
    """Cameras to render for LeRobot: front (above the table), wrist (on the hand)."""
    size: tuple[int, int] = (320, 240)
    """Width and height of the images [pixels]."""
    threads: int = 0
    """Number of threads for rendering; 0 means all processors."""

    def run(self) -> CommandResult:
        from fungrasp.media.mcap_episodes import write_mcap_episodes

        if self.format == "mcap":
            written = write_mcap_episodes(self._episodes(), self.out)
            words = f"{len(written)} files; Foxglove and Rerun open them"
        else:
            words, written = self._lerobot()
        return CommandResult(
            {"out": self.out, "format": self.format, "written": written}, f"{self.out}: {words}"
        )

    def _episodes(self) -> list[Trajectory]:
        from fungrasp.evaluation import replay

        files = []
        for path in self.recordings:
            files += sorted(path.rglob("*.npz")) if path.is_dir() else [path]
        if not files:
            raise FungraspError("there are no recorded episodes: give files or folders of evaluate --record")
        return [replay(file) for file in files]

    def _lerobot(self) -> tuple[str, list[Path]]:
        from fungrasp.hands import load_hand
        from fungrasp.media.lerobot_dataset import episode_pictures, write_lerobot_dataset
        from fungrasp.objects import load_object

        # Recordings of use tests have no controls.
        lifts = [episode for episode in self._episodes() if not episode.is_use_test]
        whole = len(self.cameras) * sum(len(episode.times) for episode in lifts)

        def see(camera: Literal["front", "wrist"], episode: Trajectory) -> Iterator[np.ndarray]:
            obj = load_object(episode.object_name, episode.object_mass, self.objects)
            hand = load_hand(episode.hand)
            for picture in episode_pictures(episode, hand, obj, camera, self.size, self.threads):
                advance()
                yield picture

        with progress_bar("drawing", max(whole, 1)) as show:
            done = count(1)

            def advance() -> None:
                show(next(done))

            cameras = {camera: partial(see, camera) for camera in self.cameras}
            written = write_lerobot_dataset(lifts, self.out, cameras)
        seen = f", seen from {' and '.join(self.cameras)}" if self.cameras else ""
        return f"{len(lifts)} episodes, format of LeRobot{seen}", [written]


COMMAND = Export
