"""Picture of a rehearsed plan: its postures and the palm's path."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.files import atomic_path
from fungrasp.deployment.rehearsal import Motion
from fungrasp.deployment.spec import Phase
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec, mount
from fungrasp.media.camera import orbit_camera
from fungrasp.media.grasp_scenes import OBJECT_BODY, add_object, frame_geoms
from fungrasp.media.pictures import grid
from fungrasp.media.render import render
from fungrasp.media.visual_meshes import dressed_spec
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell

WIDTH, HEIGHT = 480, 360
"""Size of the picture of each posture [pixels]."""

OBSTACLE = (0.80, 0.42, 0.32, 1.0)
"""Color of obstacles, sRGB and opacity."""

WAY = {
    Phase.MOVE_TO_START: (0.20, 0.40, 0.80, 1.0),
    Phase.GRASP: (0.95, 0.49, 0.16, 1.0),
    Phase.LIFT: (0.15, 0.60, 0.25, 1.0),
    Phase.HOLD: (0.15, 0.60, 0.25, 1.0),
    Phase.PUT_DOWN: (0.55, 0.30, 0.60, 1.0),
    Phase.HOME: (0.35, 0.65, 0.75, 1.0),
}
"""Colors of the palm's path by phase."""

BEAD, SPACING = 0.006, 0.02
"""Radius and minimum spacing of the spheres that mark the path [m]."""

NEAR = 0.9
"""Camera distance of the close-ups of the grasp [m]."""

VIEWS = ((-50.0, 25.0), (40.0, 25.0))
"""Azimuth and elevation of the cameras [degrees]."""


def write_plan_picture(
    path: Path, motion: Motion, cell: RobotCell, hand: Hand, obj: ObjectModel, threads: int = 0
) -> Path:
    """Write a picture of a rehearsed plan.

    Args:
        path: PNG file.
        threads: threads of the renderer; 0 for all processors.

    Raises:
        FungraspError: the file can't be written.
    """
    from PIL import Image

    bare, beaded = _model(cell, hand, obj, None), _model(cell, hand, obj, motion)
    states = _states(bare, cell, hand, motion)
    last = {Phase(str(phase)): row for row, phase in enumerate(motion.phases)}
    size = {"width": WIDTH, "height": HEIGHT}
    left, right = (frame_geoms(bare, states, *view, margin=1.05, **size) for view in VIEWS)
    target = motion.object_pose[0, :3].tolist()
    near, other = (orbit_camera(target, NEAR, *view, **size) for view in VIEWS)
    shown = {
        "the palm's way": (beaded, last[Phase.HOLD], left),
        "the palm's way, from the other side": (beaded, last[Phase.HOLD], right),
        "where it begins": (bare, 0, left),
        "start of the grasp": (bare, last[Phase.MOVE_TO_START], left),
        "grasp": (bare, last[Phase.GRASP], near),
        "grasp, from the other side": (bare, last[Phase.GRASP], other),
        "lifted": (bare, last[Phase.HOLD], left),
        "put down, the hand withdrawn": (bare, last[Phase.PUT_DOWN], left),
    }
    drawn = [render(model, states[row], camera, threads=threads)[0] for model, row, camera in shown.values()]
    with atomic_path(path) as temporary:
        Image.fromarray(grid(drawn, list(shown))).save(temporary, format="PNG")
    return path


def _model(cell: RobotCell, hand: Hand, obj: ObjectModel, motion: Motion | None) -> mujoco.MjModel:
    """Return a visual model of arm, hand, object and obstacles. motion: motion whose palm path is drawn."""
    spec = mount(hand, cell.arm.model, cell.mount, dressed_spec(hand))
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    box, ball = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    for one in cell.obstacles:
        half = (0.5 * np.array(one.size)).tolist()
        turn, place = list(one.rotation), list(one.center)
        spec.worldbody.add_geom(type=box, size=half, pos=place, quat=turn, rgba=OBSTACLE)
    add_object(spec, obj).add_freejoint(name=OBJECT_BODY)
    bead: np.ndarray | None = None
    for place, phase in () if motion is None else zip(motion.palm[:, :3], motion.phases, strict=True):
        if bead is None or np.linalg.norm(place - bead) >= SPACING:
            bead, color = place, WAY[Phase(str(phase))]
            spec.worldbody.add_geom(type=ball, size=[BEAD, 0, 0], pos=place.tolist(), rgba=color)
    return spec.compile()


def _states(model: mujoco.MjModel, cell: RobotCell, hand: Hand, motion: Motion) -> np.ndarray:
    """Return the qpos of each setpoint, shape [T, nq]."""
    names = [actuator.name for actuator in arm_spec(cell.arm.model).actuators]
    states = np.tile(model.qpos0, (len(motion.times), 1))
    states[:, [int(model.joint(name).qposadr[0]) for name in names]] = motion.arm
    fingers = np.array([hand.all_joints(row) for row in motion.fingers])
    states[:, [int(model.joint(name).qposadr[0]) for name in hand.joint_names]] = fingers
    start = int(model.joint(OBJECT_BODY).qposadr[0])
    states[:, start : start + 7] = motion.object_pose
    return states
