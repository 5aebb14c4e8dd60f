"""``fungrasp identify``: identify the joint dynamics of a real hand."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fungrasp.cli.console import Answering, CommandResult, table
from fungrasp.cli.options import CellName, ask_before_motion
from fungrasp.core.errors import FungraspError
from fungrasp.sim2real.identification.excitation import Excitation
from fungrasp.sim2real.identification.fit import FitSettings

if TYPE_CHECKING:
    from fungrasp.hands import Hand
    from fungrasp.sim2real.identification.fit import IdentifiedDynamics
    from fungrasp.sim2real.identification.motion_log import MotionLog

HELD_OUT = 0.5
"""Share of a log, at its end, for testing."""


@dataclass(frozen=True)
class Collect(Answering):
    """Move the hand's joints around their current position, one finger after the other, and record them. The
    arm may be off.

    Nothing may touch the hand; keep the palm still and your own hand on the emergency stop. The stop file of
    the cell, Enter or Ctrl-C stops the hand. A stopped recording can still be fitted.
    """

    log: Annotated[Path, tyro.conf.Positional]
    """Log to write (.jsonl); must not exist."""
    cell: CellName
    """A built-in robot cell, or a TOML file."""
    excitation: Excitation = field(default_factory=Excitation)
    """Settings of the motion."""
    torque_share: float = 0.5
    """Torque limit, as a share of the cell's limit."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Gravity in the palm frame [m/s^2]; with zero, the fit ignores weight."""
    weight: float = 0.0
    """Mass attached to each fingertip [kg]. If the fingers are light compared to their drives, 0.2 kg in one
    of several logs determines the scale of the dynamics."""
    yes: bool = False
    """Do not ask before a real hand moves."""
    option_prefixes = True

    def run(self) -> CommandResult:
        import sys

        import numpy as np

        from fungrasp.hands import load_hand
        from fungrasp.robots.cell import is_wired, load_cell
        from fungrasp.robots.single_devices import guarded_driver, record_motion
        from fungrasp.robots.stop_switch import StopSwitch
        from fungrasp.sim2real.identification.excitation import ExcitationLimits, safe_motion
        from fungrasp.sim2real.identification.motion_log import MotionLogWriter

        cell = load_cell(self.cell)
        hand = load_hand(cell.hand)
        joints, gravity = tuple(hand.actuators), np.array(self.gravity)
        with MotionLogWriter(self.log) as writer:
            try:
                with (
                    StopSwitch(cell.stop_file, keyboard=True) as switch,
                    guarded_driver("hand", cell, hand, switch, self.torque_share) as driver,
                ):
                    rest, limits = driver.read().positions, driver.limits
                    speed = np.minimum(limits.velocity, cell.limits.hand_speed)
                    room = ExcitationLimits(limits.lower, limits.upper, speed, limits.torque)
                    motion = safe_motion(self.excitation, hand, rest, room, gravity)
                    seconds = len(motion.commands) / self.excitation.rate
                    if is_wired(cell) and not self.yes:
                        ask_before_motion(
                            switch, f"move the fingers, one after the other, for {seconds:.0f} s"
                        )
                    print(f"{seconds:.0f} s; to stop: {switch.ways or 'Ctrl-C'}", file=sys.stderr, flush=True)
                    log = record_motion(
                        driver,
                        joints,
                        motion,
                        self.excitation.rate,
                        gravity,
                        weight=self.weight,
                        keep=writer.add,
                    )
            except (FungraspError, KeyboardInterrupt):
                if writer.rows:
                    said = driver.lets_go and f"; the hand lets go {driver.lets_go}"
                    print(f"stopped: {writer.rows} rows are in {self.log}{said}", file=sys.stderr)
                raise
        text = f"{len(log.times)} rows, {log.times[-1]:.1f} s, {len(joints)} joints -> {self.log}"
        return CommandResult({"log": self.log, "rows": len(log.times), "joints": joints}, text)


@dataclass(frozen=True)
class Fit(Answering):
    """Fit stiffness, damping, friction, armature and delay to one half of a log; test on the other half."""

    log: Annotated[Path, tyro.conf.Positional]
    """Log of `identify collect` (.jsonl), or a step response of an Inspire hand (.csv)."""
    hand: str = "allegro"
    """Name of a hand, or the path of its TOML file."""
    out: Path | None = None
    """File to write (.toml)."""
    others: tuple[Path, ...] = ()
    """More logs of the same joints, recorded with other palm orientations or with weights on the
    fingertips."""
    joint: str = "index_proximal_joint"
    """Joint of a .csv log."""
    settings: Annotated[FitSettings, tyro.conf.arg(name="")] = field(default_factory=FitSettings)
    """Settings of the fit."""

    def run(self) -> CommandResult:
        import numpy as np

        from fungrasp.hands import load_hand
        from fungrasp.sim2real.identification.fit import fit_dynamics
        from fungrasp.sim2real.identification.motion_log import load_motion_log, read_step_csv
        from fungrasp.sim2real.joint_dynamics import QUANTITIES, save_dynamics

        hand = load_hand(self.hand)
        step = self.log.suffix == ".csv"
        if step:
            if self.joint not in hand.actuators:
                raise FungraspError(f"hand '{hand.name}' has no actuated joint '{self.joint}'; give --joint")
            low, high = hand.joint_limits[hand.joint_names.index(self.joint)]
            log = read_step_csv(self.log, self.joint, float(low), float(high))
        else:
            log = load_motion_log(self.log)
        # A single step cannot be split in halves: every other row is held out instead.
        logs = [log, *(load_motion_log(path) for path in self.others)]
        if not step:
            logs = self._excited(logs)
        fitted = [one.part(0, 1 - HELD_OUT) for one in logs]
        if step:
            fitted[0] = log.rows(np.r_[0 : len(log.times) : 2])
        found = fit_dynamics(hand, fitted, self.settings)
        if self.out is not None:
            save_dynamics(self.out, found.dynamics, self._notes(found))
        rows: list[tuple[str, ...]] = [("joint", *QUANTITIES)]
        for j, joint in enumerate(found.dynamics.joints):
            rows.append((joint, *(self._value(found, quantity, j) for quantity in QUANTITIES)))
        lines = [table(rows), f"delay {1e3 * found.dynamics.delay:.1f} ms"]
        fit = {
            "method": "gauss-newton",
            "rms": found.rms,
            "held_out_rms": self._held_out(hand, logs, found, step),
            "simulations": found.simulations,
            "seconds": found.seconds,
        }
        lines.append(
            f"RMS {fit['rms']:.4f} rad where fitted, {fit['held_out_rms']:.4f} rad where held out; "
            f"{found.simulations} simulations, {found.seconds:.1f} s"
        )
        vague = sum(int((~known).sum()) for known in found.identified.values())
        if vague:
            lines.append(
                f"{vague} quantities are not identifiable from this log (standard deviation above "
                f"{self.settings.bound:.0%}) and keep the model's values. Logs with other palm orientations, "
                "or with weights on the fingertips, may help"
            )
        fixed = self.settings.fixed
        joints = {
            joint: {
                name: {
                    "value": getattr(found.dynamics, name)[j],
                    "identified": name not in fixed and found.identified[name][j],
                    "relative_error": None if name in fixed else found.relative_error[name][j],
                }
                for name in QUANTITIES
            }
            for j, joint in enumerate(found.dynamics.joints)
        }
        value = {"dynamics": self.out, "delay": found.dynamics.delay, "joints": joints, "methods": [fit]}
        return CommandResult(value, "\n".join(lines))

    def _held_out(self, hand: Hand, logs: list[MotionLog], found: IdentifiedDynamics, step: bool) -> float:
        import numpy as np

        from fungrasp.sim2real.identification.log_simulation import prediction_rms, simulate_log

        if not step:
            return prediction_rms(hand, logs, found.dynamics, found.errors, 1 - HELD_OUT)
        error = simulate_log(hand, logs[0], [found.dynamics], errors=[found.errors])[0] - logs[0].positions
        return float(np.sqrt(np.mean(error[1::2] ** 2)))

    def _excited(self, logs: list[MotionLog]) -> list[MotionLog]:
        """Return the logs with only the joints that move in all of them."""
        some = [log.excited() for log in logs]
        common = [name for name in some[0].joints if all(name in log.joints for log in some)]
        missing = [name for name in logs[0].joints if name not in common]
        if missing:
            logging.getLogger(__name__).warning("hardly moved, not fitted: %s", ", ".join(missing))
        return [log.of_joints(common) for log in some]

    def _value(self, found: IdentifiedDynamics, quantity: str, joint: int) -> str:
        value = getattr(found.dynamics, quantity)[joint]
        if quantity in self.settings.fixed:
            return f"{value:.4g} (fixed)"
        if not found.identified[quantity][joint]:
            return f"{value:.4g} (model's: not identifiable)"
        return f"{value:.4g} ± {found.relative_error[quantity][joint]:.0%}"

    def _notes(self, found: IdentifiedDynamics) -> dict[str, list[str]]:
        """Return comments for the values in the file."""
        notes: dict[str, list[str]] = {}
        for name, known in found.identified.items():
            deviation = found.relative_error[name]
            notes[name] = [
                f"+- {own:.0%}" if told else "not identifiable from the log: the model's value"
                for told, own in zip(known, deviation, strict=True)
            ]
        return notes


COMMAND = {"collect": Collect, "fit": Fit}
