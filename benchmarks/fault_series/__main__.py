"""``python -m benchmarks.fault_series``: faults of all kinds in every phase of deployments, drawn by seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.command import check_positive, main
from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.spec import GraspChoice

if TYPE_CHECKING:
    from benchmarks.fault_series.moments import Scene
    from benchmarks.fault_series.trial import Drawn, FaultTrial

ATTEMPTS = 10
"""Deployments over the wire that are begun for a fault until it comes: a busy machine's pauses end some of
them before."""
MOST_TWINS = 20
"""Twins that are tried at most."""


@dataclass(frozen=True)
class BenchFaultSeries:
    """Deploy again and again on twins, bring a fault that is drawn by seed, and judge: the arm at rest within
    its distance, the object still held, the reason that of the fault."""

    robot: str = "ur5e-allegro-emulated"
    """A cell whose addresses are on the loopback."""
    choice: GraspChoice = field(default_factory=lambda: GraspChoice(grasp="wine_glass", threads=1))
    """The grasp."""
    faults: int = 100
    """Deployments with a fault each."""
    twins: int = 5
    """Twins that they are made on, in turn: the first on which the grasp succeeds without a fault."""
    kinds: tuple[str, ...] = ()
    """Kinds of faults, as the table names them ("kill -9"); all that this hand may meet by default."""
    patience: float = 1.0
    """Over the wire: times the usual limits of silence. A machine with other work needs more."""
    seed: int = 0
    """Decides which fault comes when."""
    json: Path | None = None
    """Write every deployment here (.json, with a .csv beside), anew after each; a stopped run goes on."""

    def run(self) -> None:
        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation.result_files import write_result

        check_positive(faults=self.faults, twins=self.twins)
        scenes = self._scenes()
        drawn = drawn_faults(scenes[0].cell.hand, self.faults, self.seed, self.kinds)
        asked = {"robot": self.robot, "grasp": self.choice.words, "patience": self.patience}
        asked |= {"twins": self.twins, "kinds": ", ".join(self.kinds)}
        trials = self._known(asked)
        done = {trial.number for trial in trials}
        for one in (fault for fault in drawn if fault.number not in done):
            trials.append(self._trial(scenes[one.number % len(scenes)], one))
            if self.json is not None:
                write_result(self.json, {**asked, **run_record(self.seed)}, [asdict(t) for t in trials])
            print(_line(trials[-1]), flush=True)
        print(table(list(series_rows([asdict(t) for t in trials]))))
        good = sum(t.success for t in trials)
        print(f"{good} of {len(trials)} as they should be; {machine()}")

    def _known(self, asked: dict[str, object]) -> list[FaultTrial]:
        """What a stopped run has done already."""
        from benchmarks.fault_series.trial import FaultTrial
        from fungrasp.evaluation.result_files import read_result

        if self.json is None or not self.json.exists():
            return []
        result = read_result(self.json)
        if any(result.header.get(key) != value for key, value in {**asked, "seed": self.seed}.items()):
            raise FungraspError(f"{self.json} holds another series: give another name, or delete it")
        return [FaultTrial(**row) for row in result.rows]

    def _scenes(self) -> list[Scene]:
        from itertools import islice

        from benchmarks.fault_series.moments import scene
        from fungrasp.deployment.preparation import reachable_placements
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell

        cell = load_cell(self.robot)
        hand = load_hand(cell.hand)
        grasp, objects = self.choice.robot(hand)
        obj = objects[str(grasp.object_name[0])]
        placement = next(reachable_placements(cell, hand, obj, grasp))
        tried = (scene(cell, hand, obj, grasp, placement, twin) for twin in range(MOST_TWINS))
        found = list(islice((one for one in tried if one is not None), self.twins))
        if not found:
            raise FungraspError(f"on {MOST_TWINS} twins of '{self.robot}' the grasp fails without a fault")
        return found

    def _trial(self, scene: Scene, drawn: Drawn) -> FaultTrial:
        from benchmarks.fault_series.trial import Place, no_fault_came
        from benchmarks.fault_series.twin_trial import twin_trial
        from benchmarks.fault_series.wire_trial import FalseAlarm, wire_trial

        if drawn.kind.place is Place.TWIN:
            return twin_trial(scene, drawn)
        said: list[str] = []
        for _ in range(ATTEMPTS):
            try:
                return replace(wire_trial(scene, drawn, self.patience), false_alarms="; ".join(said))
            except FalseAlarm as alarm:
                said.append(str(alarm))
        return no_fault_came(scene, drawn, "; ".join(said))


def drawn_faults(hand: str, count: int, seed: int, kinds: Sequence[str] = ()) -> list[Drawn]:
    """Faults and their moments: the moment first, then a kind that may come then.

    Args:
        seed: of what is drawn; the first faults of a longer series are those of a shorter one.
        kinds: names of kinds; all if empty.

    Raises:
        UnknownNameError: no such kind with this hand.
    """
    import numpy as np

    from benchmarks.fault_series.moments import EDGE, Moment
    from benchmarks.fault_series.trial import KINDS, Drawn
    from fungrasp.core.errors import UnknownNameError

    known = {kind.name: kind for kind in KINDS if hand in kind.hands}
    for name in kinds:
        if name not in known:
            raise UnknownNameError("kind of fault", name, known)
    chosen = [kind for kind in known.values() if not kinds or kind.name in kinds]
    moments = [moment for moment in Moment if any(moment in kind.moments for kind in chosen)]
    rng = np.random.default_rng(seed)
    drawn = []
    for number in range(count):
        moment = moments[rng.integers(len(moments))]
        able = [kind for kind in chosen if moment in kind.moments]
        kind = able[rng.integers(len(able))]
        drawn.append(Drawn(number, moment, rng.uniform(EDGE, 1.0 - EDGE), kind, rng.uniform()))
    return drawn


def _line(trial: FaultTrial) -> str:
    wrong = "" if trial.success else "NOT AS IT SHOULD BE: "
    what = f"{trial.number}: {trial.fault} in {trial.moment} ({trial.place}, twin {trial.twin})"
    far = "" if trial.carried else f", {100 * trial.distance_m:.1f} of {100 * trial.limit_m:.1f} cm"
    held = f", held: {trial.held_after}" if trial.held_before and not trial.carried else ""
    return f"{wrong}{what}: {trial.reason or 'no reason said'}{far}{held}"


def series_rows(trials: list[dict]) -> Iterator[tuple[str, ...]]:
    """Table of trials by kind of fault, with its head.

    Args:
        trials: rows of ``FaultTrial``.
    """
    yield (
        "fault",
        "brought",
        "faults",
        "as it should be",
        "went on",
        "named",
        "at rest",
        "farthest / limit [cm]",
        "still held",
        "opened",
    )
    for name in dict.fromkeys(t["fault"] for t in trials):
        group = [t for t in trials if t["fault"] == name]
        stopped = [t for t in group if not t["carried"]]
        held = [t for t in stopped if t["held_before"]]
        far = max((t["distance_m"] for t in stopped), default=0.0)
        yield (
            name,
            {"twin": "on the twin", "wire": "over the wire"}[group[0]["place"]],
            str(len(group)),
            str(sum(t["success"] for t in group)),
            str(len(group) - len(stopped)),
            f"{sum(t['named'] for t in stopped)} of {len(stopped)}",
            f"{sum(t['at_rest'] for t in stopped)} of {len(stopped)}",
            f"{100 * far:.1f} / {100 * group[0]['limit_m']:.1f}" if stopped else "—",
            f"{sum(t['held_after'] for t in held)} of {len(held)}{' *' * any(t['lets_go'] for t in held)}"
            if held
            else "—",
            f"{sum(t['opened'] for t in stopped)} of {len(stopped)}",
        )


COMMAND = BenchFaultSeries


if __name__ == "__main__":
    main("fault_series", COMMAND)
