"""A grasp from the human hand to the lift: its pictures, and what the page says about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fungrasp.evaluation import LiftTestResult, StaticQuality, Trajectory
from fungrasp.grasps import HumanGrasp, RobotGrasp
from fungrasp.hands import Hand
from fungrasp.media.episode_film import view_angles
from fungrasp.media.grasp_scenes import grasp_scene
from fungrasp.media.page import Contact, GraspReport, Quantity
from fungrasp.media.render import render
from fungrasp.media.viewpoints import frame_geoms, look_at_grasp
from fungrasp.objects import ObjectModel
from fungrasp.task.use import UseOutcomes

DIGITS = 3
"""Digits after the point to which numbers are rounded."""

MEANINGS: dict[str, tuple[str, str, str]] = {
    "contact_error_mm": ("Contact error", "mm", "Between where person and robot touch, on the surface."),
    "contact_gap_mm": ("Contact gap", "mm", "Between the object and the links that should touch it."),
    "link_direction_error_deg": (
        "Link direction error",
        "°",
        "Between person and robot, mean of the finger links.",
    ),
    "object_penetration_mm": ("Depth in the object", "mm", "Deepest point of the hand inside the object."),
    "table_penetration_mm": ("Depth in the table", "mm", "Deepest point of the hand below the table top."),
    "limit_violation_rad": ("Beyond joint limits", "rad", "Of the joint that exceeds its limits most."),
    "force_closure_epsilon": (
        "Force closure ε",
        "",
        "Weakest push that the contacts resist; 0 if not all.",
    ),
}
"""Name, unit and meaning of the numbers of ``StaticQuality`` that a page shows."""


def grasp_title(grasp: HumanGrasp | RobotGrasp) -> str:
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
    result: LiftTestResult,
    row: int,
    clip: Path,
    use_clip: Path | None = None,
) -> GraspReport:
    """What the page says about a grasp.

    Args:
        human: of ``thing``.
        robot: of ``hand``; it imitates ``human``.
        hand: the robot hand.
        thing: the object.
        trajectory: its episode.
        quality: of the set of robot grasps.
        result: of their episodes.
        row: of the grasp in ``quality`` and ``result``.
        clip: film of the episode.
        use_clip: film of the use test; None if there was none.
    """
    pictures = grasp_pictures(human, robot, hand, thing)
    return GraspReport(
        title=grasp_title(human),
        object_mass=human.object_mass,
        success=trajectory.success,
        outcome=outcome_words(
            trajectory.success,
            trajectory.reason,
            bool(result.rollouts[row]),
        ),
        human_picture=pictures[0],
        robot_picture=pictures[1],
        film=clip,
        use_success=None if use_clip is None or result.use is None else bool(result.use.success[row]),
        use_outcome="" if use_clip is None or result.use is None else use_outcome(result.use, row),
        use_film=use_clip,
        contacts=contacts(robot, trajectory, hand),
        quality=quantities(quality, result, row),
    )


def outcome_words(success: bool, reason: str, rollouts: bool = False) -> str:
    """How an episode ended, in a sentence.

    Args:
        success: whether the object was lifted and held.
        reason: why not, as a phrase.
        rollouts: whether the plan was chosen in simulated rollouts.
    """
    if not success:
        return f"It did not hold: {reason}."
    how = "with a plan that was chosen in simulated rollouts" if rollouts else "at the first try"
    return f"Lifted and held for 3 s, {how}."


def use_outcome(use: UseOutcomes, row: int) -> str:
    """How a use test ended, in a sentence. row: of the grasp in ``use``."""
    motion = str(use.motion[row]).replace("_", " ")
    moved = f"by {1e3 * use.shift_m[row]:.0f} mm and {np.rad2deg(use.turn_rad[row]):.0f}°"
    if use.success[row]:
        return f"Use ({motion}): passed, moved {moved} in the palm."
    return f"Use ({motion}): failed, {use.reason[row]}."


def grasp_pictures(
    human: HumanGrasp, robot: RobotGrasp, hand: Hand, thing: ObjectModel, width: int = 560, height: int = 420
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
    person, _ = grasp_scene(human, thing)
    model, qpos = grasp_scene(robot, thing, hand)
    camera = look_at_grasp(model, qpos, width=width, height=height)
    azimuth, elevation = view_angles(camera)
    theirs = frame_geoms(person, person.qpos0, azimuth, elevation, width=width, height=height)
    return render(person, person.qpos0, theirs)[0], render(model, qpos, camera)[0]


def contacts(robot: RobotGrasp, trajectory: Trajectory, hand: Hand) -> list[Contact]:
    """Which links should touch the object, and which do during more than half of the hold."""
    hold = trajectory.phase == trajectory.phase.max()
    reached = trajectory.link_contacts[hold].mean(axis=0) > 0.5
    return [
        Contact(name, bool(target), bool(touches))
        for name, target, touches in zip(hand.link_names, robot.link_contacts, reached, strict=True)
        if target or touches
    ]


def quantities(quality: StaticQuality, result: LiftTestResult, row: int) -> list[Quantity]:
    """Numbers of one grasp: the retargeted grasp's static quality, then what was measured in simulation."""
    static = [
        Quantity(name, round(float(getattr(quality, key)[row]), DIGITS), unit, meaning)
        for key, (name, unit, meaning) in MEANINGS.items()
        if np.isfinite(getattr(quality, key)[row])
    ]
    t = result.outcomes
    lifted, slip, pushed = 1e3 * t.lifted_height_m[row], t.sim_distance_hand_mm_s[row], 1e3 * t.pushed_m[row]
    return [
        *static,
        Quantity("Lifted by", round(float(lifted), DIGITS), "mm", "At least, during the hold."),
        Quantity("Slip", round(float(slip), DIGITS), "mm/s", "Of the object in the hand, during the hold."),
        Quantity("Pushed by", round(float(pushed), DIGITS), "mm", "While the hand approached and closed."),
    ]
