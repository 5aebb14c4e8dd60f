"""One grasp from a person's hand to a robot: its simulated twin here; a cell's file in its place there."""

import fungrasp

human = fungrasp.builtin_grasps()
human = human.select(human.object_name == "wine_glass")[:1]
objects = fungrasp.load_objects(human)
robot = fungrasp.retarget(human, objects, hand="allegro")


class Phases(fungrasp.DeploymentObserver):
    def phase(self, time, phase):
        print(f"{time:6.2f} s  {phase}")


# As fast as the machine goes: the twin has a clock of its own.
spec = fungrasp.DeploymentSpec(cell="ur5e-allegro", policy="plan")
result = fungrasp.deploy(robot, objects, spec=spec, log="lift.mcap", observer=Phases())

print(result)
print("look at it: fungrasp view lift.mcap")
