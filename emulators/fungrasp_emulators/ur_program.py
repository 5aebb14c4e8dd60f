"""The program that the client library ur_rtde uploads to a UR controller, as far as it is carried out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from fungrasp_emulators.emulator import Plant, PlantCommand

COMMAND = "input_int_register_0"
READY, DONE = 1, 2
"""What the program answers."""
SERVO_TIME = "input_double_register_8"
"""Duration of ``servoj`` [s]."""
SERVO_JOINTS, SERVO_STOP, SET_WATCHDOG, TOOL_OFFSET, KICK_WATCHDOG, STOP_PROGRAM = 11, 16, 35, 40, 99, 255
"""Commands that are carried out; any other is answered and does nothing."""


class ServoProgram:
    """Reads commands from the controller's input registers and moves a plant."""

    def __init__(self, plant: Plant, tool: np.ndarray):
        """
        Args:
            tool: the tool center point on the flange, position [m] and rotation vector [rad], shape [6].
        """
        self._plant, self._tool = plant, tool
        self.outputs = np.zeros(6)
        """Its first output registers of real numbers."""
        self.running = False
        """Whether it runs."""
        self.answer = 0
        """Its output register."""
        self.goal: np.ndarray | None = None
        """Of ``servoj`` [rad], shape [6]; None where there is none."""
        self.slider = 1.0
        """Speed slider of the pendant, 0 to 1: a ``servoj`` takes as much longer."""
        self.paused = False
        """Whether its servo commands are left out, as while a guard is open."""
        self._servo_ends = 0.0
        self._executing = False
        self._registers: dict[str, Any] = {}
        self._heard, self._watchdog = 0.0, 0.0

    def start(self) -> None:
        """Start it anew."""
        self.running, self.answer, self._executing = True, READY, False
        self._watchdog = 0.0

    def stop(self) -> None:
        """End it; the joints stay where they are."""
        if self.running:
            self.running, self._watchdog = False, 0.0
            self._stop_servo()

    def pause(self) -> None:
        """The joints stay where they are until ``paused`` is false again."""
        if not self.paused:
            self.paused = True
            self._stop_servo()

    def take(self, registers: Mapping[str, Any]) -> None:
        """Input registers were written."""
        self._registers |= registers
        if COMMAND in registers:
            self._heard = time.monotonic()
            self._command(int(registers[COMMAND]))

    def watch(self, now: float) -> None:
        """End it where its watchdog has heard nothing for too long. now: host time [s]."""
        if self._watchdog > 0 and now - self._heard > 1.0 / self._watchdog:
            self.stop()

    def _stop_servo(self) -> None:
        if self.goal is not None:
            now = time.monotonic()
            self._plant.apply(PlantCommand(positions=self._plant.state(now).positions), now)
            self.goal = None

    def _command(self, command: int) -> None:
        if not self.running:
            return
        if command == SERVO_JOINTS:
            now = time.monotonic()
            # One that comes while the last one is being carried out is left out. At full speed none is: the
            # client's timing is not ours.
            if not self.paused and (self.slider == 1.0 or now >= self._servo_ends):
                self._servo_ends = now + float(self._registers[SERVO_TIME]) / max(self.slider, 0.01)
                self.goal = np.array([self._registers[f"input_double_register_{i}"] for i in range(6)])
                self._plant.apply(PlantCommand(positions=self.goal), now)
            self.answer = READY
        elif command == STOP_PROGRAM:
            self.stop()
        elif command in (0, KICK_WATCHDOG):
            self.answer, self._executing = READY, False
        elif not self._executing:
            if command == SERVO_STOP:
                self._stop_servo()
            elif command == SET_WATCHDOG:
                self._watchdog = float(self._registers["input_double_register_0"])
            elif command == TOOL_OFFSET:
                self.outputs = self._tool
            self.answer, self._executing = DONE, True
