"""All checks of a hand: its files, its model, its TOML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.text_files import read_toml, type_faults
from fungrasp.hands.checking.findings import Finding, HandParts, error, guess_parts, note, warning
from fungrasp.hands.checking.finger_checks import check_fingers, check_palm_frame, check_palm_origin
from fungrasp.hands.checking.model_checks import (
    check_actuators,
    check_couplings,
    check_joints,
    check_masses,
    check_palm,
    check_shapes,
    check_size,
)
from fungrasp.hands.checking.model_source import ModelSource, read_source
from fungrasp.hands.checking.plausibility import check_plausibility
from fungrasp.hands.hand import FINGERS, HAND_TOML, read_hand_toml, side_of

__all__ = ["Finding", "check_hand_files"]

MODEL_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro")


@guarded("hand")
def check_hand_files(path: str | Path) -> list[Finding]:
    """Everything found wrong with a hand, the worst first.

    It goes on after a fault as far as it can.

    Args:
        path: a hand's TOML file or folder, a URDF or an MJCF.

    Returns:
        No finding of severity "error" if and only if the hand can be used (a bare model: with a TOML file).
    """
    path = Path(path)
    if path.is_dir():
        path = path / "hand.toml"
    if not path.is_file():
        return [error(f"{path} does not exist")]
    if path.suffix == ".toml":
        findings = _check_toml(path)
    elif path.suffix.lower() in MODEL_SUFFIXES:
        findings = _check_bare(path)
    else:
        findings = [error(f"{path} is none of .toml (a hand), {', '.join(MODEL_SUFFIXES)} (a model)")]
    order = ("error", "warning", "note")
    return sorted(dict.fromkeys(findings), key=lambda finding: order.index(finding.severity))


def _check_bare(path: Path) -> list[Finding]:
    findings: list[Finding] = []
    source = read_source(path, findings)
    if source is None:
        return findings
    parts = guess_parts(source.model)
    findings += _check_model(source, parts)
    findings += check_actuators(source.model)
    if "thumb" not in parts.fingers:
        findings.append(warning("no thumb is seen in the names of the bodies; a hand needs one"))
    findings.append(note(f"'fungrasp hands add {path}' mends what it can and makes a hand folder of it"))
    return findings


def _check_toml(path: Path) -> list[Finding]:
    findings: list[Finding] = []
    try:
        data = read_toml(path, "hand file")
    except FungraspError as problem:
        return [error(str(problem))]
    faults = [error(f"{path}: {fault}") for fault in type_faults(data, HAND_TOML)]
    if faults:
        return faults
    findings += [error(f"{path}: the field '{key}' is missing") for key in _REQUIRED if key not in data]
    for key, kind in (("name", str), ("model", str), ("palm", str), ("actuators", Mapping)):
        if key in data and not isinstance(data[key], kind):
            findings.append(
                error(f"{path}: '{key}' must be a {'text' if kind is str else 'table'}, not {data[key]!r}")
            )
    if isinstance(data.get("model"), str):
        model_path = path.parent / data["model"]
        if not model_path.is_file():
            return [*findings, error(f"the hand's model {model_path} does not exist")]
        source = read_source(model_path, findings)
        if source is not None:
            parts = _named_parts(path, data, source.model, findings)
            findings += _check_model(source, parts)
            findings += check_fingers(source.model, parts)
            findings += check_palm_origin(source.model, parts)
            findings += _palm_frame(source.model, parts, data)
    if not any(finding.severity == "error" for finding in findings):
        try:
            hand = read_hand_toml(path)
            hand.spec().compile()
            findings += check_plausibility(hand)
            across = np.cross(hand.palm_fingers, hand.palm_normal)
            seen = side_of(hand.model, hand.palm, hand.fingers, across)
            if seen != hand.side:
                findings.append(
                    warning(
                        f'side is "{hand.side}", but by the order of its fingers, seen from the palm, this '
                        f"is a {seen} hand"
                    )
                )
        except (FungraspError, ValueError) as problem:
            findings.append(error(" ".join(str(problem).split())))
    return findings


_REQUIRED = ("name", "model", "palm", "fingers", "actuators")


def _check_model(source: ModelSource, parts: HandParts) -> Iterator[Finding]:
    model = source.model
    yield from check_palm(source, parts)
    yield from check_joints(model, parts)
    yield from check_couplings(source)
    yield from check_masses(source)
    yield from check_size(model, parts)
    yield from check_shapes(source, parts)


def _named_parts(
    path: Path, data: Mapping[str, Any], model: mujoco.MjModel, findings: list[Finding]
) -> HandParts:
    """The parts of the TOML that exist in the model; the others are reported."""
    bodies = {model.body(i).name for i in range(1, model.nbody)}
    sites = {model.site(i).name for i in range(model.nsite)}

    def existing(kind: str, name: Any, known: set[str]) -> bool:
        if isinstance(name, str) and name in known:
            return True
        findings.append(error(f"{path}: {UnknownNameError(f'{kind} of {model_name}', str(name), known)}"))
        return False

    model_name = Path(str(data["model"])).name
    palm = data.get("palm")
    known_palm = palm if palm is not None and existing("body", palm, bodies) else None
    fingers, joints, tips = {}, {}, {}
    given = data.get("fingers", {})
    if not isinstance(given, Mapping):
        findings.append(error(f"{path}: 'fingers' must be tables, [fingers.index] and so on, not {given!r}"))
        given = {}
    for finger in given:
        entry = given[finger]
        if finger not in FINGERS:
            findings.append(error(f"{path}: {UnknownNameError('finger', finger, FINGERS)}"))
            continue
        links = entry.get("links") if isinstance(entry, Mapping) else None
        if not isinstance(links, list) or not 1 <= len(links) <= 3 or "tip" not in entry:
            findings.append(
                error(
                    f"{path}: finger '{finger}' needs 'links' (one to three bodies, base to tip) and 'tip' "
                    "(site or body)"
                )
            )
            continue
        fingers[finger] = tuple(link for link in links if existing("body", link, bodies))
        if existing("site or body", entry["tip"], sites | bodies):
            tips[finger] = entry["tip"]
        if isinstance(entry.get("joints"), list):
            points = tuple(name for name in entry["joints"] if existing("site or body", name, sites | bodies))
            if len(points) == len(entry["joints"]) == len(fingers[finger]):
                joints[finger] = points
    if "fingers" in data and "thumb" not in given:
        findings.append(
            error(f"{path}: a hand with no thumb can't imitate a human grasp; give [fingers.thumb]")
        )
    return HandParts(known_palm, {name: links for name, links in fingers.items() if links}, joints, tips)


def _palm_frame(model: mujoco.MjModel, parts: HandParts, data: Mapping[str, Any]) -> Iterator[Finding]:
    frame = data.get("palm_frame")
    if not isinstance(frame, Mapping) or "fingers" not in frame or "normal" not in frame:
        yield warning("[palm_frame] is not given; fingers along z and a palm that faces x are assumed")
        return
    vectors = []
    for key in ("fingers", "normal"):
        vector = np.asarray(frame[key])
        if vector.shape != (3,) or vector.dtype.kind not in "fi" or abs(np.linalg.norm(vector) - 1.0) > 1e-3:
            yield error(f"palm_frame.{key} must be a unit vector of 3 numbers, not {frame[key]!r}")
            return
        vectors.append(vector.astype(float))
    yield from check_palm_frame(model, parts, *vectors)
