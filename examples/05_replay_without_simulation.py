"""A policy sees observations and nothing else: from recorded ones it gives the same actions again."""

import numpy as np

import fungrasp
from fungrasp import Action, GraspPlan, Observation
from fungrasp.policies import StudentPolicy


class Recorded:
    """Keeps what a policy sees and does."""

    def __init__(self, policy: fungrasp.Policy):
        self.policy = policy
        self.observations: list[Observation] = []
        self.actions: list[Action] = []

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        self.policy.reset(plan, observation)

    def act(self, observation: Observation) -> Action:
        action = self.policy.act(observation)
        self.observations.append(observation)
        self.actions.append(action)
        return action


human = fungrasp.builtin_grasps()[50:53]
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("allegro")
robot = fungrasp.retarget(human, objects, hand)

environment = fungrasp.LiftEnvironment(fungrasp.build_scene(hand, objects), len(robot))
plan = fungrasp.MotionPlanner(hand, objects).plan(robot, environment.settle(robot))
student = fungrasp.make_policy("allegro-student-free", hand, objects)
assert isinstance(student, StudentPolicy)
recorder = Recorded(student)
outcomes = fungrasp.play(environment, recorder, plan)
print("success:", outcomes.success)

# On file, one row for each robot and control step; then into the policy once more, without any simulation.
Observation.join(recorder.observations).save("observations.npz")
seen = Observation.load("observations.npz")
worlds = len(plan)
for step, action in enumerate(recorder.actions):
    observation = seen.select(slice(step * worlds, (step + 1) * worlds))
    if step == 0:
        student.reset(plan, observation)
    again = student.act(observation)
    assert np.array_equal(again.palm_goal_world, action.palm_goal_world)
    assert np.array_equal(again.finger_targets, action.finger_targets)
print(f"{len(recorder.actions)} recorded control steps give the same actions")
