"""``fungrasp retarget``: human grasps become grasps of a robot hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fungrasp.cli.console import Answering, CommandResult, option, progress_bar, suggestion, write_json
from fungrasp.cli.options import on_cluster, print_use


@dataclass(frozen=True)
class Retarget(Answering):
    """Turn human grasps into grasps of a robot hand, and measure how good they are."""

    out: Path
    """Grasp file to write (.npz). Finished parts lie in <out>.partial until all are done: the same command
    goes on where an interrupted one was."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    mirror: bool = False
    """Mirror the grasps and their objects first: grasps of right hands for a left hand, or the other way
    round. Mirrored objects are named <name>_mirrored."""
    method: str = "contact"
    """Retargeting method: contact, angle-copy or dexgraspnet."""
    quality: Path | None = None
    """Write a summary of the quality of the grasps here (.json)."""
    picture: Path | None = None
    """Draw some of the grasps, human and robot side by side, to this PNG file."""
    threads: int = 0
    """Number of threads, 0 for all processors; the result does not depend on it."""
    ray: tuple[str, ...] | None = None
    """Work on a Ray cluster: on that of this address ("auto": the one that this machine is part of), or on
    all processors of this machine where none is given. Same grasps."""

    def run(self) -> CommandResult:
        from time import perf_counter

        from fungrasp.core.formats.text_files import finite
        from fungrasp.core.jobs import PartStore
        from fungrasp.evaluation.grasp_quality import static_quality, with_quality
        from fungrasp.grasps import load_human_grasps, load_objects, mirrored_grasps, save_robot_grasps
        from fungrasp.hands import load_hand
        from fungrasp.hands.collisions import self_contact_words
        from fungrasp.media.pictures import draw_grasps
        from fungrasp.retargeting import retarget

        hand, cluster = load_hand(self.hand), on_cluster(self.ray)
        human = load_human_grasps(self.grasps)
        if self.mirror:
            human = mirrored_grasps(human)
        objects = load_objects(human, self.objects)
        with PartStore.beside(self.out) as store:
            start = perf_counter()
            with progress_bar(f"retargeting to {hand.name} ({self.method})", 1.0) as show:
                robot = retarget(
                    human,
                    objects,
                    hand,
                    self.method,
                    threads=self.threads,
                    store=store,
                    ray=cluster,
                    progress=show,
                )
            rate = len(human) / (perf_counter() - start)
            quality = static_quality(robot, human, objects, hand)
            save_robot_grasps(self.out, with_quality(robot, quality))
        print_use(cluster)
        touching = self_contact_words(hand.model, robot.joint_positions)
        numbers = {"grasps_per_second": rate, "self_penetration_reasons": touching}
        summary = finite(quality.summary()) | numbers
        if self.quality is not None:
            write_json(self.quality, summary)
        if self.picture is not None:
            with progress_bar("drawing", 1.0) as show:
                draw_grasps(self.picture, robot, objects, human, progress=show)
        lines = [
            quality.table(),
            *(f"warning: {words}" for words in touching),
            f"{self.out}: {len(robot)} grasps of {len(objects)} objects, {rate:,.1f} grasps/s",
            suggestion("evaluate --grasps", self.out, option("--objects", self.objects)),
        ]
        value = {"grasps": self.out, "count": len(robot), "objects": len(objects), "quality": summary}
        return CommandResult(value, "\n".join(lines))


COMMAND = Retarget
