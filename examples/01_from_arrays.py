"""From the joints of a hand and a mesh to the joints of a robot hand."""

import fungrasp as fg

shown, mesh = fg.builtin_grasps()[0], fg.load_object("mug").mesh  # from your tracker and your mesh file
human = fg.human_grasp(shown.hand_joints, mesh, order="fungrasp", object_pose=shown.object_pose, mass=0.3)
robot = fg.retarget(human, hand="shadow")
robot.save("shadow-mug.npz")
print(robot.joint_dict())
