"""``fungrasp robots evaluate``: grasps on twins, for Table VI of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from fungrasp.evaluation.twin_episode import TwinEpisode, TwinVariant
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.jobs import PartStore
    from fungrasp.objects import ObjectModel
    from fungrasp.robots.twin.parameters import TwinParameters


@dataclass(frozen=True)
class EvaluateOnTwins:
    """Try grasps on twins, without a clock: what identification and gravity compensation are worth."""

    out: Path
    """Result to write, .json; it is written anew after every episode. What is finished is kept in the folder
    OUT.partial until all is done: the same command goes on where it was stopped."""
    robot: str = "ur5e-allegro"
    """A cell that is a twin."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    rows: tuple[int, ...] = ()
    """Rows of the grasps; all if none are given."""
    each: int | None = None
    """Of each object the first so many grasps that the arm can reach; all if not given."""
    images: int = 0
    """Try what perception sees in so many rendered images of each grasp in place of the grasp itself (Table
    II of the paper). Rows of the result are then numbered row times images plus image."""
    image_seed: int = 0
    """Of the images."""
    twins: tuple[int, ...] = (0, 1, 2)
    """Which twins."""
    in_turn: bool = False
    """Each grasp on one of the twins, in turn, in place of all."""
    places: int = 1
    """Places of the object in which each grasp is tried."""
    variants: tuple[str, ...] = ("no identification", "no gravity compensation", "ours")
    """Ways to deploy: "no identification", "no gravity compensation", "ours", "ours, two attempts" (of a
    student)."""
    policy: str = "plan"
    """What acts."""
    told: bool = False
    """Tell the dynamics of the twins' hands in place of identifying them: what identification could give."""
    threads: int = 0
    """Of planning; 0 means all processors."""

    def run(self) -> None:
        from fungrasp.deployment.deploy import deployable_policy, robot_planner
        from fungrasp.deployment.hand_knowledge import HandDynamics
        from fungrasp.deployment.twin_identification import identify_on_twin
        from fungrasp.errors import FungraspError
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.evaluation.twin_episode import PlacedGrasp, TwinSetup
        from fungrasp.evaluation.twin_series import episode_rows, placed_grasps, told_dynamics, try_on_twins
        from fungrasp.files import digest
        from fungrasp.grasps import load_human_grasps, load_objects
        from fungrasp.hands import load_hand
        from fungrasp.jobs import PartStore
        from fungrasp.policies import policy_files
        from fungrasp.provenance import run_record
        from fungrasp.retargeting import retarget
        from fungrasp.robots.cell import load_cell
        from fungrasp.robots.torque_limits import limited_hand

        variants = self._variants()
        cell = load_cell(self.robot)
        hand = load_hand(cell.hand)
        human = load_human_grasps(self.grasps)
        index = list(self.rows) or list(range(len(human)))
        human = human.select(index)
        objects = load_objects(human, self.objects)
        store = PartStore.beside(self.out)
        header: dict[str, Any] = {"robot": self.robot, "policy": self.policy, "grasps": self.grasps}
        if self.images:
            human, index, header["not_seen"] = self._seen(human, index, objects, store)
            header["images"] = len(index) + len(header["not_seen"])
        robot = retarget(human, objects, hand, threads=self.threads)
        policy = deployable_policy(self.policy, hand, objects)
        planner = robot_planner(self.policy, limited_hand(cell, hand), objects, self.threads)
        header |= run_record(0)
        header["identification"] = "told" if self.told else "identified on each twin"
        files = policy_files("student" if self.policy == "plan" else self.policy, hand.name)
        setup = TwinSetup(
            objects,
            hand,
            cell,
            policy,
            planner,
            store=store,
            policy_key=digest(self.policy, files.digests(), getattr(planner, "key", "")),
            places=self.places,
        )
        placed: list[PlacedGrasp] = []
        thing = objects[human.object_name[0]]

        def watched() -> Iterator[PlacedGrasp]:
            for one in placed_grasps(setup, robot, index, self.each):
                placed.append(one)
                yield one

        def numbers(*, within_reach: bool) -> list[int]:
            """Of the grasps that were looked at, in order."""
            return sorted({one.number for one in placed if bool(len(one.placements)) is within_reach})

        def identify(truth: TwinParameters) -> HandDynamics:
            def fit() -> HandDynamics:
                return HandDynamics.of(hand, identify_on_twin(cell, hand, thing, truth).found.dynamics)

            return setup.identified(truth, fit)

        episodes: list[TwinEpisode] = []
        for episode in try_on_twins(
            setup,
            watched(),
            self.twins,
            variants,
            in_turn=self.in_turn,
            identify=told_dynamics(hand) if self.told else identify,
        ):
            episodes.append(episode)
            header["out_of_reach"] = " ".join(map(str, numbers(within_reach=False)))
            header["grasps_that_can_be_reached"] = len(numbers(within_reach=True))
            write_result(self.out, header, episode_rows(episodes))
        if not episodes:
            raise FungraspError(
                "the arm reaches none of these grasps: take others with --rows, or another --robot"
            )
        store.remove()
        self._show(episodes)
        if self.images:
            print(
                f"{header['images']} images: {len(header['not_seen'])} refused; of the others "
                f"{len(numbers(within_reach=False))} were found out of reach, "
                f"{len(numbers(within_reach=True))} tried"
            )

    def _variants(self) -> list[TwinVariant]:
        """The ways to deploy by their names."""
        from fungrasp.errors import UnknownNameError
        from fungrasp.evaluation.twin_series import VARIANTS

        known = {variant.name: variant for variant in VARIANTS}
        for name in self.variants:
            if name not in known:
                raise UnknownNameError("variant", name, known)
        return [known[name] for name in self.variants]

    def _seen(
        self,
        human: HumanGraspSet,
        index: list[int],
        objects: Mapping[str, ObjectModel],
        store: PartStore,
    ) -> tuple[HumanGraspSet, list[int], dict[str, str]]:
        """What perception sees of grasps: the grasps, the number of the image of each, and why it does not
        trust the others, by number."""
        from fungrasp.cli.console import progress_bar
        from fungrasp.errors import FungraspError
        from fungrasp.synthetic_captures.perceived_grasps import grasps_from_images

        def number(n: int) -> int:
            return index[n // self.images] * self.images + n % self.images

        with progress_bar("perceiving", 1.0) as show:
            seen = grasps_from_images(human, objects, self.images, self.image_seed, store, show)
        if seen.human is None:
            raise FungraspError("perception is confident of no image: nothing to try")
        refused = {str(number(n)): why for n, why in seen.refused.items()}
        return seen.human, [number(n) for n in seen.index], refused

    def _show(self, episodes: list[TwinEpisode]) -> None:
        """Print a table."""
        import numpy as np

        from fungrasp.cli.console import table
        from fungrasp.evaluation.statistics import wilson_interval

        lines = [("variant", "episodes", "begun", "lifted", "95 % interval", "tracking [rad]", "sag [deg]")]
        for name in self.variants:
            mine = [e for e in episodes if e.variant == name]
            moved = [e for e in mine if e.tracking_rad >= 0]
            if moved:
                held = sum(e.success for e in mine)
                low, high = wilson_interval(held, len(mine))
                lines.append(
                    (
                        name,
                        str(len(mine)),
                        str(len(moved)),
                        f"{held / len(mine):.0%}",
                        f"{low:.0%} to {high:.0%}",
                        f"{np.median([e.tracking_rad for e in moved]):.3f}",
                        f"{np.rad2deg(np.median([e.sag_rad for e in moved])):.1f}",
                    )
                )
        print(table(lines, left=None))
