"""Plans are made once, tried in simulation, and carried out by a robot (here its twin)."""

import fungrasp as fg

human = fg.builtin_grasps()[36:53:8]
robot = fg.retarget(human, hand="allegro")
plans = fg.plan(robot)
result = fg.evaluate(robot, plans=plans)
result.save("result.json")
print(result.table())
best = int(result.success.argmax())
spec = fg.DeploymentSpec(cell="ur5e-allegro", policy="reference")
print(fg.deploy(robot[best], plans=plans[best], spec=spec))
