"""Arm and hand of a twin as plants: what stands behind the emulators of their wires."""

from __future__ import annotations

from fungrasp.robots.emulators.plant import PlantCommand, PlantState
from fungrasp.robots.twin.world import TwinWorld


class TwinArmPlant:
    """The arm's joints."""

    def __init__(self, world: TwinWorld):
        """world: on the clock of the wall."""
        self._world = world

    def apply(self, command: PlantCommand, now: float) -> None:
        """See ``Plant.apply``. Without positions the arm keeps its last target: brakes."""
        if command.positions is not None:
            self._world.command_arm(command.positions)

    def state(self, now: float) -> PlantState:
        """See ``Plant.state``."""
        return PlantState(*self._world.arm_state())


class TwinHandPlant:
    """The hand's independent joints."""

    def __init__(self, world: TwinWorld):
        """world: on the clock of the wall."""
        self._world = world

    def apply(self, command: PlantCommand, now: float) -> None:
        """See ``Plant.apply``."""
        self._world.powered = command.positions is not None or command.torques is not None
        if command.torques is not None:
            self._world.command_torques(command.torques)
        elif command.positions is not None:
            self._world.command_hand(command.positions)

    def state(self, now: float) -> PlantState:
        """See ``Plant.state``."""
        return PlantState(*self._world.hand_state())
