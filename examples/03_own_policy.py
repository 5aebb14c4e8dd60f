"""A policy of one's own: copy this file and change ``act``."""

import fungrasp as fg
from fungrasp.geometry.poses import compose


class MyPolicy:
    def reset(self, plan, observation):
        self.plan, self.anchor = plan, observation.object_pose.copy()

    def act(self, observation):
        step = (observation.time / self.plan.control_period + 0.5).astype(int)
        free = step < self.plan.closing_step  # until the fingers close, the plan moves along with the object
        self.anchor[free] = observation.object_pose[free]
        palm_goal_object, finger_targets = self.plan.at(step)
        return fg.Action(compose(self.anchor, palm_goal_object), finger_targets, step >= self.plan.lift_step)


moved = fg.LiftTestSpec(randomization=fg.Randomization(object_shift=(0.02, 0.02)))
robot = fg.retarget(fg.builtin_grasps()[50:53])
for policy in ("reference", MyPolicy()):
    print(fg.evaluate(robot, policy=policy, spec=moved).table())
