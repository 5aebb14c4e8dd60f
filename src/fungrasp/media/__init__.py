"""Pictures without a display: a ray tracer, for MuJoCo models and for captures. No GPU, display or OpenGL."""

from fungrasp.media.camera import Camera, fit_camera, orbit_camera
from fungrasp.media.grasp_scenes import (
    grasp_scene,
    human_grasp_scene,
    robot_grasp_scene,
    robot_scene_colors,
    robot_scene_states,
)
from fungrasp.media.ray_tracing import Look
from fungrasp.media.render import Renderer, Views, render
from fungrasp.media.viewpoints import frame_geoms, look_at_grasp

__all__ = [
    "Camera",
    "Look",
    "Renderer",
    "Views",
    "fit_camera",
    "frame_geoms",
    "grasp_scene",
    "human_grasp_scene",
    "look_at_grasp",
    "orbit_camera",
    "render",
    "robot_grasp_scene",
    "robot_scene_colors",
    "robot_scene_states",
]
