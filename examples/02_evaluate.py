"""The lift test: which grasps lift the object and hold it."""

import fungrasp

human = fungrasp.builtin_grasps()[::12]
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("allegro")
robot = fungrasp.retarget(human, objects, hand)

result = fungrasp.evaluate(robot, objects, policy="reference")

for name, task, reason in zip(result.object_name, result.task, result.outcomes.reason, strict=True):
    print(f"{name}, {task}: {reason or 'success'}")
print(f"{result.outcomes.success.mean():.0%} of {len(robot)} grasps lift and hold the object")
