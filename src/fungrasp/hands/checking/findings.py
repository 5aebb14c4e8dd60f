"""What a check reports; palm, fingers and tips of a bare model, guessed from names and its tree of bodies."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np

from fungrasp.hands.hand import FINGERS
from fungrasp.hands.kinematic_tree import ancestors, body_name, subtree

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One fault or remark of a check."""

    severity: Severity
    """Error: the hand can't be used, or not rightly. Warning: probably a mistake. Note: good to know."""
    message: str
    """A sentence that names the body, joint or entry and the remedy."""


@dataclass(frozen=True)
class HandParts:
    """The bodies and sites of palm, fingers and tips, as far as they are known and exist in the model."""

    palm: str | None = None
    """Name of the palm body."""
    fingers: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Bodies from base to tip by finger name."""
    joints: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Site or body at the near end of each link, by finger name: only where they are not the links
    themselves."""
    tips: dict[str, str] = field(default_factory=dict)
    """Tip site or body by finger name."""


def error(message: str) -> Finding:
    """A finding that stops the hand from being used."""
    return Finding("error", message)


def warning(message: str) -> Finding:
    """A finding that probably is a mistake."""
    return Finding("warning", message)


def note(message: str) -> Finding:
    """A finding that is no fault."""
    return Finding("note", message)


def listed(names: list[str], limit: int = 6) -> str:
    """Names for a message: 'a', 'b' and 3 more."""
    shown = ", ".join(f"'{name}'" for name in names[:limit])
    return shown if len(names) <= limit else f"{shown} and {len(names) - limit} more"


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


def finger_of(name: str) -> str | None:
    """The finger that a body's name tells ("rh_ffproximal": "index"), or None."""
    match = _PATTERN.search(name.lower())
    return match.lastgroup if match else None


def guess_parts(model: mujoco.MjModel) -> HandParts:
    """Palm, fingers and tip sites, as far as names tell.

    A finger is the last three links of a chain that begins at the palm.
    """
    moving = set(np.flatnonzero(model.body_jntnum > 0).tolist())
    ends = [body for body in moving if not moving & (set(subtree(model, body)) - {body})]
    palm = _common_ancestor(model, ends)
    fingers: dict[str, tuple[str, ...]] = {}
    for end in sorted(ends):
        chain = [
            body
            for body in reversed(ancestors(model, end))
            if body in moving and palm in (*ancestors(model, body)[1:], 0)
        ]
        names = tuple(body_name(model, body) for body in _distinct(model, chain)[-3:])
        votes = Counter(finger for body in chain if (finger := finger_of(body_name(model, body))))
        finger = votes.most_common(1)[0][0] if votes else None
        if finger is not None and finger not in fingers:
            fingers[finger] = names
    fingers = {name: fingers[name] for name in FINGERS if name in fingers}
    tips = {}
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
    return HandParts(body_name(model, palm) if palm else None, fingers, tips=tips)


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
