"""Pictures, films and the HTML page of a grasp. Rendering needs no GPU, display or OpenGL."""

from fungrasp.report.camera import Camera, fit_camera, orbit_camera
from fungrasp.report.film import film
from fungrasp.report.page import Contact, GraspReport, Page, Quantity, write_page
from fungrasp.report.pictures import (
    captioned,
    four_views,
    frame_geoms,
    grid,
    human_grasp_scene,
    look_at_grasp,
    robot_grasp_scene,
    robot_scene_colours,
    robot_scene_states,
)
from fungrasp.report.render import Renderer, Views, render
from fungrasp.report.shading import Look
from fungrasp.report.video import write_video

__all__ = [
    "Camera",
    "Contact",
    "GraspReport",
    "Look",
    "Page",
    "Quantity",
    "Renderer",
    "Views",
    "captioned",
    "film",
    "fit_camera",
    "four_views",
    "frame_geoms",
    "grid",
    "human_grasp_scene",
    "look_at_grasp",
    "orbit_camera",
    "render",
    "robot_grasp_scene",
    "robot_scene_colours",
    "robot_scene_states",
    "write_page",
    "write_video",
]
