"""``python -m benchmarks.wire``: the whole chain over the wire, again and again."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment_task import deployment_task
from fungrasp.deployment.spec import DeploymentSpec, GraspChoice

if TYPE_CHECKING:
    from benchmarks.wire.timed_grasp import TimedGrasp
    from benchmarks.wire.wire_run import WireRun
    from fungrasp.evaluation.result_files import Row


@dataclass(frozen=True)
class BenchWire:
    """Deploy a grasp on emulated devices in another process, each time on another twin, on the clock of the
    wall; count lifts and late ticks."""

    robot: str = "ur5e-allegro-emulated"
    """A cell whose addresses are on the loopback."""
    choice: GraspChoice = field(default_factory=lambda: GraspChoice(grasp="wine_glass"))
    """The grasp."""
    rendered: bool = False
    """Take what perception sees in an image of the grasp, another one that is rendered for each run."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference", "student", or a policy file."""
    attempts: int = 1
    """Most attempts of a policy that watches (a student)."""
    runs: int = 20
    """Deployments; the first is on twin 0, the next on twin 1, and so on."""
    json: Path | None = None
    """Write every run here (.json, with a .csv beside), anew after each; a stopped series goes on."""

    def run(self) -> None:
        from benchmarks.wire.timed_grasp import MOST_IMAGES, rendered_grasp, timed_grasp
        from fungrasp.core.provenance import run_record
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell

        if self.runs < 1:
            raise FungraspError(f"--runs must be 1 or more, not {self.runs}")
        hand = load_hand(load_cell(self.robot).hand)
        image = "rendered" if self.rendered else self.choice.image or "none"
        header = {"robot": self.robot, "policy": self.policy, "image": image, "attempts": self.attempts}
        chosen = None if self.rendered else timed_grasp(self.choice, hand, 0)
        runs = self._known(header)
        for twin in range(len(runs), self.runs):
            grasp = chosen or rendered_grasp(self.choice, hand, twin)
            run = self._run(grasp, twin)
            while self.rendered and run.refused and grasp.images < MOST_IMAGES:
                # A person who is told that it can't be reached shows it again.
                grasp = rendered_grasp(self.choice, hand, twin, grasp.images)
                run = self._run(grasp, twin)
            if run.fault.startswith("interrupted"):
                # What it was stopped in is not kept; the same command goes on there.
                raise KeyboardInterrupt
            runs.append(run)
            if self.json is not None:
                write_result(self.json, {**header, **run_record(0)}, [asdict(run) for run in runs])
            print(_line(runs[-1]), flush=True)
        print(_histogram(runs))
        lifted = sum(run.success for run in runs)
        home = sum(run.success and not run.fault for run in runs)
        print(f"of {len(runs)} runs: {lifted} lifted and held, {home} of them put down and home again")

    def _known(self, header: dict[str, object]) -> list[WireRun]:
        """What a stopped series has done already."""
        from fungrasp.evaluation.result_files import read_result

        if self.json is None or not self.json.exists():
            return []
        result = read_result(self.json)
        if any(result.header.get(key) != value for key, value in header.items()):
            raise FungraspError(f"{self.json} holds another series: give another name, or delete it")
        return [_read_run(row) for row in result.rows]

    def _run(self, chosen: TimedGrasp, twin: int) -> WireRun:
        from benchmarks.wire.wire_run import run_over_the_wire

        spec = DeploymentSpec(self.robot, self.policy, self.attempts, seed=twin, threads=self.choice.threads)
        run = run_over_the_wire(deployment_task(chosen.robot, chosen.objects, spec), twin)
        return replace(run, images=chosen.images, grasp_seconds=chosen.seconds)


def _read_run(row: Row) -> WireRun:
    """A run as a table has it."""
    from benchmarks.wire.wire_run import WireRun

    values: dict[str, Any] = {}
    for key, value in row.items():
        name, _, part = key.partition(".")
        if not part:
            values[name] = value
        elif value is not None:
            values.setdefault(name, {})[part] = value
    # Of a run in which nothing moved these are empty.
    return WireRun(**{"longest_silence_ms": {}, "cores": {}, **values})


def _line(run: WireRun) -> str:
    cores = ", ".join(f"{name} {share:.0%}" for name, share in run.cores.items())
    silence = " / ".join(f"{value:.0f}" for value in run.longest_silence_ms.values())
    outcome = f"{'' if run.success else 'not '}lifted, {100 * run.height_m:.1f} cm"
    ticks = f"latest tick {run.latest_10hz_ms:.1f} ms at 10 Hz, {run.latest_50hz_ms:.1f} ms at 50 Hz"
    seen = f"image {run.images} seen in {run.grasp_seconds:.1f} s; " * bool(run.images)
    return (
        f"twin {run.twin}: {seen}{outcome}{', then: ' * bool(run.fault)}{run.fault}; {ticks}; silent for "
        f"{silence} ms; the twin lost {run.twin_lost_ms:.0f} ms; of a core: {cores}; {run.seconds:.0f} s"
    )


def _histogram(runs: list[WireRun]) -> str:
    rows = [("lateness", "10 Hz", "50 Hz")]
    for name in runs[0].ticks_10hz:
        slow = sum(run.ticks_10hz[name] for run in runs)
        fast = sum(run.ticks_50hz[name] for run in runs)
        rows.append((name, str(slow), str(fast)))
    return table(rows)


COMMAND = BenchWire
