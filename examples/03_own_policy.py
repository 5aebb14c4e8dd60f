"""A policy is a class with ``reset`` and ``act``. This one follows its plan, and the object if it moves."""

import fungrasp
from fungrasp import Action, GraspPlan, Observation
from fungrasp.geometry.poses import compose


class FollowTheObject:
    """Plays the plan in the frame of the object as it is seen, until the fingers close."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        self.plan, self.anchor = plan, observation.object_pose.copy()

    def act(self, observation: Observation) -> Action:
        step = (observation.time / self.plan.control_period + 0.5).astype(int)
        free = step < self.plan.closing_step
        self.anchor[free] = observation.object_pose[free]
        goal, fingers = self.plan.at(step)
        return Action(compose(self.anchor, goal), fingers, step >= self.plan.lift_step)


human = fungrasp.builtin_grasps()
human = human.select(human.object_name == "can")
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("allegro")
robot = fungrasp.retarget(human, objects, hand)

# After planning, every object is moved by 2 cm.
moved = fungrasp.Randomization(object_shift=(0.02, 0.02))
for policy in ("reference", FollowTheObject()):
    result = fungrasp.evaluate(robot, objects, policy, spec=fungrasp.LiftTestSpec(randomization=moved))
    print(f"{result.policy}: {result.outcomes.success.sum()} of {len(robot)}")
