"""What a page says about the other poses that the object may have."""

from __future__ import annotations

import numpy as np

from fungrasp.media.page_parts import figure
from fungrasp.media.perception_pictures import pose_over
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.object_pose.pose_evidence import CLOSE, RIVAL_DISTANCE, TURNED
from fungrasp.perception.perceived import Perceived

SAME = 0.002
"""Poses whose surfaces are nearer than this on average (ADD-S [m]) look the same."""

POINTS = 1500
"""Points of the object's surface by which poses are compared."""

PICTURED = 2
"""Alternatives that get a picture."""


def alternatives(capture: Capture, model: ObjectModel, perceived: Perceived) -> str:
    """HTML: the scores of the object's poses, and pictures of those that are other ones."""
    thing = perceived.object
    if not thing.alternatives:
        return '<p class="outcome">No other pose of the object was worth considering.</p>'
    poses = np.stack([thing.pose_camera_object, *(pose for pose, _ in thing.alternatives)])
    scores = [thing.score, *(score for _, score in thing.alternatives)]
    points = object_template(model).surface.samples[:POINTS]
    apart, turned = _differences(points, poses, poses[0])
    rows = [f'<tr><th scope="row">The answer</th><td class="number">{thing.score:.2f}</td></tr>']
    pictures, shown = [], poses[:1]
    for i in range(1, len(poses)):
        away = f"{1e3 * apart[i]:.0f} mm and {turned[i]:.0f}° from the answer"
        rows.append(
            f'<tr><th scope="row">Pose {i + 1}<small>{away}</small></th>'
            f'<td class="number">{scores[i]:.2f}</td></tr>'
        )
        if len(pictures) < PICTURED and _another(*_differences(points, shown, poses[i])).all():
            picture = pose_over(capture, perceived.hand, model, poses[0], poses[i])
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
    """How far the surfaces are apart (ADD-S [m]), and the turn [degrees], shape [P] each."""
    apart = np.array([float(add_s(points, pose, other)) for pose in poses])
    return apart, np.degrees(rotation_error(poses, other))


def _another(apart: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Whether poses so different are not the same answer: turned, so that one can see it, or elsewhere."""
    return ((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE)


def _rival(scores: np.ndarray, apart: np.ndarray, turned: np.ndarray) -> str:
    """A word on the best pose that is another one than the first."""
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
