"""One grasp from a person's hand to a robot: its simulated twin here; a cell's file in its place there."""

import fungrasp

human = fungrasp.builtin_grasps()
human = human.select(human.object_name == "can")[:1]
objects = fungrasp.load_objects(human)
robot = fungrasp.retarget(human, objects, hand="allegro")

# As fast as the machine goes: the twin has a clock of its own.
spec = fungrasp.DeploymentSpec(cell="ur5e-allegro", policy="plan", real_time=False)
result = fungrasp.deploy(robot, objects, spec=spec, log="lift.mcap", on_phase=print)

print(result)
fungrasp.view("lift.mcap", out="lift.html")
