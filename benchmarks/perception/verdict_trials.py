"""Trials of the verdict on poses of objects: captures with the right mesh and with wrong ones, and the
evidence that each answer rests on. Calibration reads the file and needs no image again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.perception.recorded_captures import RecordedCapture
from benchmarks.perception.recorded_figures import hinted_captures
from benchmarks.perception.wrong_meshes import searched_mesh, with_colors, wrong_meshes
from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import one_line
from fungrasp.core.formats.mesh_file import read_colored_mesh
from fungrasp.objects import ObjectModel, ResolvedObject
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.hand.joint_confidence import joint_features
from fungrasp.perception.object_pose.estimate import search_object_pose
from fungrasp.perception.object_pose.known_object import KnownObject
from fungrasp.perception.object_pose.pose_error import add_s, rotation_error
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive
from fungrasp.perception.scene.table import NO_TABLE
from fungrasp.perception.verdict import hand_features

RIGHT = "right"
"""Kind of the mesh that is not wrong."""


@dataclass(frozen=True)
class VerdictTrial:
    """One answer, what it rests on, and whether it is right."""

    capture: str
    """Name of the capture."""
    told: str
    """What was said of the object's place: "none", "click" or "mask"."""
    mesh: str
    """Kind of the mesh: "right", or one of ``wrong_meshes``."""
    colored: bool
    """Whether the mesh had colors."""
    add_s_mm: float
    """ADD-S of the right mesh [mm]; infinite for a wrong one, or without an answer."""
    turned_deg: float
    """Angle between the rotations [degrees], not reduced by symmetries; NaN for a wrong mesh."""
    evidence: dict[str, float]
    """``PoseEvidence``; empty where nothing was searched for."""
    pose: list[float]
    """The answer, shape [7]: other evidence can be measured of it without another search."""
    seconds: float
    """CPU time of the search [s]."""

    @property
    def right(self) -> bool:
        """Whether mesh and pose are right: ADD-S below 10 mm."""
        return self.add_s_mm < 10.0


@dataclass(frozen=True)
class HandTrial:
    """The hand of one answer without hints, what it rests on, and how far it is off."""

    capture: str
    """Name of the capture."""
    found: bool
    """Whether the landmarks are nearer to the true hand than half its extent."""
    mean_mm: float
    """Mean error of the joints [mm]."""
    far: float
    """Part of the joints more than 20 mm off."""
    features: dict[str, float]
    """What its probability is made of, see ``hand_features``."""
    joints: dict[str, list[list[float]]]
    """Joints [m], shape [21, 3] each: "true" (NaN: not known), "refined", and "fitted", before the object
    was known."""
    each: dict[str, list[float]]
    """What the probabilities of the joints are made of, see ``joint_features``, shape [21] each."""


def _hand_trial(recorded: RecordedCapture, seen: Perceived) -> HandTrial | None:
    truth = recorded.joints_camera
    if truth is None:
        return None
    known = np.isfinite(truth).all(axis=1)
    off = 1000 * np.linalg.norm((seen.hand.joints_camera - truth)[known], axis=1)
    pixels = recorded.capture.intrinsics.project(truth[known])
    apart = np.median(np.linalg.norm(seen.hand.pixels[known] - pixels, axis=1))
    return HandTrial(
        recorded.name,
        bool(apart < 0.5 * np.linalg.norm(np.ptp(pixels, axis=0))),
        float(off.mean()),
        float((off > 20.0).mean()),
        hand_features(seen.hand),
        {
            "true": truth.tolist(),
            "refined": seen.hand.joints_camera.tolist(),
            "fitted": seen.trace.candidate.hand.joints_camera.tolist(),
        },
        {name: values.tolist() for name, values in _joint_features(seen).items()},
    )


def _joint_features(seen: Perceived) -> dict[str, np.ndarray]:
    candidate = seen.trace.candidate
    return joint_features(seen.capture, candidate.hand, seen.hand, candidate.object.accepted)


def measure_trials(
    recorded: RecordedCapture,
    detector: HandDetector,
    others: Mapping[str, ObjectModel],
    wrong: int | None,
    painted: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[list[VerdictTrial], HandTrial | None]:
    """The right mesh and wrong ones, without and with what a person may say about the object's place.

    Args:
        recorded: the capture; its hand and table are found once.
        detector: finds hands.
        others: objects of which some are wrong meshes.
        wrong: number of kinds of wrong meshes that are drawn for each hint; None tries all.
        painted: vertices and their colors, RGB 0 to 1, of the mesh with colors; without colors if None.

    Returns:
        the trials; none where no hand is found; the hand of the right mesh without hints.
    """
    model, truth = recorded.model, recorded.pose_camera_object
    if model is None or truth is None:
        return [], None
    try:
        seen = perceive(recorded.capture.with_object(), ResolvedObject(model), detector=detector)
    except FungraspError:
        return [], None
    hand = seen.trace.candidate.hand
    table = NO_TABLE if seen.trace.candidate.table is None else seen.trace.candidate.table
    meshes = {RIGHT: model} | wrong_meshes(model, others)
    points = np.asarray(model.mesh.sample(2000, seed=0))
    rng = np.random.default_rng([ord(letter) for letter in recorded.name])
    hints = hinted_captures(recorded)
    names = [kind for kind in meshes if kind != RIGHT]
    drawn = [names[i] for i in rng.permutation(len(names))[: wrong or len(names)]]
    # Half of them are tried with a mask as well, and one more with that alone, so that most kinds are.
    rest = [kind for kind in names if kind not in drawn]
    with_mask = drawn[: -(-len(drawn) // 2)] + rest[:1] if wrong else drawn
    ready: dict[str, KnownObject] = {}
    trials = []
    for told, kinds in (("none", drawn), ("mask", with_mask)):
        if told not in hints:
            continue
        for kind in (RIGHT, *kinds):
            if kind not in ready:
                known = searched_mesh(meshes[kind], model)
                ready[kind] = known if painted is None else _painted(known, meshes[kind], painted)
            clock = process_time()
            answers = seen.trace.candidate.answers
            if told != "none" or kind != RIGHT or painted is not None or answers is None:
                answers = search_object_pose(hints[told], ready[kind], hand, table)
            pose, record = answers.poses[0], answers.evidence
            right = kind == RIGHT and record is not None
            trials.append(
                VerdictTrial(
                    recorded.name,
                    told,
                    kind,
                    painted is not None,
                    1000 * float(add_s(points, pose, truth)) if right else float("inf"),
                    float(np.degrees(rotation_error(pose, truth))) if right else float("nan"),
                    {} if record is None else record.as_dict(),
                    pose.tolist(),
                    process_time() - clock,
                )
            )
    return trials, _hand_trial(recorded, seen)


def read_trials(path: str | Path) -> tuple[list[VerdictTrial], list[HandTrial]]:
    """Answers and hands out of a file that ``append_trials`` wrote.

    Raises:
        FungraspError: it is none.
    """
    answers, hands = [], []
    try:
        for line in Path(path).read_text().splitlines():
            entry = json.loads(line)
            if "told" in entry:
                answers.append(VerdictTrial(**entry))
            else:
                hands.append(HandTrial(**entry))
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{path} holds no trials: {one_line(error)}") from error
    return answers, hands


def append_trials(path: str | Path, answers: Sequence[VerdictTrial], hand: HandTrial | None) -> None:
    """Add the trials of a capture to a file, one in a line."""
    trials = [*answers, *([] if hand is None else [hand])]
    with Path(path).open("a") as file:
        file.write("".join(json.dumps(asdict(trial)) + "\n" for trial in trials))


def painted_vertices(folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and colors of a rendered capture's object; None for other captures."""
    meshes = sorted(folder.glob("*.ply"))
    if not meshes:
        return None
    mesh: Any = read_colored_mesh(meshes[0])
    return (
        None if mesh is None else (np.array(mesh.vertices), np.array(mesh.visual.vertex_colors)[:, :3] / 255)
    )


def _painted(known: KnownObject, model: ObjectModel, painted: tuple[np.ndarray, np.ndarray]) -> KnownObject:
    vertices, colors = painted
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    box = np.stack([model.vertices.min(axis=0), model.vertices.max(axis=0)])
    return with_colors(known, (vertices - low) / (high - low), colors, box)
