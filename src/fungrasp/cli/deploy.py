"""``fungrasp deploy``: one grasp on a robot, or on its twin."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fungrasp.deployment.grasp_choice import GraspChoice


@dataclass(frozen=True)
class Deploy:
    """Grasp an object with a robot: look, plan, move to the start, grasp, lift, hold, put down, go home."""

    robot: str = "ur5e-allegro"
    """A robot cell: one that comes with the package (`fungrasp robots list`), or a TOML file."""
    hand: str = ""
    """The hand that you expect on the robot; another one is refused. Empty: whatever the cell says."""
    choice: GraspChoice = field(default_factory=GraspChoice)
    """The grasp."""
    policy: str = "plan"
    """What moves the hand: "plan", "reference" (planned motions, open loop), "student", or a policy file."""
    hand_dynamics: Path | None = None
    """Identified dynamics of the hand (`fungrasp identify fit`); by default those that the cell names."""
    dry_run: bool = False
    """Read everything, decide everything, log everything, and send nothing."""
    no_gravity_compensation: bool = False
    """Let the hand sag under its own weight."""
    stay: bool = False
    """End after the hold, with the object held: it is not put down."""
    attempts: int = 1
    """Most attempts. A policy that watches (a student) sees that the object is not held: the hand withdraws,
    looks where the object lies, plans anew and tries again."""
    log: Path | None = None
    """MCAP file to write; it must not exist. By default deploy-<time>.mcap."""
    seed: int = 0
    """Seed of the plan."""
    twin: int = 0
    """For a twin: which one, 0, 1, 2 ... Its true parameters are hidden."""
    fast: bool = False
    """For a twin: run as fast as the machine goes, not on the clock of the wall."""

    def run(self) -> None:
        from time import strftime

        from fungrasp.deployment.deploy import deploy
        from fungrasp.deployment.deployment_result import DeploymentSpec
        from fungrasp.errors import FungraspError
        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import load_cell
        from fungrasp.robots.stop_switch import StopSwitch

        cell = load_cell(self.robot)
        hand = load_hand(cell.hand)
        if self.hand and load_hand(self.hand).name != hand.name:
            raise FungraspError(f"robot cell '{cell.name}' carries the hand '{hand.name}', not '{self.hand}'")
        spec = DeploymentSpec(
            self.robot,
            self.policy,
            attempts=self.attempts,
            put_down=not self.stay,
            dry_run=self.dry_run,
            gravity_compensation=not self.no_gravity_compensation,
            hand_dynamics=str(self.hand_dynamics or ""),
            seed=self.seed,
            twin=self.twin,
            real_time=not self.fast,
        )
        grasp, objects = self.choice.robot(hand, self.seed)
        log = self.log or Path(strftime("deploy-%Y%m%d-%H%M%S.mcap"))
        with StopSwitch(cell.stop_file, keyboard=True) as switch:
            result = deploy(
                grasp,
                objects,
                spec=spec,
                log=log,
                about={"grasp": self.choice.words},
                switch=switch,
                threads=self.choice.threads,
                on_phase=lambda phase: print(phase, flush=True),
                on_connect=lambda: print(f"to stop: {switch.ways or 'Ctrl-C'}", flush=True),
            )
        print(f"10 Hz: {result.ticks.summary()}")
        print(f"50 Hz: {result.setpoints.summary()}")
        print(f"log: {log}")
        if result.fault:
            raise FungraspError(result.words())
        print(result.words())


COMMAND = Deploy
