"""A robot hand follows a human hand that approaches a mug, frame by frame."""

from time import perf_counter

import numpy as np

import fungrasp
from fungrasp.retargeting import Retargeter

FRAMES = 100

human = fungrasp.builtin_grasps()
human = human.select(np.flatnonzero(human.object_name == "mug")[:1])
mug = fungrasp.load_objects(human)["mug"]
retargeter = Retargeter(fungrasp.load_hand("allegro"), mug)

grasp = human[0]
back = grasp.hand_joints[0] - grasp.object_pose[:3]
back /= np.linalg.norm(back)
poses, start = [], perf_counter()
for share in np.linspace(1.0, 0.0, FRAMES):
    joints = grasp.hand_joints + 0.15 * share * back
    poses.append(retargeter.follow(joints, grasp.object_pose))
    if len(poses) == 1:
        # The first frame is solved from nothing, and loops are compiled.
        start = perf_counter()
print(f"{(FRAMES - 1) / (perf_counter() - start):.0f} frames a second")
steps = np.abs(np.diff([pose.joint_positions for pose in poses], axis=0))
print(f"largest change of a joint from frame to frame: {steps.max():.3f} rad")
