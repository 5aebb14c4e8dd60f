"""Human grasps to grasps of a robot hand, and how good they are."""

import fungrasp

human = fungrasp.builtin_grasps()
human = human.select(human.object_name == "mug")
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("shadow")

robot = fungrasp.retarget(human, objects, hand)

quality = fungrasp.static_quality(robot, human, objects, hand)
columns = zip(robot.object_name, quality.contact_error_mm, quality.object_penetration_mm, strict=True)
for name, error, depth in columns:
    print(f"{name}: contact error {error:.1f} mm, penetration {depth:.1f} mm")

fungrasp.save_robot_grasps("shadow-mug.npz", robot)
