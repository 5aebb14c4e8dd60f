"""``python -m benchmarks.engines audit``: whether recorded grasps hold in other physics engines as well."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fungrasp.cli.console import Answer, progress_bar
from fungrasp.cli.options import JsonOut, json_path


@dataclass(frozen=True)
class Audit:
    """Play recorded episodes open loop in another physics engine: what holds there, how much slips, what
    differs and why."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episodes that `fungrasp evaluate --record` wrote in the nominal world, or folders of them."""
    engine: Literal["drake", "mujoco"] = "drake"
    """Drake (extra "drake"), or MuJoCo built anew from what was recorded: the control."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    use: bool = False
    """Take the recorded use tests from folders in place of lift tests: those in which only the hand moves, as
    it pours or hammers. The object has to stay where it is in the palm."""
    json: JsonOut = None
    """Write what is found of each episode here (.json); without a file, print it. Given again with its file
    after an interruption, the command goes on."""
    bundles: Path | None = None
    """Write what the engines are given of each episode to this folder: a file that holds everything, which
    this command reads as well."""

    def run(self) -> Answer:
        from benchmarks.engines.audit import audit, load_bundles
        from benchmarks.engines.audit.other_engines import world_maker
        from benchmarks.engines.audit.result_file import KeptEpisodes
        from fungrasp.objects import load_object

        world_maker(self.engine)
        made = load_bundles(
            self.recordings, lambda one: load_object(one.object_name, one.object_mass, self.objects), self.use
        )
        if self.bundles is not None:
            self.bundles.mkdir(parents=True, exist_ok=True)
            for bundle in made:
                bundle.save(self.bundles)
        kept = KeptEpisodes(json_path(self.json), self.engine)
        with progress_bar(f"in {self.engine}", len(made)) as show:
            result = audit(made, self.engine, kept.known, kept.add, show)
        return Answer(result.json(), result.table())
