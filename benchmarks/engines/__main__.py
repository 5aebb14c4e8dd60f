"""``python -m benchmarks.engines audit``: which recorded grasps hold in another physics engine as well, how
much slips, and what differs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from benchmarks.command import main
from benchmarks.engines.bundle import EpisodeBundle, make_bundle, scene_of
from benchmarks.engines.replay import EpisodeWorld, Replayed, play_bundle
from fungrasp.cli.console import CommandResult, progress_bar, write_json
from fungrasp.cli.options import JsonOut, json_path
from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_to_json
from fungrasp.core.text_table import table
from fungrasp.evaluation import Trajectory, replay
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.objects import ObjectModel, load_object
from fungrasp.simulation import Scene


@dataclass(frozen=True)
class AuditResult:
    """N recorded episodes in another engine."""

    episodes: tuple[Replayed, ...]
    """What came of each."""

    @property
    def agreeing(self) -> int:
        """How many ended as recorded."""
        return sum(one.success == one.recorded for one in self.episodes)

    def table(self) -> str:
        """What holds, what differs and why, as text."""
        held = [one for one in self.episodes if one.recorded]
        lost = [one for one in self.episodes if not one.recorded]
        rows = [("recorded", "episodes", "held here", "95 % interval")]
        for name, some in (("held", held), ("lost", lost)):
            if some:
                both = sum(one.success for one in some)
                low, high = wilson_interval(both, len(some))
                rows.append((name, str(len(some)), str(both), f"{low:.0%} to {high:.0%}"))
        lines = [table(rows)]
        kept = [one for one in held if one.success]
        if kept:
            before = np.median([one.recorded_slip_mm_s for one in kept])
            here = np.median([one.slip_mm_s for one in kept])
            lines.append(f"slip of what is held in both, median: {before:.2f} mm/s recorded, {here:.2f} here")
        for title, some in (("held only when recorded", held), ("held only here", lost)):
            apart = [one for one in some if one.success != one.recorded]
            why = Counter((one.difference, one.reason) for one in apart)
            lines += [
                f"{title}: {count:3d} {why}" + (f" ({reason})" if reason else "")
                for (why, reason), count in why.most_common()
            ]
        return "\n".join(lines)

    def json(self) -> dict[str, Any]:
        """All numbers."""
        return {"each": [record_to_json(one) for one in self.episodes]}


def audit(
    bundles: Sequence[EpisodeBundle],
    make: Callable[[EpisodeBundle], EpisodeWorld],
    progress: Callable[[int], None] = lambda done: None,
) -> AuditResult:
    """Play recorded episodes open loop in another engine.

    Args:
        bundles: N of them.
        make: makes an episode's world there.
        progress: called with the number of episodes that are done.
    """
    found = []
    for number, bundle in enumerate(bundles):
        found.append(play_bundle(bundle, make(bundle)))
        progress(number + 1)
    return AuditResult(tuple(found))


def load_bundles(
    paths: Sequence[Path], objects: Callable[[Trajectory], ObjectModel], use: bool = False
) -> list[EpisodeBundle]:
    """The bundles of recordings.

    Args:
        paths: recorded episodes, or folders of them.
        objects: gives the object of a recording.
        use: whether to take use tests from folders, those in which only the hand moves, in place of lift
            tests.

    Raises:
        FungraspError: no recordings, or one that can't be replayed.
    """
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.npz"))
            files += [file for file in inside if file.name.split(".")[0].endswith("_use") == use]
        else:
            files.append(path)
    if not files:
        raise FungraspError(f"there are no recorded episodes in {', '.join(map(str, paths))}")
    scenes: dict[tuple[str, str], Scene] = {}
    found = []
    for file in files:
        recorded = replay(file)
        if recorded.controls is None and use and file not in paths:
            continue
        key = recorded.hand, recorded.object_name
        if key not in scenes:
            scenes[key] = scene_of(recorded, {recorded.object_name: objects(recorded)})
        found.append(make_bundle(file.stem, recorded, scenes[key]))
    if not found:
        raise FungraspError("in all of these use tests the world pushes or pulls at the object")
    return found


@dataclass(frozen=True)
class Audit:
    """Play recorded episodes open loop in Drake (extra "drake"): what holds there, how much slips, what
    differs and why."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episodes that `fungrasp evaluate --record` wrote in the nominal world, or folders of them."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    use: bool = False
    """Take the recorded use tests from folders in place of lift tests: those in which only the hand moves, as
    it pours or hammers. The object has to stay where it is in the palm."""
    json: JsonOut = None
    """Write what is found of each episode here (.json); without a file, print it."""

    def run(self) -> CommandResult:
        if find_spec("pydrake") is None:
            raise FungraspError('Drake is not installed: pip install "fungrasp[drake]"')
        from benchmarks.engines.drake_world import DrakeWorld

        made = load_bundles(
            self.recordings, lambda one: load_object(one.object_name, one.object_mass, self.objects), self.use
        )
        with progress_bar("in Drake", len(made)) as show:
            result = audit(made, DrakeWorld, show)
        path = json_path(self.json)
        if path is not None:
            write_json(path, result.json())
        return CommandResult(result.json(), result.table())


COMMAND = {"audit": Audit}
"""By subcommand name."""


if __name__ == "__main__":
    main("engines", COMMAND)
