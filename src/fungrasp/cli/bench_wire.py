"""``fungrasp bench wire``: the whole chain over the wire, again and again."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.console import table
from fungrasp.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.evaluation.wire_test import WireRun


@dataclass(frozen=True)
class BenchWire:
    """Deploy a grasp on emulated devices in another process, each time on another twin, on the clock of the
    wall; count lifts and late ticks."""

    robot: str = "ur5e-allegro-emulated"
    """A cell whose addresses are on the loopback."""
    grasp: str = "wine_glass"
    """Which grasp: an object ("mug"), object and task ("mug:drink") or a row number."""
    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    image: str | None = None
    """Take the grasp from an image with depth instead: a folder with rgb.png, depth.png and K.json."""
    mesh: str | None = None
    """The object in that image: a mesh file [m], or the name of a built-in object."""
    mass: float | None = None
    """Mass of that object [kg]; a built-in one has its own."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference", "student", or a policy file."""
    runs: int = 20
    """Deployments; the first is on twin 0, the next on twin 1, and so on."""
    threads: int = 0
    """Of planning; 0 means all processors."""
    json: Path | None = None
    """Write every run here (.json, with a .csv beside), anew after each."""

    def run(self) -> None:
        from fungrasp.cli.deploy import Deploy
        from fungrasp.deployment.wired_deployment import DeploymentTask
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.evaluation.wire_test import run_over_the_wire
        from fungrasp.hands import load_hand
        from fungrasp.policies import make_planner, make_policy
        from fungrasp.provenance import run_record
        from fungrasp.robots.cell import load_cell
        from fungrasp.task import Policy

        if self.runs < 1:
            raise FungraspError(f"--runs must be 1 or more, not {self.runs}")
        cell = load_cell(self.robot)
        hand = load_hand(cell.hand)
        chosen = Deploy(
            grasp=self.grasp,
            grasps=self.grasps,
            objects=self.objects,
            image=self.image,
            mesh=self.mesh,
            mass=self.mass,
            threads=self.threads,
        )
        grasp, thing = chosen.chosen_grasp(hand)
        objects = {thing.name: thing}
        policy = make_policy(self.policy, hand, objects)
        if not isinstance(policy, Policy):
            raise FungraspError(f"the policy '{self.policy}' needs what only a simulation knows")
        planner = make_planner(self.policy, hand, objects, threads=self.threads)
        header = {"robot": self.robot, "policy": self.policy, "image": self.image is not None}
        runs = []
        for twin in range(self.runs):
            task = DeploymentTask(cell, hand, thing, grasp, policy, planner, seed=twin)
            runs.append(run_over_the_wire(task, twin))
            if self.json is not None:
                write_result(self.json, {**header, **run_record(0)}, [asdict(run) for run in runs])
            print(_line(runs[-1]), flush=True)
        print(_histogram(runs))
        lifted = sum(run.success for run in runs)
        home = sum(run.success and not run.fault for run in runs)
        print(f"of {len(runs)} runs: {lifted} lifted and held, {home} of them put down and home again")


def _line(run: WireRun) -> str:
    cores = ", ".join(f"{name} {share:.0%}" for name, share in run.cores.items())
    silence = " / ".join(f"{value:.0f}" for value in run.longest_silence_ms.values())
    outcome = f"{'' if run.success else 'not '}lifted, {100 * run.height_m:.1f} cm"
    ticks = f"latest tick {run.latest_10hz_ms:.1f} ms at 10 Hz, {run.latest_50hz_ms:.1f} ms at 50 Hz"
    return (
        f"twin {run.twin}: {outcome}{', then: ' * bool(run.fault)}{run.fault}; {ticks}; silent for "
        f"{silence} ms; the twin lost {run.twin_lost_ms:.0f} ms; of a core: {cores}; {run.seconds:.0f} s"
    )


def _histogram(runs: list[WireRun]) -> str:
    rows = [("lateness", "10 Hz", "50 Hz")]
    for name in runs[0].ticks_10hz:
        slow = sum(run.ticks_10hz[name] for run in runs)
        fast = sum(run.ticks_50hz[name] for run in runs)
        rows.append((name, str(slow), str(fast)))
    return table(rows)
