"""Self-contained HTML page about a grasp perceived in an image: overlays, quality, uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from fungrasp.grasps import HUMAN_LINKS
from fungrasp.grasps.human_hand import HUMAN_FINGERS
from fungrasp.media.page import Page, Quantity, figure, quality_card, write_page
from fungrasp.media.perception_pictures import (
    FINGER_COLORS,
    CloseUp,
    grasp_from_four_sides,
)
from fungrasp.objects import MIRRORED, ObjectModel
from fungrasp.perception import Capture
from fungrasp.perception.acceptance import SURE_JOINT, WITHIN, Acceptance
from fungrasp.perception.io.scene_folders import BuiltinTruth
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.pose_error import add, add_s, rotation_error
from fungrasp.perception.object_pose.pose_evidence import CLOSE, RIVAL_DISTANCE, TURNED
from fungrasp.perception.perceived import Perceived

SIDES = ("From the camera's side", "From the right of that", "From behind", "From the left")
"""Captions of the four pictures of the grasp."""

SAME = 0.002
"""ADD-S distance below which poses look the same [m]."""

POINTS = 1500
"""Number of surface points for comparing poses."""

PICTURED = 2
"""Maximum number of alternative poses with a picture."""


def write_perception_page(path: str | Path, perceived: Perceived, provenance: Mapping[str, str]) -> Path:
    """Write a self-contained page.

    Args:
        perceived: result of ``perceive``.
        provenance: version, command, machine, ..., in the order given.

    Raises:
        FungraspError: the page can't be written.
    """
    facts = f"{perceived.hand.side.capitalize()} hand · {1000 * perceived.object_model.mass:.0f} g"
    if perceived.mass_range is not None:
        low, high = perceived.mass_range
        facts += f", guessed: {1000 * low:.0f} to {1000 * high:.0f} g"
    page = Page(perception_title(perceived), (), facts, provenance=provenance)
    return write_page(path, page, perception_parts(perceived))


def perception_title(perceived: Perceived) -> str:
    """ "Spray bottle, to spray: seen in one image"."""
    name = perceived.grasp.object_name.removesuffix(MIRRORED).replace("_", " ")
    name = "unknown object" if perceived.fitted is not None else name
    task = f", to {perceived.grasp.task}" if perceived.grasp.task else ""
    return f"{name[:1].upper()}{name[1:]}{task}: seen in one image"


def perception_parts(perceived: Perceived, truth: Sequence[Quantity] = ()) -> list[str]:
    """Return the HTML sections: verdict, image, 3D views, numbers, uncertainty.

    truth: errors, if the ground truth is known.
    """
    capture, model = perceived.capture, perceived.object_model
    return [
        _verdict(perceived),
        _seen(capture, model, perceived),
        _in_space(model, perceived),
        _figures(perceived.acceptance, truth),
        _uncertain(capture, model, perceived),
    ]


def true_errors(truth: BuiltinTruth, perceived: Perceived) -> list[Quantity]:
    """Return the errors of a perceived grasp."""
    joints = 1e3 * np.linalg.norm(perceived.hand.joints_camera - truth.joints_camera, axis=1)
    pose = perceived.object.pose_camera_object
    points = object_template(perceived.object_model).surface.samples
    apart = 1e3 * float(add(points, pose, truth.pose_camera_object))
    turned = float(np.degrees(rotation_error(pose, truth.pose_camera_object)))
    return [
        Quantity("Error of the joints", float(joints.mean()), "mm", "Mean of the 21 joints.", 12.0),
        Quantity("Error of the worst joint", float(joints.max()), "mm", "Usually one that is hidden."),
        Quantity("Error of the object", apart, "mm", "Mean distance of its points from the true ones.", 10.0),
        Quantity("Turn of the object", turned, "°", "Between its pose and the true one.", 10.0),
    ]


def contact_words(link_contacts: np.ndarray) -> str:
    """ "palm; index: distal; thumb: middle, distal". link_contacts: shape [16] bool."""
    touching = [name for name, touches in zip(HUMAN_LINKS, link_contacts, strict=True) if touches]
    words = ["palm"] * ("palm" in touching)
    for finger in HUMAN_FINGERS:
        links = [name.removeprefix(f"{finger}_") for name in touching if name.startswith(f"{finger}_")]
        words += [f"{finger}: {', '.join(links)}"] * bool(links)
    return "; ".join(words) or "nothing"


def _verdict(perceived: Perceived) -> str:
    verdict = perceived.acceptance
    kind, mark = ("good", "✓") if verdict.sure else ("bad", "?")
    warnings = "".join(f"<li>{escape(_sentence(str(one)))}</li>" for one in perceived.warnings)
    helps = "".join(f"<li>{escape(_sentence(one))}</li>" for one in verdict.help)
    return (
        f'<section class="verdict {kind}" aria-label="Verdict">'
        f"<p><strong>{mark} {escape(_sentence(verdict.summary()))}</strong></p>"
        + (f"<ul>{warnings}</ul>" if warnings else "")
        + (f"<p>What would help:</p><ul>{helps}</ul>" if helps else "")
        + "</section>"
    )


def _seen(capture: Capture, model: ObjectModel, perceived: Perceived) -> str:
    hand, pose = perceived.hand, perceived.object.pose_camera_object
    view, accepted = CloseUp(capture, hand, model, pose), perceived.object.accepted
    legend = "".join(
        f'<li><i style="background:rgb{FINGER_COLORS[finger]}"></i>{finger}</li>' for finger in HUMAN_FINGERS
    )
    words = (
        "The hand's skeleton, a color for each finger, and the outline of the object's mesh, hidden parts "
        "included. The pale disc round a joint is its standard deviation; a joint with a dark middle has "
        "low confidence."
    )
    frame = "The whole image; the frame is what is enlarged."
    small = figure(view.whole_image(), frame, photograph=True)
    near = "The depth: near is yellow, far is violet, black was not measured. The same outline."
    small += figure(view.depth(accepted), near)
    return (
        '<article id="seen" aria-labelledby="seen-title"><h2 id="seen-title">In the image</h2>'
        f'<div class="wide">{figure(view.found(accepted), words, photograph=True)}</div>'
        f'<ul class="legend">{legend}</ul><div class="pictures">{small}</div></article>'
    )


def _in_space(model: ObjectModel, perceived: Perceived) -> str:
    mirrored = perceived.hand.side == "left"
    views = grasp_from_four_sides(perceived.grasp, model, perceived.pose_world_camera, mirrored)
    pictures = "".join(figure(view, side) for view, side in zip(views, SIDES, strict=False))
    lines = [f"Touching the object, orange: {contact_words(perceived.grasp.link_contacts)}."]
    if not perceived.object.accepted:
        lines.append("The object's pose is not sure, so what touches it is uncertain.")
    if mirrored:
        lines.append("The image shows a left hand: what is drawn, and kept, is its reflection.")
    if not perceived.table_found:
        lines.append("No table was seen: the one drawn is a guess.")
    if not views:
        lines.append("The joints are no hand that can be drawn.")
    words = "".join(f'<p class="outcome">{escape(line)}</p>' for line in lines)
    return (
        '<article id="grasp" aria-labelledby="grasp-title"><h2 id="grasp-title">From four sides</h2>'
        f'{words}<div class="pictures four">{pictures}</div></article>'
    )


def _figures(verdict: Acceptance, truth: Sequence[Quantity]) -> str:
    head, *rows = verdict.rows()
    columns = "".join(f'<th scope="col">{escape(one)}</th>' for one in head)
    lines = []
    for row, meter in zip(rows, verdict.evidence, strict=True):
        first, *others = row
        kind = "for" if meter.met else "against"
        cells = "".join(f'<td class="number {kind}">{escape(cell)}</td>' for cell in others)
        lines.append(f'<tr><th scope="row">{escape(first)}</th>{cells}</tr>')
    words = "The answer is sure where each quantity is within its limit."
    table = (
        f'<section class="card"><h3>What the verdict rests on</h3><p>{words}</p><table class="quality '
        f'evidence"><thead><tr>{columns}</tr></thead><tbody>{"".join(lines)}</tbody></table>'
        "</section>"
    )
    cards = table + quality_card(truth, "How far it is from the truth")
    return (
        '<article id="figures" aria-labelledby="figures-title"><h2 id="figures-title">In figures</h2>'
        f'<div class="tables">{cards}</div></article>'
    )


def _uncertain(capture: Capture, model: ObjectModel, perceived: Perceived) -> str:
    """Return the HTML section on joint confidence and alternative object poses."""
    confidence = perceived.hand.confidence
    joints = (
        f"{int((confidence >= SURE_JOINT).sum())} of the hand's 21 joints are sure "
        f"(within {1000 * WITHIN:.0f} mm); {float(confidence.sum()):.0f} are expected to be so near."
    )
    return (
        '<article id="uncertain" aria-labelledby="uncertain-title">'
        '<h2 id="uncertain-title">What is uncertain</h2>'
        f'<p class="outcome">{joints}</p>{alternatives(capture, model, perceived)}</article>'
    )


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:].rstrip('.')}{'' if words.endswith('?') else '.'}"


def alternatives(capture: Capture, model: ObjectModel, perceived: Perceived) -> str:
    """Return HTML with the scores of the object's poses and pictures of different ones."""
    obj = perceived.object
    if not obj.alternatives:
        return '<p class="outcome">No other pose of the object was worth considering.</p>'
    poses = np.stack([obj.pose_camera_object, *(pose for pose, _ in obj.alternatives)])
    scores = [obj.score, *(score for _, score in obj.alternatives)]
    points = object_template(model).surface.samples[:POINTS]
    apart, turned = _differences(points, poses, poses[0])
    rows = [f'<tr><th scope="row">The answer</th><td class="number">{obj.score:.2f}</td></tr>']
    pictures, shown = [], poses[:1]
    for i in range(1, len(poses)):
        away = f"{1e3 * apart[i]:.0f} mm and {turned[i]:.0f}° from the answer"
        rows.append(
            f'<tr><th scope="row">Pose {i + 1}<small>{away}</small></th>'
            f'<td class="number">{scores[i]:.2f}</td></tr>'
        )
        if len(pictures) < PICTURED and _another(*_differences(points, shown, poses[i])).all():
            picture = CloseUp(capture, perceived.hand, model, poses[0]).another_pose(poses[i])
            caption = f"Pose {i + 1}, score {scores[i]:.2f}: {away}"
            pictures.append(figure(picture, caption, photograph=True))
            shown = np.concatenate([shown, poses[i : i + 1]])
    return (
        f'<p class="outcome">{_rival(np.array(scores), apart, turned)}</p>'
        '<div class="tables"><section class="card"><h3>Scores of the object\'s poses</h3>'
        "<p>How far they are from the answer is the mean between the surfaces, and the turn.</p>"
        f'<table class="quality"><tbody>{"".join(rows)}</tbody></table></section></div>'
        + (f'<div class="pictures">{"".join(pictures)}</div>' if pictures else "")
    )


def _differences(points: np.ndarray, poses: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ADD-S distances [m] and rotation angles [degrees] to another pose, shape [P] each."""
    apart = np.array([float(add_s(points, pose, other)) for pose in poses])
    return apart, np.degrees(rotation_error(poses, other))


def _another(apart: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return whether poses with these differences are visibly rotated or displaced."""
    return ((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE)


def _rival(scores: np.ndarray, apart: np.ndarray, turned: np.ndarray) -> str:
    """Return a sentence on the best pose that differs from the first."""
    others = np.flatnonzero(_another(apart, turned))
    if not len(others):
        return "Every other pose that fits looks the same as the answer, or nearly so."
    best = others[np.argmax(scores[others])]
    if scores[best] < scores[0] - CLOSE:
        return "Poses that look different fit worse."
    what = f"turned by {turned[best]:.0f}°" if turned[best] > TURNED else "elsewhere"
    return (
        f"Pose {best + 1}, {what}, fits almost as well (score {scores[best]:.2f} against "
        f"{scores[0]:.2f}): look at the pictures which of the two it is."
    )
