"""A robot hand follows a free human hand from 21 keypoints, frame by frame, then one that grasps a mug."""

from time import process_time

import numpy as np

import fungrasp as fg

grasps = fg.builtin_grasps()
first, second = (grasps.hand_joints[row] - grasps.hand_joints[row, 0] for row in (0, 50))
frames = [first + share * (second - first) for share in np.linspace(0, 1, 100)]  # from your tracker

retargeter = fg.Retargeter("allegro")
retargeter.follow(frames[0])
start = process_time()
poses = [retargeter.follow(joints) for joints in frames]
print(f"{len(frames) / (process_time() - start):.0f} frames in a second of one core")
print(dict(zip(retargeter.hand.joint_names, poses[-1].joint_positions.round(3), strict=True)))

mug = fg.Retargeter("allegro", fg.load_object("mug"))
away = 0.1 * (grasps[0].hand_joints[0] - grasps[0].object_pose[:3])
for share in np.linspace(1, 0, 20):
    pose = mug.follow(grasps[0].hand_joints + share * away, grasps[0].object_pose)
print("palm at the mug:", pose.wrist_pose.round(3))
