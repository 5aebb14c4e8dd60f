"""A grasp from the human hand to the lift: its pictures, its film, and what the page says about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.evaluation import DynamicResult, StaticQuality, Trajectory
from fungrasp.grasps import HumanGrasp, RobotGrasp
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.report.camera import Camera
from fungrasp.report.film import frame_times, interpolate
from fungrasp.report.page import Contact, GraspReport, Quantity
from fungrasp.report.pictures import captioned
from fungrasp.report.render import Renderer, render
from fungrasp.report.scenes import (
    human_grasp_scene,
    robot_grasp_scene,
    robot_scene_colours,
    robot_scene_states,
)
from fungrasp.report.viewpoints import frame_geoms, look_at_grasp

CAPTION_MARGIN = 1.3
"""How much larger than its contents a film's picture is: there is a bar of words."""

VERDICT_TIME = 1.2
"""The end of a film during which it says how the trial ended [s]."""

STILL = 4e-4
"""What moves less than this is not drawn again [m]."""

STEADY = 0.1
"""Half of the time over which contacts are averaged, so that links don't flicker [s]."""

MEANINGS: dict[str, tuple[str, str, str]] = {
    "contact_error_mm": ("Contact error", "mm", "Between where person and robot touch, on the surface."),
    "contact_gap_mm": ("Contact gap", "mm", "Between the object and the links that should touch it."),
    "link_direction_error_deg": (
        "Link direction error",
        "°",
        "Between the person's finger links and the robot's.",
    ),
    "object_penetration_mm": ("Depth in the object", "mm", "Deepest point of the hand inside the object."),
    "table_penetration_mm": ("Depth in the table", "mm", "Deepest point of the hand below the table top."),
    "limit_violation_rad": ("Beyond joint limits", "rad", "Of the joint that exceeds its limits most."),
    "force_closure_epsilon": (
        "Force closure ε",
        "",
        "Weakest push or turn that the contacts resist; 0: not all.",
    ),
}
"""Name, unit and meaning of the numbers of ``StaticQuality`` that a page shows."""


def grasp_title(grasp: HumanGrasp) -> str:
    """ "Spray bottle, to spray"."""
    name = grasp.object_name.replace("_", " ")
    return f"{name[:1].upper()}{name[1:]}, to {grasp.task}" if grasp.task else f"{name[:1].upper()}{name[1:]}"


def grasp_report(
    human: HumanGrasp,
    robot: RobotGrasp,
    hand: Hand,
    thing: ObjectModel,
    trajectory: Trajectory,
    quality: StaticQuality,
    result: DynamicResult,
    row: int,
    clip: Path,
) -> GraspReport:
    """What the page says about a grasp.

    Args:
        human: of ``thing``.
        robot: of ``hand``; it imitates ``human``.
        hand: the robot hand.
        thing: the object.
        trajectory: its trial.
        quality: of the set of robot grasps.
        result: of their trials.
        row: of the grasp in ``quality`` and ``result``.
        clip: film of the trial.
    """
    pictures = grasp_pictures(human, robot, hand, thing)
    return GraspReport(
        title=grasp_title(human),
        object_mass=human.object_mass,
        success=trajectory.success,
        outcome=outcome(trajectory, int(result.refined_tries[row])),
        human_picture=pictures[0],
        robot_picture=pictures[1],
        film=clip,
        contacts=contacts(robot, trajectory, hand),
        quality=quantities(quality, result, row),
    )


def outcome(trajectory: Trajectory, tries: int) -> str:
    """How a trial ended, in a sentence. tries: trials that refining took, negative if none succeeded."""
    if not trajectory.success:
        tried = f"None of {-tries} variations held" if tries < -1 else "It did not hold"
        return f"{tried}: {trajectory.reason}."
    if tries <= 1:
        return "Lifted and held for 3 s, at the first try."
    return f"Lifted and held for 3 s, by one of {tries} variations tried in simulation."


def grasp_pictures(
    human: HumanGrasp, robot: RobotGrasp, hand: Hand, thing: ObjectModel, width: int = 640, height: int = 480
) -> tuple[np.ndarray, np.ndarray]:
    """The human grasp and the robot's, seen from the same side; links in contact are orange.

    Args:
        human: of ``thing``.
        robot: of ``hand``; it imitates ``human``.
        width: of each picture [pixels].
        height: of each picture [pixels].

    Returns:
        two pictures, sRGB, shape [height, width, 3] uint8.
    """
    mesh = (thing.vertices, thing.faces)
    person = human_grasp_scene(human.hand_joints, *mesh, human.object_pose, human.link_contacts)
    model, qpos = robot_grasp_scene(
        hand, robot.wrist_pose, robot.joint_positions, *mesh, robot.object_pose, robot.link_contacts
    )
    camera = look_at_grasp(model, qpos, width=width, height=height)
    azimuth, elevation = _angles(camera)
    theirs = frame_geoms(person, person.qpos0, azimuth, elevation, width=width, height=height)
    return render(person, person.qpos0, theirs)[0], render(model, qpos, camera)[0]


def trial_film(
    trajectory: Trajectory,
    hand: Hand,
    thing: ObjectModel,
    *,
    fps: float = 16.0,
    speed: float = 1.5,
    width: int = 480,
    height: int = 360,
    title: str = "",
    threads: int = 0,
) -> Iterator[np.ndarray]:
    """A recorded trial, with the object's own mesh; links light up while they touch.

    The camera draws nearer while the hand approaches. Where nothing moves, as in most of the hold, a frame is
    drawn once. A trial whose simulation diverged is shown until then.

    Args:
        trajectory: of ``hand`` and ``thing``.
        fps: frames per second.
        speed: seconds of the trial in a second of the film.
        width: [pixels].
        height: [pixels].
        title: words before the phase.
        threads: 0 means all CPUs; the film does not depend on it.

    Yields:
        sRGB, shape [height, width, 3] uint8.
    """
    trajectory = _finite_part(trajectory)
    wrist, joints, things = trajectory.palm_pose, trajectory.joint_positions, trajectory.object_pose
    model, _ = robot_grasp_scene(hand, wrist[0], joints[0], thing.vertices, thing.faces, things[0])
    recorded = robot_scene_states(model, hand, wrist, joints, things)
    times = trajectory.times.astype(float)
    at = frame_times(times, fps, speed)
    states = interpolate(model, recorded, times, at)
    cameras = _cameras(model, recorded, trajectory, at, width, height)
    colours = robot_scene_colours(model, hand, _steady(trajectory.link_contacts, times, at))
    drawn = _moving(model, states) | [a != b for a, b in zip(cameras, [None, *cameras], strict=False)]
    drawn |= np.any(colours != np.roll(colours, 1, axis=0), axis=(1, 2))
    which = np.flatnonzero(drawn)
    pictures = Renderer(model, threads=threads).stream(
        states[which], [cameras[i] for i in which], geom_rgba=colours[which]
    )
    phases = trial_phases(trajectory)
    picture = np.empty(0)
    for fresh, time in zip(drawn, at, strict=True):
        picture = next(pictures) if fresh else picture
        phase = [name for start, name in phases if start <= time][-1]
        yield captioned(picture, " · ".join(filter(None, (title, phase))), f"{time - at[0]:.1f} s")


def trial_phases(trajectory: Trajectory) -> list[tuple[float, str]]:
    """Start [s] and name of each phase: as recorded, "close" from the first touch on, the outcome at last."""
    phases = trajectory.phases
    lift = next((start for start, name in phases if name == "lift"), np.inf)
    touch = trajectory.times[_first_touch(trajectory)]
    if touch < lift:
        phases.append((float(touch), "close"))
    verdict = "lifted and held" if trajectory.success else trajectory.reason
    phases.append((float(trajectory.times[-1]) - VERDICT_TIME, verdict))
    return sorted(phases)


def contacts(robot: RobotGrasp, trajectory: Trajectory, hand: Hand) -> list[Contact]:
    """Which links should touch the object, and which do during more than half of the hold."""
    hold = trajectory.phase == trajectory.phase.max()
    reached = trajectory.link_contacts[hold].mean(axis=0) > 0.5
    return [
        Contact(name, bool(target), bool(touches))
        for name, target, touches in zip(hand.link_names, robot.link_contacts, reached, strict=True)
        if target or touches
    ]


def quantities(quality: StaticQuality, result: DynamicResult, row: int) -> list[Quantity]:
    """Numbers of one grasp: the retargeted grasp's static quality, then what was measured in simulation."""
    numbers = {field.name: float(getattr(quality, field.name)[row]) for field in fields(quality)}
    static = [
        Quantity(name, numbers[key], unit, meaning)
        for key, (name, unit, meaning) in MEANINGS.items()
        if np.isfinite(numbers[key])
    ]
    trials = result.trials
    return [
        *static,
        Quantity("Lifted by", 1e3 * float(trials.lifted_height_m[row]), "mm", "At least, during the hold."),
        Quantity(
            "Slip",
            float(trials.sim_distance_hand_mm_s[row]),
            "mm/s",
            "Of the object in the hand, during the hold.",
        ),
        Quantity(
            "Pushed by", 1e3 * float(trials.pushed_m[row]), "mm", "While the hand approached and closed."
        ),
    ]


def _angles(camera: Camera) -> tuple[float, float]:
    """Azimuth and elevation of a camera, seen from its target [degrees]."""
    x, y, z = np.subtract(camera.position, camera.target)
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _cameras(
    model: mujoco.MjModel, states: np.ndarray, trajectory: Trajectory, at: np.ndarray, width: int, height: int
) -> list[Camera]:
    """For each frame: from all of the motion to that from the first touch on."""
    touch = _first_touch(trajectory)
    size = {"width": width, "height": height, "margin": CAPTION_MARGIN}
    near = look_at_grasp(model, states[touch:], **size)
    wide = frame_geoms(model, states, *_angles(near), **size)
    share = np.clip((at - at[0]) / max(trajectory.times[touch] - at[0], 1e-9), 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    return [_between(wide, near, s) for s in share]


def _steady(contacts: np.ndarray, times: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Which links touch most of the time around each frame; shape [F, L] bool. contacts: shape [T, L] bool."""
    first, last = (np.searchsorted(times, at + side * STEADY) for side in (-1, 1))
    return np.array(
        [contacts[a : max(b, a + 1)].mean(axis=0) > 0.5 for a, b in zip(first, last, strict=True)]
    )


def _moving(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """Whether anything has moved by ``STILL`` since the last state in which it had; shape [F] bool."""
    data = mujoco.MjData(model)
    moving, before = np.zeros(len(states), dtype=bool), np.full((model.ngeom, 12), np.inf)
    for i, state in enumerate(states):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        now = np.concatenate([data.geom_xpos, model.geom_rbound[:, None] * data.geom_xmat], axis=1)
        moving[i] = np.abs(now - before).max() > STILL
        before = now if moving[i] else before
    return moving


def _between(a: Camera, b: Camera, share: float) -> Camera:
    px, py, pz = ((1.0 - share) * np.array(a.position) + share * np.array(b.position)).tolist()
    tx, ty, tz = ((1.0 - share) * np.array(a.target) + share * np.array(b.target)).tolist()
    return replace(b, position=(px, py, pz), target=(tx, ty, tz))


def _first_touch(trajectory: Trajectory) -> int:
    """Index of the first state in which the hand touches the object, else of the last before the lift."""
    touching = np.flatnonzero(trajectory.link_contacts.any(axis=1))
    return int(touching[0]) if len(touching) else int(np.flatnonzero(trajectory.phase == 0)[-1])


def _finite_part(trajectory: Trajectory) -> Trajectory:
    finite = np.isfinite(np.concatenate([trajectory.palm_pose, trajectory.object_pose], axis=1)).all(axis=1)
    finite &= np.isfinite(trajectory.joint_positions).all(axis=1)
    count = len(finite) if finite.all() else int(finite.argmin())
    names = ("times", "qpos", "object_pose", "palm_pose", "joint_positions", "link_contacts", "phase")
    return replace(trajectory, **{name: getattr(trajectory, name)[:count] for name in names})
