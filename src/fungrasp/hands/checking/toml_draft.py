"""A draft of a hand's TOML: palm, fingers and tips guessed from the names and tree of a model's bodies."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from fungrasp.hands.checking.finding import HandParts
from fungrasp.hands.checking.kinematic_tree import ancestors, body_name, subtree
from fungrasp.hands.checking.model_source import ModelSource
from fungrasp.hands.hand import FINGERS

_WORDS = {
    "index": ("index", "ff", "fore"),
    "middle": ("middle", "mf"),
    "ring": ("ring", "rf"),
    "pinky": ("pinky", "pinkie", "little", "lf"),
    "thumb": ("thumb", "th"),
}
_PART = r"[^a-z]|base|hub|meta|knuckle|prox|mid|med|dist|tip|link|finger|j\d|$"
_PATTERN = re.compile(
    "|".join(rf"(?P<{name}>(?<![a-z])(?:{'|'.join(words)})(?={_PART}))" for name, words in _WORDS.items())
)


@dataclass(frozen=True)
class PartsGuess:
    """The parts of a hand as guessed, and what the guess lacks."""

    parts: HandParts
    """Only tip sites that exist."""
    missing_tips: dict[str, np.ndarray]
    """By finger: where a tip site is wanted, in the frame of the finger's last link [m], shape [3]."""
    unnamed: tuple[tuple[str, ...], ...]
    """Chains of moving bodies whose finger their names don't tell."""


def finger_of(name: str) -> str | None:
    """The finger that a body's name tells ("rh_ffproximal": "index"), or None."""
    match = _PATTERN.search(name.lower())
    return match.lastgroup if match else None


def guess_parts(model: mujoco.MjModel) -> PartsGuess:
    """Palm, fingers and tips. A finger is the last three links of a chain that begins at the palm."""
    moving = set(np.flatnonzero(model.body_jntnum > 0).tolist())
    ends = [body for body in moving if not moving & (set(subtree(model, body)) - {body})]
    palm = _common_ancestor(model, ends)
    fingers: dict[str, tuple[str, ...]] = {}
    unnamed = []
    for end in sorted(ends):
        chain = [
            body
            for body in reversed(ancestors(model, end))
            if body in moving and palm in ancestors(model, body)[1:]
        ]
        names = tuple(body_name(model, body) for body in _distinct(model, chain)[-3:])
        votes = Counter(finger for body in chain if (finger := finger_of(body_name(model, body))))
        finger = votes.most_common(1)[0][0] if votes else None
        if finger is None or finger in fingers:
            unnamed.append(names)
        else:
            fingers[finger] = names
    fingers = {name: fingers[name] for name in FINGERS if name in fingers}
    tips, wanted = {}, {}
    for finger, links in fingers.items():
        last = model.body(links[-1]).id
        sites = [
            s
            for s in range(model.nsite)
            if model.body_weldid[model.site_bodyid[s]] == model.body_weldid[last]
        ]
        sites = [s for s in sites if model.site(s).name]
        named = [s for s in sites if "tip" in model.site(s).name.lower()]
        if sites:
            tips[finger] = model.site((named or sites)[0]).name
        else:
            wanted[finger] = tip_position(model, last)
    return PartsGuess(
        HandParts(body_name(model, palm) if palm else None, fingers, tips=tips), wanted, tuple(unnamed)
    )


def tip_position(model: mujoco.MjModel, last: int) -> np.ndarray:
    """Centre of a fingertip's round end: a body on the last one named as a tip, else the shapes' far end.

    Returns:
        In the body's frame [m], shape [3]; zeros if it has neither.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation, origin = data.xmat[last].reshape(3, 3), data.xpos[last]
    members = np.flatnonzero(model.body_weldid == model.body_weldid[last])
    for body in members:
        if body != last and "tip" in body_name(model, body).lower():
            return rotation.T @ (data.xpos[body] - origin)
    far = np.zeros(3)
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, members)):
        frame = data.geom_xmat[geom].reshape(3, 3)
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        longest = int(np.argmax(half))
        reach = half[longest] - np.sort(half)[1]
        for sign in (-1.0, 1.0):
            local = center + sign * reach * np.eye(3)[longest]
            point = rotation.T @ (data.geom_xpos[geom] + frame @ local - origin)
            far = max(far, point, key=np.linalg.norm)
    return far


def suggested_toml(source: ModelSource, guess: PartsGuess, model_name: str) -> str:
    """A hand's TOML to start from; what could not be guessed is marked with a question mark."""
    lines = [
        f"name = {json.dumps(source.path.stem)}",
        f"model = {json.dumps(model_name)}",
        f"palm = {json.dumps(guess.parts.palm or '?')}",
        "",
        "[palm_frame] # unit vectors in the palm body's frame: check them",
        *_palm_frame(source.model, guess.parts),
    ]
    for finger, links in guess.parts.fingers.items():
        tip = guess.parts.tips.get(finger)
        lines += [
            "",
            f"[fingers.{finger}]",
            f"links = {json.dumps(list(links))}",
            f"tip = {json.dumps(tip or f'{finger}_tip')}",
        ]
        if tip is None:
            place = " ".join(f"{value:.4g}" for value in guess.missing_tips[finger].round(5) + 0.0)
            lines[-1] += f' # to be added to body "{links[-1]}": <site name="{finger}_tip" pos="{place}"/>'
    for links in guess.unnamed:
        lines += [
            "",
            "# [fingers.?] # index, middle, ring, pinky or thumb",
            f"# links = {json.dumps(list(links))}",
        ]
        lines += ['# tip = "?"']
    lines += [
        "",
        "[actuators] # joint position servos: from the data sheet",
        "kp = 4.0 # N m/rad",
        "kd = 0.15 # N m s/rad",
    ]
    return "\n".join([*lines, f"force_limit = {_force_limit(source.model):.3g} # N m", ""])


def with_tips(source: ModelSource, guess: PartsGuess) -> tuple[mujoco.MjSpec, PartsGuess]:
    """The model with a site at every guessed tip, and the guess that knows them."""
    spec = source.spec.copy()
    added = {}
    for finger, place in guess.missing_tips.items():
        added[finger] = f"{finger}_tip"
        spec.body(guess.parts.fingers[finger][-1]).add_site(name=added[finger], pos=place)
    parts = replace(guess.parts, tips={**guess.parts.tips, **added})
    return spec, replace(guess, parts=parts, missing_tips={})


def _palm_frame(model: mujoco.MjModel, parts: HandParts) -> list[str]:
    """Lines of [palm_frame]: along the fingers, and where they bend to, to the nearest axis."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    long = [links for name, links in parts.fingers.items() if name != "thumb"]
    if parts.palm is None or not long:
        return ["fingers = [0.0, 0.0, 1.0]", "normal = [1.0, 0.0, 0.0]"]
    rotation = data.xmat[model.body(parts.palm).id].reshape(3, 3)

    def span(links: tuple[str, ...]) -> np.ndarray:
        return data.xpos[model.body(links[-1]).id] - data.xpos[model.body(links[0]).id]

    along = _nearest_axis(rotation.T @ np.sum([span(links) for links in long], axis=0))
    bent = _bend(model, long)
    normal = _nearest_axis((rotation.T @ bent) * (along == 0))
    return [f"fingers = {along.tolist()}", f"normal = {normal.tolist()}"]


def _bend(model: mujoco.MjModel, fingers: list[tuple[str, ...]]) -> np.ndarray:
    """Sum of the motions of the last links from the zero to the middle pose, world frame, shape [3]."""
    data = mujoco.MjData(model)
    ends = [model.body(links[-1]).id for links in fingers]
    mujoco.mj_kinematics(model, data)
    before = data.xpos[ends].copy()
    joints = np.flatnonzero(model.jnt_limited)
    data.qpos[model.jnt_qposadr[joints]] = model.jnt_range[joints].mean(axis=1)
    mujoco.mj_kinematics(model, data)
    return np.sum(data.xpos[ends] - before, axis=0)


def _nearest_axis(vector: np.ndarray) -> np.ndarray:
    axis = np.zeros(3)
    longest = int(np.argmax(np.abs(vector)))
    axis[longest] = 1.0 if vector[longest] >= 0 else -1.0
    return axis


def _force_limit(model: mujoco.MjModel) -> float:
    """The smallest torque limit the model gives its joints [N m]; 1 if it gives none or an absurd one."""
    limits = model.jnt_actfrcrange[model.jnt_actfrclimited.astype(bool), 1]
    return float(limits.min()) if len(limits) and limits.min() <= 10.0 else 1.0


def _common_ancestor(model: mujoco.MjModel, bodies: list[int]) -> int:
    """The body nearest to all ``bodies`` on which they hang; 0 (the world) if there is none."""
    shared = None
    for body in bodies:
        above = ancestors(model, body)[1:]
        shared = above if shared is None else [other for other in shared if other in above]
    return shared[0] if shared else 0


def _distinct(model: mujoco.MjModel, chain: list[int]) -> list[int]:
    """The chain without bodies that begin where the next one does (two joints in one place), base to tip."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return [
        body
        for body, after in zip(chain, [*chain[1:], None], strict=True)
        if after is None or np.linalg.norm(data.xpos[after] - data.xpos[body]) > 2e-3
    ]
