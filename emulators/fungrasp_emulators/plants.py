"""Joints of nothing behind emulated devices: servos that lag, motors with inertia."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

from fungrasp_emulators.emulator import PlantCommand, PlantState


@dataclass
class ServoPlant:
    """Position servos without mass: a goal is taken after a delay and approached by a first-order lag and a
    speed limit. Without power the joints stay where they are."""

    positions: np.ndarray
    """Where the joints are [rad], shape [U]."""
    time_constant: float = 0.02
    """Of the lag [s]; 0: no lag."""
    velocity: float = 3.0
    """Highest speed where the command says none [rad/s]."""
    delay: float = 0.0
    """From a command to its first effect [s]."""
    _now: float | None = None
    _goal: PlantCommand = field(default_factory=PlantCommand)
    _pending: list[tuple[float, PlantCommand]] = field(default_factory=list)
    _velocities: np.ndarray = field(init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def __post_init__(self) -> None:
        self.positions = np.array(self.positions, dtype=float)
        self._velocities = np.zeros_like(self.positions)

    def apply(self, command: PlantCommand, now: float) -> None:
        with self._lock:
            self._pending.append((now + self.delay, command))

    def state(self, now: float) -> PlantState:
        with self._lock:
            while self._pending and self._pending[0][0] <= now:
                at, command = self._pending.pop(0)
                self._advance(at)
                self._goal = command
            self._advance(now)
            return PlantState(self.positions.copy(), self._velocities.copy(), np.zeros_like(self.positions))

    def _advance(self, now: float) -> None:
        elapsed = 0.0 if self._now is None else now - self._now
        self._now = now if self._now is None else max(now, self._now)
        if elapsed <= 0:
            return
        if self._goal.positions is None:
            self._velocities = np.zeros_like(self.positions)
            return
        share = 1.0 if self.time_constant == 0 else 1.0 - np.exp(-elapsed / self.time_constant)
        limit = self.velocity if self._goal.velocity_limits is None else self._goal.velocity_limits
        move = np.clip(share * (self._goal.positions - self.positions), -limit * elapsed, limit * elapsed)
        self.positions = self.positions + move
        self._velocities = move / elapsed


@dataclass
class TorquePlant:
    """Joints with inertia, damping, Coulomb friction and a constant load, driven by torques:

    inertia a = torque - damping v - friction sign(v) - load
    """

    positions: np.ndarray
    """Where the joints are [rad], shape [U]."""
    inertia: float = 0.002
    """[kg m^2]."""
    damping: float = 0.05
    """[N m s/rad]."""
    friction: float = 0.0
    """[N m]."""
    load: np.ndarray | float = 0.0
    """Torque against the motors, as of weight [N m], shape [U] or []."""
    lower: np.ndarray | float = -np.inf
    """Stops [rad], shape [U] or []."""
    upper: np.ndarray | float = np.inf
    """Stops [rad], shape [U] or []."""
    largest_step: float = 1e-3
    """Of the integration [s]."""
    _now: float | None = None
    _torques: np.ndarray = field(init=False)
    _velocities: np.ndarray = field(init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def __post_init__(self) -> None:
        self.positions = np.array(self.positions, dtype=float)
        self._velocities = np.zeros_like(self.positions)
        self._torques = np.zeros_like(self.positions)

    def apply(self, command: PlantCommand, now: float) -> None:
        with self._lock:
            self.state(now)
            none = np.zeros_like(self.positions)
            self._torques = none if command.torques is None else np.array(command.torques, dtype=float)

    def state(self, now: float) -> PlantState:
        with self._lock:
            self._now = now if self._now is None else self._now
            elapsed = now - self._now
            if elapsed > 0:
                # A host that slept does not owe more than a second of motion.
                steps = int(np.ceil(min(elapsed, 1.0) / self.largest_step))
                for _ in range(steps):
                    self._step(min(elapsed, 1.0) / steps)
                self._now = now
            return PlantState(self.positions.copy(), self._velocities.copy(), self._torques.copy())

    def _step(self, dt: float) -> None:
        # Damping implicitly; friction stops a joint but never reverses it.
        push = self._velocities + dt / self.inertia * (self._torques - self.load)
        slowed = np.sign(push) * np.maximum(np.abs(push) - dt / self.inertia * self.friction, 0.0)
        velocities = slowed / (1.0 + dt / self.inertia * self.damping)
        positions = self.positions + dt * velocities
        inside = (positions >= self.lower) & (positions <= self.upper)
        self._velocities = np.where(inside, velocities, 0.0)
        self.positions = np.clip(positions, self.lower, self.upper)
