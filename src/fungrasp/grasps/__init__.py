"""Human and robot grasps: types, files, and importers of data sets."""

from fungrasp.grasps.contacts import link_contacts
from fungrasp.grasps.conversion import Convention, converted, mirrored_grasps
from fungrasp.grasps.diagnosis import checked_grasps
from fungrasp.grasps.from_arrays import mediapipe_joints
from fungrasp.grasps.grasp_arguments import load_objects
from fungrasp.grasps.grasp_files import (
    builtin_grasps,
    load_grasps,
    load_human_grasps,
    load_robot_grasps,
    save_human_grasps,
    save_robot_grasps,
)
from fungrasp.grasps.grasp_set import GraspSet
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.human_hand import (
    BONES,
    HUMAN_JOINTS,
    HUMAN_LINKS,
    bone_lengths,
    finger_link_directions,
    hand_sides,
)
from fungrasp.grasps.robot_grasp import RobotGrasp, RobotGraspSet

__all__ = [
    "BONES",
    "HUMAN_JOINTS",
    "HUMAN_LINKS",
    "Convention",
    "GraspSet",
    "HumanGrasp",
    "HumanGraspSet",
    "RobotGrasp",
    "RobotGraspSet",
    "bone_lengths",
    "builtin_grasps",
    "checked_grasps",
    "converted",
    "finger_link_directions",
    "hand_sides",
    "link_contacts",
    "load_grasps",
    "load_human_grasps",
    "load_objects",
    "load_robot_grasps",
    "mediapipe_joints",
    "mirrored_grasps",
    "save_human_grasps",
    "save_robot_grasps",
]
