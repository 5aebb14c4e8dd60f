"""``fungrasp retarget``: turn human grasps into grasps of a robot hand."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from fungrasp.cli.console import Answering, CommandResult, option, progress_bar, suggestion, write_json
from fungrasp.cli.options import ClusterOption, GraspsOption, MirrorOption, ThreadsOption, print_use
from fungrasp.retargeting.settings import RetargetSpec


@dataclass(frozen=True)
class Retarget(GraspsOption, MirrorOption, ThreadsOption, ClusterOption, Answering):
    """Turn human grasps into grasps of a robot hand, and measure their quality."""

    option_prefixes: ClassVar[bool] = True

    out: Path
    """Grasp file to write (.npz). Run the same command again to continue an interrupted run; finished parts
    are kept in <out>.partial."""
    spec: Annotated[RetargetSpec, tyro.conf.arg(name="")] = field(default_factory=RetargetSpec)
    """Settings of retargeting."""
    quality: Path | None = None
    """Write a quality summary to this file (.json)."""
    exact: bool = False
    """Measure quality with exact mesh distances (the solver's are up to 1 mm off) and add the weakest
    resisted wrench. Doubles the time."""
    picture: Path | None = None
    """Draw some grasps, human and robot side by side, to this PNG file."""

    def run(self) -> CommandResult:
        from time import perf_counter

        from fungrasp.core.formats.text_files import finite
        from fungrasp.core.jobs import PartStore
        from fungrasp.evaluation.grasp_quality import static_quality, with_quality
        from fungrasp.grasps import load_human_grasps, load_objects, mirrored_grasps, save_robot_grasps
        from fungrasp.hands import load_hand
        from fungrasp.hands.collisions import self_contact_words
        from fungrasp.retargeting import retarget

        hand, method, cluster = load_hand(self.spec.hand), self.spec.method, self.cluster
        human = load_human_grasps(self.grasps)
        if self.mirror:
            human = mirrored_grasps(human)
        objects = load_objects(human, self.objects)
        with PartStore.beside(self.out) as store:
            start = perf_counter()
            with progress_bar(f"retargeting to {hand.name} ({method})", 1.0) as show:
                how = {"threads": self.threads, "store": store, "ray": cluster, "progress": show}
                robot = retarget(human, objects, hand, method, self.spec.settings, **how)
            rate = len(human) / (perf_counter() - start)
            quality = static_quality(robot, human, objects, hand, exact=self.exact)
            save_robot_grasps(self.out, with_quality(robot, quality))
        print_use(cluster)
        touching = self_contact_words(hand.model, robot.joint_positions)
        for words in touching:
            logging.getLogger(__name__).warning(words)
        numbers = {"grasps_per_second": rate, "self_penetration_reasons": touching}
        summary = finite(quality.summary()) | numbers
        if self.quality is not None:
            write_json(self.quality, summary)
        if self.picture is not None:
            from fungrasp.media.pictures import draw_grasps

            with progress_bar("drawing", 1.0) as show:
                draw_grasps(self.picture, robot, objects, human, progress=show)
        lines = [
            quality.table(),
            f"{self.out}: {len(robot)} grasps of {len(objects)} objects, {rate:,.1f} grasps/s",
            suggestion("evaluate --grasps", self.out, option("--objects", self.objects)),
        ]
        value = {"grasps": self.out, "count": len(robot), "objects": len(objects), "quality": summary}
        return CommandResult(value, "\n".join(lines))


COMMAND = Retarget
