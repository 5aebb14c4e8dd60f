"""``fungrasp view``: show grasps, episodes, results, logs, captures and hands in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from fungrasp.cli.options import ObjectsOption
from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fungrasp.objects import ObjectModel


@dataclass(frozen=True)
class View(ObjectsOption):
    """Show grasps, episodes, results, logs, captures or hands in a browser. Drag a grasp, play a lift, replay
    the episodes of a result. Only this machine can open the page, unless you pass --host."""

    what: Annotated[str | None, tyro.conf.Positional] = None
    """A grasp file or recorded episode (.npz), a result (.json), a deployment log (.mcap), a hand (.toml,
    or its name), or the folder of a capture. Default: the built-in grasps."""
    hand: str = "allegro"
    """Initial robot hand for human grasps: name of a hand, or the path of its TOML file."""
    mesh: str | None = None
    """The object in a capture: a mesh file [m], or the name of a built-in object."""
    grasps: Path | None = None
    """File with the robot grasps of a result, if it was moved."""
    recordings: Path | None = None
    """Folder with the recorded episodes of a result, if it was moved."""
    out: Path | None = None
    """Write a static page, which needs no server, to this file instead."""
    host: str = "127.0.0.1"
    """Address to listen on. With 0.0.0.0, everyone on the network can open the page and use this machine's
    processors."""
    port: int | None = None
    """Port to listen on. Default: the first free one from 8080."""
    browser: bool = False
    """Open a browser."""

    def run(self) -> None:
        from fungrasp.viewer.view import view

        what, objects = self._what()
        shown = view(
            what,
            objects,
            out=self.out,
            hand=self.hand,
            host=self.host,
            port=self.port,
            browser=self.browser,
            wait=True,
        )
        if self.out is not None:
            print(shown)

    def _what(self) -> tuple[Any, Mapping[str, ObjectModel] | None]:
        if self.mesh is not None:
            from fungrasp.viewer.choose_page import capture_page

            if self.what is None:
                raise FungraspError("--mesh needs the folder of a capture")
            return capture_page(self.what, self.mesh), None
        if self.grasps is not None or self.recordings is not None:
            from fungrasp.viewer.choose_page import shown_result

            if self.what is None or not self.what.endswith(".json"):
                raise FungraspError("--grasps and --recordings need a result (.json)")
            return shown_result(self.what, self.grasps, self.objects, self.recordings), None
        return self.what, self._objects()

    def _objects(self) -> Mapping[str, ObjectModel] | None:
        if self.objects is None:
            return None
        from fungrasp.core.formats.numpy_files import read_npz
        from fungrasp.grasps import load_grasps, load_objects
        from fungrasp.objects import load_object

        if self.what is None or not self.what.endswith(".npz"):
            raise FungraspError("--objects needs a file of grasps or of an episode (.npz)")
        fields = read_npz(Path(self.what), "file", lambda name: name in ("qpos", "object_name"))
        if "qpos" in fields:
            name = str(fields["object_name"])
            return {name: load_object(self.objects / f"{name}.obj")}
        return load_objects(load_grasps(self.what), self.objects)


COMMAND = View
