"""From an image with depth to a human grasp. The hand models are fetched by ``fungrasp setup perception``."""

import sys

import fungrasp
from fungrasp.perception.hand.mediapipe_models import have_weights
from fungrasp.perception.io.scene_folders import read_folder
from fungrasp.report.demo_capture import FOLDER

if not have_weights():
    sys.exit("skipped: the hand models are missing; fetch them with 'fungrasp setup perception'")

capture = read_folder(FOLDER)
found = fungrasp.perceive(capture, fungrasp.load_object("spray_bottle"), seed=0)

print(f"a {found.hand.side} hand, {found.grasp.link_contacts.sum()} links touch the object")
print("camera in the world:", found.pose_world_camera.round(3))
print("confident" if found.confident else "low confidence")
for warning in found.warnings:
    print(f"{warning.code}: {warning}")
