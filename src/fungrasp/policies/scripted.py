"""The reference controller: opens, approaches, closes, squeezes, lifts; after its start it does not look at
the object again."""

from __future__ import annotations

from collections.abc import Mapping

from fungrasp.geometry.poses import compose
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import Motion, ReferenceSettings, plan_motion
from fungrasp.task import Action, LiftTask


class ReferenceController:
    """Plays retargeted grasps in W worlds.

    A grasp's ``extra`` may hold its own ``force_scale``, ``press_in`` and ``press_down`` (see ``refine``).
    """

    def __init__(
        self,
        task: LiftTask,
        objects: Mapping[str, ObjectModel],
        settings: ReferenceSettings | None = None,
        motion: Motion | None = None,
    ):
        """
        Args:
            task: reset; the grasps come from it.
            objects: by name.
            settings: the defaults if None.
            motion: planned before, one for each world; planned here if None.
        """
        self._task = task
        self.motion = motion or planned(task, objects, settings)

    def act(self) -> Action:
        """What to do in the next control period."""
        task = self._task
        step = task.control_step
        goal, fingers = self.motion.at(step)
        return Action(compose(task.settled_pose, goal), fingers, step >= self.motion.lift)


def planned(
    task: LiftTask, objects: Mapping[str, ObjectModel], settings: ReferenceSettings | None = None
) -> Motion:
    """The motion of each world's grasp, for a task that has been reset."""
    return plan_motion(
        task.scene.hand,
        task.grasps,
        objects,
        task.settled_pose,
        task.set_point.pose,
        task.finger_set_point,
        settings,
        task.protocol,
    )
