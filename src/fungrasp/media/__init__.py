"""Rendering of MuJoCo models and captures by ray tracing, without GPU, display or OpenGL."""

from fungrasp.media.camera import Camera, orbit_camera
from fungrasp.media.grasp_scenes import grasp_scene, look_at_grasp
from fungrasp.media.ray_tracing import Look
from fungrasp.media.render import Renderer, render

__all__ = ["Camera", "Look", "Renderer", "grasp_scene", "look_at_grasp", "orbit_camera", "render"]
