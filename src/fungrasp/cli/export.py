"""``fungrasp export``: recorded episodes for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Export:
    """Make a data set of recorded episodes (evaluate --record): LeRobot's, or a MCAP file for each."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Files of episodes (.npz), or folders of them."""
    out: Path = Path("dataset")
    """Folder to be written."""
    format: Literal["lerobot", "mcap"] = "lerobot"
    """What is written."""

    def run(self) -> None:
        from fungrasp.errors import FungraspError
        from fungrasp.evaluation import replay
        from fungrasp.evaluation.episode_export import write_lerobot_dataset, write_mcap_episodes

        files = []
        for path in self.recordings:
            files += sorted(path.rglob("*.npz")) if path.is_dir() else [path]
        if not files:
            raise FungraspError("there are no recorded episodes: give files or folders of evaluate --record")
        episodes = [replay(file) for file in files]
        if self.format == "mcap":
            written = write_mcap_episodes(episodes, self.out)
            print(f"{self.out}: {len(written)} files; Foxglove and Rerun open them")
            return
        # A use test begins in the midst of what a lift test ends with, and its controls are not recorded.
        lifts = [episode for episode in episodes if not episode.is_use_test]
        print(f"{write_lerobot_dataset(lifts, self.out)}: {len(lifts)} episodes, format of LeRobot")


COMMAND = Export
