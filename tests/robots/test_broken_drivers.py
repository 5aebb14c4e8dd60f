"""Drivers that raise where none may: the other devices of the robot are stopped and closed all the same."""

from types import SimpleNamespace

import pytest

from fungrasp.robots.robot import Robot


class _Device:
    def __init__(self, name: str, told: list[str], breaks: bool = False):
        self.name, self._told, self._breaks = name, told, breaks

    def _do(self, what: str) -> None:
        self._told.append(f"{self.name} {what}")
        if self._breaks:
            raise OSError("broken pipe")

    def close(self) -> None:
        self._do("close")

    def stop(self, kind: object) -> None:
        self._do("stop")


def test_the_hand_is_closed_and_stopped_though_the_arms_driver_raises() -> None:
    told: list[str] = []
    robot = SimpleNamespace(
        arm=_Device("arm", told, breaks=True),
        hand_driver=_Device("hand", told),
        tracker=_Device("tracker", told),
    )
    with pytest.raises(OSError, match="broken pipe"):
        Robot.close(robot)  # pyright: ignore[reportArgumentType]
    assert told == ["arm close", "hand close", "tracker close"]
    told.clear()
    Robot.stop(robot)  # pyright: ignore[reportArgumentType]
    assert told == ["arm stop", "hand stop"]
