"""Convert a foreign URDF or MJCF model to a hand folder, and check hands."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import guarded
from fungrasp.hands.adding.couplings import GivenCoupling, closed_loops, find_couplings, solve_loops
from fungrasp.hands.adding.finger_chains import far_ends, refuse_sliding_or_one_motor
from fungrasp.hands.adding.hand_checks import check_hand
from fungrasp.hands.adding.link_shapes import HandShapes, hand_shapes
from fungrasp.hands.adding.model_file import read_foreign
from fungrasp.hands.adding.model_repairs import find_palm
from fungrasp.hands.adding.new_model import new_model
from fungrasp.hands.adding.poses import Poses, narrowed_ranges
from fungrasp.hands.adding.servos import (
    FULL_TORQUE_ERROR,
    TIP_FORCE,
    JointPhysics,
    joint_physics,
    servo_entries,
    shared_motors,
)
from fungrasp.hands.adding.structure import Answers, HandStructure, find_structure
from fungrasp.hands.export import self_contained_xml
from fungrasp.hands.findings import Finding, error, note
from fungrasp.hands.hand import read_hand_toml
from fungrasp.hands.hand_registry import MODEL_SUFFIXES
from fungrasp.hands.kinematic_tree import body_name
from fungrasp.hands.plausibility import check_plausibility

__all__ = ["Answers", "add_hand", "check_hand_files"]

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@guarded("hand's model")
def add_hand(
    path: str | Path,
    folder: str | Path | None = None,
    name: str | None = None,
    answers: Answers | None = None,
    force: bool = False,
) -> tuple[Path, list[Finding]]:
    """Write a hand folder with a self-contained MJCF file and ``hand.toml``. The output is deterministic.

    Args:
        path: URDF or MJCF file; its meshes are searched for by ``find_mesh``.
        folder: folder of the new hand. None: named as the hand, in the current directory.
        name: name of the new hand. None: from the file name.
        answers: given properties of the hand; the others are found in the file.
        force: overwrite the files of an earlier run.

    Returns:
        The TOML file, and findings of the conversion and of ``check_hand``.

    Raises:
        FungraspError: the file cannot be read, the result is implausible, the folder already contains a hand,
            or a property cannot be found (the message names its option).
    """
    path, answers = Path(path), answers or Answers()
    name = name or re.sub(r"\W+", "_", path.stem).strip("_").lower() or "hand"
    folder = Path(name) if folder is None else Path(folder)
    toml_path, model_path = folder / "hand.toml", folder / f"{name}.xml"
    if path.resolve() == model_path.resolve():
        raise FungraspError(f"{path} would be overwritten; choose another folder than {folder}")
    if not force and (toml_path.exists() or model_path.exists()):
        raise FungraspError(f"{folder} already holds a hand; --force overwrites it")
    foreign = read_foreign(path, answers.palm, [coupling.joint for coupling in answers.couplings])
    answers = replace(answers, palm=foreign.palm)
    findings = foreign.findings
    couplings = find_couplings(foreign.model, findings, answers.couplings)
    palm = find_palm(foreign.model, answers.palm)
    refuse_sliding_or_one_motor(foreign.model, palm, couplings)
    loops = closed_loops(foreign.model, palm)
    couplings = solve_loops(foreign.model, loops, couplings, findings)
    findings += narrowed_ranges(foreign.model, couplings)
    ends = far_ends(foreign)
    ties = [loop.ends for loop in loops]
    structure = find_structure(foreign.model, palm, couplings, ties, ends, answers, findings)
    findings.append(_summary(structure, foreign.model))
    poses = Poses(foreign.model, couplings, structure.palm)
    shapes = hand_shapes(foreign, structure, poses, ends, answers.radius, findings)
    physics = joint_physics(poses, structure, shapes.tips, findings)
    shared = shared_motors(poses, structure.palm)
    findings += [shared] if shared else []
    spec = new_model(foreign, structure, poses, shapes, couplings, physics)
    spec.modelname = name
    text = self_contained_xml(spec)
    toml = _toml(name, path, foreign.model, structure, shapes, physics, poses)
    with TemporaryDirectory() as trial:
        (Path(trial) / model_path.name).write_text(text)
        (Path(trial) / toml_path.name).write_text(toml)
        wrong = list(check_plausibility(read_hand_toml(Path(trial) / toml_path.name)))
    wrong = [finding for finding in wrong if finding.severity == "error"]
    if wrong:
        said = [f.message for f in findings if f.severity == "warning" and "proposed" not in f.message]
        raise FungraspError(
            f"{path}: this is not a plausible hand: {'; '.join(f.message for f in wrong)}"
            + (f" (read on the way: {'; '.join(said)})" if said else "")
        )
    with atomic_path(model_path) as temporary:
        temporary.write_text(text)
    with atomic_path(toml_path) as temporary:
        temporary.write_text(toml)
    return toml_path, [*findings, *check_hand(toml_path)]


@guarded("hand")
def check_hand_files(path: str | Path) -> list[Finding]:
    """Check a hand, or whether a model can be added.

    Args:
        path: TOML file or folder of a hand, or a URDF or MJCF file.

    Returns:
        Findings, the most severe first. Without errors, the hand can be used or the model added.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "hand.toml"
    if not path.is_file():
        return [error(f"{path} does not exist")]
    if path.suffix == ".toml":
        findings = check_hand(path)
    elif path.suffix.lower() in MODEL_SUFFIXES:
        try:
            with TemporaryDirectory() as trial:
                findings = add_hand(path, Path(trial), "hand")[1]
        except FungraspError as problem:
            findings = [error(str(problem))]
        findings.append(note(f"'fungrasp hands add {path}' repairs the model and writes a hand folder"))
    else:
        findings = [error(f"{path} must be a .toml (hand) or {', '.join(MODEL_SUFFIXES)} (model) file")]
    order = ("error", "warning", "note")
    return sorted(dict.fromkeys(findings), key=lambda finding: order.index(finding.severity))


def parse_fingers(entries: tuple[str, ...]) -> Mapping[str, str]:
    """Parse entries ``FINGER=BODY``.

    Raises:
        FungraspError: an entry has no "=".
    """
    for entry in entries:
        if "=" not in entry:
            raise FungraspError(f"--finger takes NAME=BODY, as in index=link_3, not '{entry}'")
    return dict(entry.split("=", 1) for entry in entries)


def parse_couplings(entries: tuple[str, ...]) -> tuple[GivenCoupling, ...]:
    """Parse entries ``JOINT=SLOPE*DRIVER`` or ``JOINT=OFFSET+SLOPE*DRIVER`` [rad].

    The driver comes last because names of joints may contain signs and digits.

    Raises:
        FungraspError: an entry has another form.
    """
    found = []
    for entry in entries:
        match = re.fullmatch(
            rf"\s*([^=]+?)\s*=\s*({NUMBER}(?=\s*[-+]))?\s*([-+]?)\s*({NUMBER})\s*\*\s*(.+?)\s*", entry
        )
        if match is None:
            raise FungraspError(
                "--couple takes JOINT=SLOPE*DRIVER or JOINT=OFFSET+SLOPE*DRIVER, as in j2=1.0*j1 or "
                f"j2=0.7+1.0*j1, not '{entry}'"
            )
        joint, offset, sign, slope, driver = match.groups()
        found.append(
            GivenCoupling(joint, float(slope) * (-1 if sign == "-" else 1), driver, float(offset or 0.0))
        )
    return tuple(found)


def _summary(structure: HandStructure, model) -> Finding:
    fingers = "; ".join(
        f"{finger}: {' > '.join(body_name(model, b) for b in chain.links)}"
        for finger, chain in structure.fingers.items()
    )
    return note(
        f"a {structure.side} hand, palm '{body_name(model, structure.palm)}', fingers along "
        f"{_vector(structure.along)}, palm faces {_vector(structure.normal)}; {fingers}"
    )


def _toml(
    name: str,
    path: Path,
    model,
    structure: HandStructure,
    shapes: HandShapes,
    physics: JointPhysics,
    poses: Poses,
) -> str:
    lines = [
        f"name = {json.dumps(name)}",
        f"title = {json.dumps(name.replace('_', ' ').capitalize())}",
        f"model = {json.dumps(name + '.xml')}",
        f"palm = {json.dumps(body_name(model, structure.palm))}",
        f'side = "{structure.side}"',
        f"source = {json.dumps(path.name)}",
        "",
        "[palm_frame] # unit vectors in the palm body's frame",
        f"fingers = {_vector(structure.along)}",
        f"normal = {_vector(structure.normal)}",
    ]
    for finger, chain in structure.fingers.items():
        links = [body_name(model, body) for body in chain.links]
        joints = [f"{finger}_joint_{i + 1}" for i in range(len(links))]
        lines += [
            "",
            f"[fingers.{finger}]",
            f"links = {json.dumps(links)}",
            f"joints = {json.dumps(joints)}",
            f'tip = "{finger}_tip"',
        ]
    joints = [
        j
        for body in shapes.links
        if body != structure.palm
        for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    ]
    common, special = servo_entries(physics, poses, joints)
    lines += [
        "",
        "[actuators] # joint position servos",
        *common,
        "source = "
        + json.dumps(
            f"torque limits: the file's where most are within a factor of about three of those that press "
            f"with {TIP_FORCE:g} N at a tip, else those; reached at {FULL_TORQUE_ERROR:g} rad from the target"
        ),
    ]
    if special:
        lines += ["", "[actuators.joints]", *special]
    return "\n".join([*lines, ""])


def _vector(values: np.ndarray) -> str:
    unit = np.round(values / np.linalg.norm(values), 6) + 0.0
    return json.dumps(unit.tolist())
