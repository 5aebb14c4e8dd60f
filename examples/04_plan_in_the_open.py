"""Planning is a call of its own: a grasp and a belief in, a plan that can be looked at and kept out."""

import numpy as np

import fungrasp

human = fungrasp.builtin_grasps()[50:51]
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("allegro")
robot = fungrasp.retarget(human, objects, hand)

# What is known of the scene: where the object lies, what it weighs, where the open hand is.
start = robot.wrist_pose.copy()
start[:, 2] += 0.25
fingers = 0.5 * hand.independent(robot.joint_positions)
belief = fungrasp.Belief.nominal(robot.object_rest_pose, robot.object_mass, start, fingers)

# One motion, nothing simulated; then the best of many candidates, which rollouts choose.
motion = fungrasp.MotionPlanner(hand, objects).plan(robot, belief)
planner = fungrasp.make_planner("plan", hand, objects)
plan = planner.plan(robot, belief, seed=0)

assert plan.expected_success is not None and plan.rollouts is not None
print(
    f"{plan.object_name[0]}: {plan.palm_goal_object.shape[1]} control steps, lift at step {plan.lift_step[0]}"
)
print(f"expected success {plan.expected_success[0]:.0%} after {plan.rollouts[0]} rollouts")
offset = np.linalg.norm(plan.grasp_palm_pose[0, :3] - motion.grasp_palm_pose[0, :3])
print(f"the chosen candidate's palm is {1e3 * offset:.0f} mm from the unchanged grasp's")

plan.save("plan.npz")
again = fungrasp.GraspPlan.load("plan.npz")
assert np.array_equal(again.palm_goal_object, plan.palm_goal_object)
