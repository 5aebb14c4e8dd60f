"""``fungrasp perceive``: turn an RGB-D image of a held object into a human grasp."""

from __future__ import annotations

import logging
import os
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fungrasp.cli.console import LOW_CONFIDENCE, CommandResult, option, suggestion, table, write_json
from fungrasp.cli.options import JsonOut, json_path, optional_value
from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.image_source import REALSENSE, ImageSource

if TYPE_CHECKING:
    import numpy as np

    from fungrasp.perception.perceived import Perceived


@dataclass(frozen=True)
class CommandSource(ImageSource):
    """The image: three files, a folder, a RealSense camera or its recording."""

    camera: Annotated[str | None, optional_value("[realsense]", REALSENSE, "camera")] = None
    """Take an image now, with the connected RealSense camera."""


@dataclass(frozen=True)
class Perceive:
    """Turn an RGB-D image of a hand holding a known object into a human grasp.

    Exit status 3: the grasp was written with low confidence.
    """

    mesh: str
    """The object: a mesh file [m], a built-in object, or a shape [mm]: box:60x28x30, cylinder:66x115
    (diameter, height), sphere:67. "unknown" fits a shape to the depth."""
    out: Path
    """Grasp file to write (.npz)."""
    source: CommandSource = field(default_factory=CommandSource)
    """The image."""
    side: Literal["right", "left"] | None = None
    """Side of the hand. Default: recognized."""
    mass: float | None = None
    """Mass of the object [kg]. Default: known for built-in objects, otherwise guessed from the mesh."""
    task: str = ""
    """Purpose of the grasp: "drink", "hand over" ..."""
    table: str | None = None
    """Plane of the table top, nx,ny,nz,d [m]: camera frame, normal upwards. Default: detected."""
    hand_file: Path | None = None
    """Hand estimate of another program such as HaMeR or WiLoR (.json or .npz)."""
    object_pose_file: Path | None = None
    """Object pose of another program: a 4x4 matrix or a FoundationPose folder."""
    improve_pose: bool = False
    """Fit the object pose of another program to the depth."""
    hand_from: str | None = None
    """Entry point of another package that estimates the hand."""
    object_pose_from: str | None = None
    """Entry point of another package that estimates the object pose."""
    seed: int = 0
    """Random seed."""
    report: Path | None = None
    """Write an HTML page with pictures to this file."""
    json: JsonOut = None
    """Write all results to this JSON file; without a file, print them."""

    def run(self) -> CommandResult:
        from time import perf_counter

        start = perf_counter()
        # BLAS threads slow down small matrices. NumPy reads this variable on import.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        self._check()
        from fungrasp.perception.pipeline import perceive

        perceived = perceive(
            self.source,
            self.mesh,
            mass=self.mass,
            side=self.side,
            task=self.task,
            table=parse_plane(self.table),
            hand=self._hand(),
            object_estimate=self._object_pose(),
            seed=self.seed,
            improve_pose=self.improve_pose,
        )
        kept = [] if self.source.keep is None else [f"the image: {self.source.keep}"]
        written, fault = self._write(perceived, perf_counter() - start)
        touching = int(perceived.grasp.link_contacts.sum())
        name = perceived.object_model.name
        # Warnings about image files are logged already.
        for warning in perceived.warnings[len(perceived.capture.warnings) :]:
            logging.getLogger(__name__).warning(warning)
        lines = [
            table(perceived.acceptance.rows()),
            f"{self.out}: a {perceived.hand.side} hand on '{name}', {touching} links in contact",
            *(*perceived.notes, *kept, *written),
            perceived.acceptance.summary(),
        ]
        if perceived.confident:
            folder = Path(self.mesh).parent if Path(self.mesh).is_file() else None
            given = option("--objects", folder)
            lines.append(suggestion("retarget --grasps", self.out, given, "--out robot.npz"))
        else:
            lines += [f"what would help: {words}" for words in perceived.acceptance.help]
            print("fungrasp: low confidence: check the grasp before you use it", file=sys.stderr)
        status = 0 if perceived.confident else LOW_CONFIDENCE
        value = {"grasps": self.out, **perceived.as_json()}
        return CommandResult(value, "\n".join(lines), fault=fault, status=status)

    def _check(self) -> None:
        """Check that the options are consistent and the hand models installed."""
        from fungrasp.core.files import check_writable
        from fungrasp.perception.hand.mediapipe_models import load_weights

        if None not in (self.hand_file, self.hand_from):
            raise FungraspError("give --hand-file or --hand-from, not both")
        if None not in (self.object_pose_file, self.object_pose_from):
            raise FungraspError("give --object-pose-file or --object-pose-from, not both")
        self.source.check()
        written = {"--out": self.out, "--report": self.report, "--json": json_path(self.json)}
        check_writable({name: path for name, path in written.items() if path is not None})
        if self.improve_pose and self.object_pose_file is None and self.object_pose_from is None:
            raise FungraspError("--improve-pose needs --object-pose-file or --object-pose-from")
        if self.hand_file is None and self.hand_from is None:
            # Fails before slow imports and files.
            load_weights()

    def _hand(self) -> Any:
        """Return the hand estimator given by the user, or None."""
        if self.hand_file is None and self.hand_from is None:
            return None
        from fungrasp.core.plugins import load_plugin
        from fungrasp.perception.adapters import read_hand_estimate

        if self.hand_from is not None:
            return load_plugin("fungrasp.hand_estimators", "hand estimator", self.hand_from)
        assert self.hand_file is not None
        return partial(read_hand_estimate, self.hand_file, side=self.side)

    def _object_pose(self) -> Any:
        """Return the object pose or its estimator given by the user, or None."""
        if self.object_pose_file is None and self.object_pose_from is None:
            return None
        from fungrasp.core.plugins import load_plugin
        from fungrasp.perception.adapters import read_object_pose

        if self.object_pose_from is not None:
            group, kind = "fungrasp.object_pose_estimators", "object pose estimator"
            return load_plugin(group, kind, self.object_pose_from)
        assert self.object_pose_file is not None
        return read_object_pose(self.object_pose_file, image=self.source.image)

    def _write(self, perceived: Perceived, seconds: float) -> tuple[list[str], str]:
        """Write all files, the grasp first. Return lines to print, and the errors of other files or ""."""
        from fungrasp.grasps import save_human_grasps

        save_human_grasps(self.out, perceived.grasps)
        notes: list[str] = []
        if perceived.hand.side == "left":
            name = perceived.grasp.object_name
            notes.append(
                f"the scene was mirrored to make the hand a right hand: '{name}' is the mirrored mesh"
            )
        faults: list[str] = []
        path = json_path(self.json)
        if path is not None:
            try:
                write_json(path, perceived.as_json())
            except FungraspError as error:
                faults.append(str(error))
        if self.report is not None:
            try:
                self._write_page(self.report, perceived, seconds)
                notes.append(f"page: {self.report}")
            except (FungraspError, OSError) as error:
                faults.append(str(error))
        return notes, f"{'; '.join(faults)}; the grasp is in {self.out}" if faults else ""

    def _write_page(self, path: Path, perceived: Perceived, seconds: float) -> None:
        from fungrasp.core.provenance import page_provenance
        from fungrasp.media.perception_page import write_perception_page

        made = page_provenance({"Image": self.source.name}, self.seed, seconds)
        write_perception_page(path, perceived, made)


COMMAND = Perceive


def parse_plane(text: str | None) -> np.ndarray | None:
    """Parse a plane ``nx,ny,nz,d``: unit normal and offset [m], shape [4]. None: no plane.

    Raises:
        FungraspError: the text is not a plane.
    """
    import numpy as np

    if text is None:
        return None
    try:
        plane = np.array([float(part) for part in text.split(",")])
    except ValueError:
        plane = np.zeros(0)
    length = float(np.linalg.norm(plane[:3]))
    if plane.shape != (4,) or not np.isfinite(plane).all() or not 0.99 < length < 1.01:
        raise FungraspError(f"a table is nx,ny,nz,d with a normal of length 1, not '{text}'")
    return plane / length
