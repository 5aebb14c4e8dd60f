"""``fungrasp export``: recorded episodes and grasps for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from fungrasp.evaluation import Trajectory


@dataclass(frozen=True)
class Export:
    """Write recorded episodes (evaluate --record) as a data set of LeRobot's, MCAP files or joint
    trajectories with a URDF, or robot grasps as DexGraspBench reads them."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Files of episodes (.npz), or folders of them; of dexgraspbench one file of robot grasps."""
    out: Path = Path("dataset")
    """Folder to be written."""
    format: Literal["lerobot", "mcap", "urdf", "dexgraspbench"] = "lerobot"
    """What is written."""
    objects: Path | None = None
    """Folder of meshes <name>.obj, for the grasps of dexgraspbench; built-in objects need none."""

    def run(self) -> None:
        from fungrasp.evaluation.episode_export import write_lerobot_dataset, write_mcap_episodes
        from fungrasp.evaluation.grasp_export import write_joint_trajectories

        if self.format == "dexgraspbench":
            self._grasps()
        elif self.format == "mcap":
            written = write_mcap_episodes(self._episodes(), self.out)
            print(f"{self.out}: {len(written)} files; Foxglove and Rerun open them")
        elif self.format == "urdf":
            written = write_joint_trajectories(self._episodes(), self.out)
            print(f"{self.out}: a URDF and {len(written)} joint trajectories")
        else:
            # A use test begins in the midst of what a lift test ends with, and its controls are not recorded.
            lifts = [episode for episode in self._episodes() if not episode.is_use_test]
            print(f"{write_lerobot_dataset(lifts, self.out)}: {len(lifts)} episodes, format of LeRobot")

    def _episodes(self) -> list[Trajectory]:
        from fungrasp.errors import FungraspError
        from fungrasp.evaluation import replay

        files = []
        for path in self.recordings:
            files += sorted(path.rglob("*.npz")) if path.is_dir() else [path]
        if not files:
            raise FungraspError("there are no recorded episodes: give files or folders of evaluate --record")
        return [replay(file) for file in files]

    def _grasps(self) -> None:
        from fungrasp.errors import FungraspError
        from fungrasp.evaluation.grasp_export import write_dexgraspbench
        from fungrasp.grasps import load_objects, load_robot_grasps

        if len(self.recordings) != 1:
            raise FungraspError("dexgraspbench needs one file of robot grasps (fungrasp retarget)")
        grasps = load_robot_grasps(self.recordings[0])
        written = write_dexgraspbench(grasps, load_objects(grasps, self.objects), self.out)
        print(f"{self.out}: {len(written)} grasps, their objects and hand.xml, for DexGraspBench")


COMMAND = Export
