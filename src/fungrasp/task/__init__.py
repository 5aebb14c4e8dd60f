"""What a policy sees and does in the dynamic test, and when a grasp has succeeded."""

from fungrasp.task.lift import Action, LiftTask, Trials
from fungrasp.task.protocol import Protocol

__all__ = ["Action", "LiftTask", "Protocol", "Trials"]
