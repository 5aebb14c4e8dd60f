"""A rehearsed plan, looked at: a picture of its postures and the palm's way, and a film of the whole way."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.files import atomic_path
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.rehearsal import Motion
from fungrasp.hands import Hand
from fungrasp.hands.arm import arm_spec, mount
from fungrasp.media.camera import Camera, fit_camera, orbit_camera
from fungrasp.media.episode_film import film
from fungrasp.media.grasp_scenes import OBJECT_BODY, add_object
from fungrasp.media.pictures import grid
from fungrasp.media.render import render
from fungrasp.media.video import write_video
from fungrasp.media.visual_meshes import dressed_spec
from fungrasp.objects import ObjectModel
from fungrasp.robots.cell import RobotCell

WIDTH, HEIGHT = 480, 360
"""Of each picture and of the film [pixels]."""

FPS, SPEED = 10.0, 2.0
"""Frames of the film in a second, and seconds of the plan in a second of the film."""

TABLE, OBSTACLE = (0.72, 0.66, 0.58, 1.0), (0.80, 0.42, 0.32, 1.0)
"""Colors, sRGB and opacity."""

WAY = {
    Phase.MOVE_TO_START: (0.20, 0.40, 0.80, 1.0),
    Phase.GRASP: (0.95, 0.49, 0.16, 1.0),
    Phase.LIFT: (0.15, 0.60, 0.25, 1.0),
    Phase.HOLD: (0.15, 0.60, 0.25, 1.0),
    Phase.PUT_DOWN: (0.55, 0.30, 0.60, 1.0),
    Phase.HOME: (0.35, 0.65, 0.75, 1.0),
}
"""Colors of the palm's way by phase."""

BEAD, SPACING = 0.006, 0.02
"""Radius of the beads of that way, and their distance from one another [m]."""

NEAR = 0.9
"""Distance of a camera that looks at the grasp alone [m]."""

VIEWS = ((-50.0, 25.0), (40.0, 25.0))
"""Azimuth and elevation of the cameras [degrees]."""


def write_plan_pictures(
    path: Path, motion: Motion, cell: RobotCell, hand: Hand, thing: ObjectModel, threads: int = 0
) -> tuple[Path, Path]:
    """Write a picture (.png) and a film beside it (.mp4, or .webp without H.264) of a rehearsed plan.

    Args:
        path: of the picture.
        motion: of the plan.
        cell: its robot.
        hand: on its arm.
        thing: its object.
        threads: of the renderer; 0 means all processors.

    Returns:
        the paths of both.

    Raises:
        FungraspError: a file can't be written.
    """
    from PIL import Image

    scene = PlanScene(cell, hand, thing, motion)
    phases = _phases(motion)
    ends = {phase: rows[-1] for phase, rows in phases}
    left, right = (scene.camera(view) for view in VIEWS)
    near, other = (_close_up(motion.object_pose[0], view) for view in VIEWS)
    shown = {
        "the palm's way": (ends[Phase.HOLD], left, True),
        "the palm's way, from the other side": (ends[Phase.HOLD], right, True),
        "where it begins": (0, left, False),
        "start of the grasp": (ends[Phase.MOVE_TO_START], left, False),
        "grasp": (ends[Phase.GRASP], near, False),
        "grasp, from the other side": (ends[Phase.GRASP], other, False),
        "lifted": (ends[Phase.HOLD], left, False),
        "put down, the hand withdrawn": (ends[Phase.PUT_DOWN], left, False),
    }
    sheet = grid([scene.draw(*how, threads=threads) for how in shown.values()], list(shown))
    picture = path.with_suffix(".png")
    with atomic_path(picture) as temporary:
        Image.fromarray(sheet).save(temporary)
    frames = film(
        scene.bare,
        scene.states,
        motion.times,
        FPS,
        left,
        speed=SPEED,
        phases=[(float(motion.times[rows[0]]), phase) for phase, rows in phases],
        title=thing.name,
        threads=threads,
    )
    return picture, write_video(path.with_suffix(".mp4"), frames, FPS)


class PlanScene:
    """Arm, hand, object, table and obstacles of a plan, to be drawn."""

    def __init__(self, cell: RobotCell, hand: Hand, thing: ObjectModel, motion: Motion):
        """
        Args:
            cell: the robot.
            hand: on its arm.
            thing: the object.
            motion: of the plan.
        """
        self._motion = motion
        self.bare = _model(cell, hand, thing, None)
        """Without the palm's way."""
        self._beaded = _model(cell, hand, thing, motion)
        self.states = _states(self.bare, cell, hand, motion)
        """The qpos of each setpoint, shape [T, nq]."""

    def draw(self, row: int, camera: Camera, way: bool = False, threads: int = 0) -> np.ndarray:
        """A picture of one setpoint, sRGB, shape [H, W, 3] uint8.

        Args:
            row: of the motion.
            camera: that sees it.
            way: whether the palm's way is drawn.
            threads: 0 means all processors.
        """
        return render(self._beaded if way else self.bare, self.states[row], camera, threads=threads)[0]

    def camera(self, view: tuple[float, float]) -> Camera:
        """A camera that sees the robot in all of the motion. view: azimuth and elevation [degrees]."""
        m, centers, radii = self.bare, [], []
        data = mujoco.MjData(m)
        drawn = np.flatnonzero((m.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (m.geom_bodyid > 0))
        for state in self.states[:: max(1, len(self.states) // 30)]:
            data.qpos[:] = state
            mujoco.mj_kinematics(m, data)
            centers.append(data.geom_xpos[drawn].copy())
            radii.append(m.geom_rbound[drawn])
        return fit_camera(
            np.concatenate(centers), np.concatenate(radii), *view, width=WIDTH, height=HEIGHT, margin=1.05
        )


def _model(cell: RobotCell, hand: Hand, thing: ObjectModel, motion: Motion | None) -> mujoco.MjModel:
    """To be drawn only: nothing collides. motion: whose palm's way is drawn; none if None."""
    spec = mount(hand, cell.arm.model, cell.mount, dressed_spec(hand))
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    plane, box, ball = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    spec.worldbody.add_geom(name="table", type=plane, size=[1.2, 1.2, 0.05], rgba=TABLE)
    for one in cell.obstacles:
        half = (0.5 * np.array(one.size)).tolist()
        turn, place = list(one.rotation), list(one.center)
        spec.worldbody.add_geom(type=box, size=half, pos=place, quat=turn, rgba=OBSTACLE)
    add_object(spec, thing).add_freejoint(name=OBJECT_BODY)
    if motion is not None:
        for place, color in _beads(motion):
            spec.worldbody.add_geom(type=ball, size=[BEAD, 0, 0], pos=place.tolist(), rgba=color)
    return spec.compile()


def _beads(motion: Motion) -> list[tuple[np.ndarray, Sequence[float]]]:
    """Places along the palm's way, and their colors."""
    beads: list[tuple[np.ndarray, Sequence[float]]] = []
    for place, phase in zip(motion.palm[:, :3], motion.phases, strict=True):
        if not beads or np.linalg.norm(place - beads[-1][0]) >= SPACING:
            beads.append((place, WAY[Phase(str(phase))]))
    return beads


def _states(model: mujoco.MjModel, cell: RobotCell, hand: Hand, motion: Motion) -> np.ndarray:
    names = [actuator.name for actuator in arm_spec(cell.arm.model).actuators]
    states = np.tile(model.qpos0, (len(motion.times), 1))
    states[:, [int(model.joint(name).qposadr[0]) for name in names]] = motion.arm
    fingers = np.array([hand.all_joints(row) for row in motion.fingers])
    states[:, [int(model.joint(name).qposadr[0]) for name in hand.joint_names]] = fingers
    start = int(model.joint(OBJECT_BODY).qposadr[0])
    states[:, start : start + 7] = motion.object_pose
    return states


def _phases(motion: Motion) -> list[tuple[Phase, list[int]]]:
    """The phases with the rows of each."""
    found = groupby(range(len(motion.times)), lambda row: Phase(str(motion.phases[row])))
    return [(phase, list(rows)) for phase, rows in found]


def _close_up(object_pose: np.ndarray, view: tuple[float, float]) -> Camera:
    """A camera near to the object. view: azimuth and elevation [degrees]."""
    target = object_pose[:3].tolist()
    return orbit_camera(target, NEAR, *view, width=WIDTH, height=HEIGHT)
