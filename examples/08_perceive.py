"""From an image with depth to a human grasp. The hand models are fetched by ``fungrasp setup perception``."""

import sys

import fungrasp
from fungrasp.perception.hand.mediapipe_models import have_weights

if not have_weights():
    sys.exit("skipped: the hand models are missing; fetch them with 'fungrasp setup perception'")

# An image that comes with the package; a folder, files or a camera may stand in its place.
found = fungrasp.perceive("builtin", "spray_bottle", seed=0)

print(f"a {found.hand.side} hand, {found.grasp.link_contacts.sum()} links touch the object")
print("camera in the world:", found.pose_world_camera.round(3))
print("confident" if found.confident else "low confidence")
for warning in found.warnings:
    print(f"{warning.code}: {warning}")
for stage, seconds in found.trace.seconds.items():
    print(f"{stage}: {seconds.wall:.1f} s")

robot = fungrasp.retarget(found.grasps, found.objects, hand="allegro")
print(robot)
